"""Ten million rays through a bounded device buffer: what a cast holds beside its rays and hits."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from clgrid.device import Device

COUNT = 10_000_000
# Bytes of t, id and two weights of a hit; and what else a cast may hold for each ray: a flag and the ids once
# more at the end, keys and buffers of one launch of four million.
HITS, BESIDE = 24, 24

CHILD = """
import json, resource, sys
import numpy as np
import clgrid

count = int(sys.argv[1])
grid = clgrid.build(clgrid.load_scene("icosphere:4").mesh, density=4.0, device=sys.argv[2])
rng = np.random.default_rng(1)
few = rng.normal(size=(2, 4096, 3)).astype(np.float32)
reference = grid.cast(*few)
origins, directions = (np.tile(part, (count // 4096 + 1, 1))[:count] for part in few)
start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
hits = grid.cast(origins, directions)
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
same = all(
    np.array_equal(hits.t_hit[k : k + 4096], reference.t_hit[: len(hits.t_hit[k : k + 4096])])
    for k in range(0, count, 4096 * 97)
)
print(json.dumps({"bytes_per_ray": (peak - start) * 1024 / count, "same": same}))
"""


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="memory is counted as Linux does")
def test_ten_million_rays_hold_little_beside_their_hits(device: Device) -> None:
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(COUNT), device.label],
        stdout=subprocess.PIPE, text=True, check=True, env=os.environ.copy(), timeout=600,
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert found["same"]
    assert found["bytes_per_ray"] < HITS + BESIDE, found
