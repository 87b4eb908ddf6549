"""A child process of a batch that crashes, hangs or fails at items whose camera's name says so."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

from clgrid.batch import worker
from clgrid.batch.painter import Painter
from clgrid.errors import DeviceError

paint = Painter.paint


def unruly(self: Painter, item: Any, *rest: Any) -> Any:
    wish = item.camera_name
    # Each try leaves a trace, so that tests can count.
    trace = Path(item.outputs[0]).parent / f"{item.number}.tries"
    trace.parent.mkdir(parents=True, exist_ok=True)
    with open(trace, "a") as file:
        file.write("x")
    tries = trace.stat().st_size
    if wish == "crash" or (wish == "crash-once" and tries == 1):
        print("the driver gives up", file=sys.stderr, flush=True)
        os.abort()
    if wish == "hang" or (wish == "hang-once" and tries == 1):
        rest[1]("draw")
        time.sleep(3600)
    if wish == "fail-once" and tries == 1:
        raise DeviceError("the device was busy")
    if wish == "noise":
        os.write(1, b"a driver's greeting\n")
    return paint(self, item, *rest)


Painter.paint = unruly  # type: ignore[method-assign]

if __name__ == "__main__":
    worker.main()
