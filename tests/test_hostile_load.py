"""Every hostile file loads, loads as nothing with a warning, or is refused in one line; in 2 GiB and 20 s.

The table below is the manifest's column ``reasonable_outcome`` in one word a file: how many triangles
(counted in the file where the column only says "load"), ``empty`` or ``error``. Where it leaves a choice,
both are listed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from scenes import manifest, shared_root

EMPTY = "empty"
ERROR = "error"

EXPECTED: dict[str, tuple[int | str, ...]] = {
    "assimp/invalid/OutOfMemory.off": (ERROR,),
    "assimp/invalid/crash-30d6d0f7c529b3b66b4131700b7a4580cd7082df.ply": (ERROR,),
    "assimp/invalid/empty.obj": (ERROR, EMPTY),
    "assimp/invalid/empty.off": (ERROR,),
    "assimp/invalid/empty.ply": (ERROR,),
    "assimp/invalid/malformed.obj": (ERROR, 8),
    "assimp/invalid/malformed2.obj": (10,),
    "assimp/OFF/invalid.off": (ERROR,),
    "assimp/OBJ/box_UTF16BE.obj": (12, ERROR),
    "assimp/OBJ/box_longline.obj": (944,),
    "assimp/OBJ/box_without_lineending.obj": (12,),
    "assimp/OBJ/concave_polygon.obj": (64,),
    "assimp/OBJ/multiple_spaces.obj": (1,),
    "assimp/OBJ/number_formats.obj": (1, ERROR),
    "assimp/OBJ/only_a_part_of_vertexcolors.obj": (3,),
    "assimp/OBJ/point_cloud.obj": (EMPTY,),
    "assimp/OBJ/regr_3429812.obj": (4, ERROR),
    "assimp/OBJ/testline.obj": (EMPTY,),
    "assimp/OBJ/testmixed.obj": (12,),
    "assimp/OBJ/testpoints.obj": (EMPTY,),
    "assimp/OBJ/space_in_material_name.obj": (64,),
    "assimp/OBJ/box_mat_with_spaces.obj": (12,),
    "assimp/PLY/cube_binary_header_with_RN_newline.ply": (12,),
    "assimp/PLY/cube_binary_starts_with_nl.ply": (12,),
    "assimp/PLY/points.ply": (EMPTY,),
    "assimp/PLY/float-color.ply": (1,),
    # "load": the file holds 24 vertices and no face
    "assimp/PLY/issue623.ply": (EMPTY,),
    "assimp/STL/triangle_with_empty_solid.stl": (1,),
    "assimp/STL/triangle_with_two_solids.stl": (2,),
    "assimp/STL/sphereWithHole.stl": (285,),
    "assimp/STL/3DSMaxExport.STL": (2000,),
    "assimp/BoxBadNormals-glTF-Binary/BoxBadNormals.glb": (12,),
    "assimp/BoxWithInfinites-glTF-Binary/BoxWithInfinites.glb": (ERROR, EMPTY),
    "assimp/IncorrectVertexArrays/Cube.gltf": (ERROR, 46),
    "assimp/IndexOutOfRange/IndexOutOfRange.gltf": (ERROR, 11),
    "assimp/IndexOutOfRange/AllIndicesOutOfRange.gltf": (ERROR, EMPTY),
    "assimp/MissingBin/BoxTextured.gltf": (ERROR,),
    "assimp/RecursiveNodes/RecursiveNodes.gltf": (ERROR,),
    "assimp/SchemaFailures/sceneWrongType.gltf": (ERROR,),
    "assimp/TestNoRootNode/NoScene.gltf": (EMPTY,),
    "assimp/TestNoRootNode/SceneWithoutNodes.gltf": (EMPTY,),
    "assimp/issue_3269/texcoord_crash.gltf": (10, ERROR),
    "assimp/wrongTypes/badArray.gltf": (ERROR,),
    "assimp/wrongTypes/badNumber.gltf": (ERROR,),
    "assimp/wrongTypes/badUint.gltf": (ERROR,),
    "assimp/Mesh_PrimitiveMode/Mesh_PrimitiveMode_05.gltf": (2,),
    "assimp/Mesh_PrimitiveMode/Mesh_PrimitiveMode_00.gltf": (EMPTY,),
    "tinyobjloader/models/test-nan.obj": (ERROR,),
    # "skip bad faces": both of its faces are bad
    "tinyobjloader/models/invalid-face-definition.obj": (EMPTY,),
    "tinyobjloader/models/invalid-relative-texture-index.obj": (ERROR,),
    "tinyobjloader/models/invalid-relative-vertex-index.obj": (ERROR,),
    "tinyobjloader/models/issue-140-zero-face-idx.obj": (ERROR,),
    "tinyobjloader/models/issue-161-inconsistent-f.obj": (12,),
    "tinyobjloader/models/issue-295-trianguation-failure.obj": (28,),
    "tinyobjloader/models/issue-319-002.obj": (14,),
    "tinyobjloader/models/issue-330.obj": (3,),
    "tinyobjloader/models/line-prim.obj": (EMPTY,),
    "tinyobjloader/models/points-prim.obj": (EMPTY,),
    "tinyobjloader/models/missing_material_file.obj": (36,),
    "tinyobjloader/models/cube-vertex-w-component.obj": (12,),
    "tinyobjloader/models/leading-zero-in-exponent-notation-issue-210.obj": (1,),
    "tinyobjloader/models/leading-decimal-dot-issue-201.obj": (1,),
    "tinyobjloader/regressions/clusterfuzz-testcase-minimized-fuzz_ParseFromString-4877060179886080.obj": (
        ERROR,
    ),
    "gltf-validator/glb/chunk_too_big.glb": (ERROR,),
    "gltf-validator/glb/truncated_chunk_data.glb": (ERROR,),
    "gltf-validator/glb/length_mismatch.glb": (ERROR,),
    "gltf-validator/glb/invalid_magic.glb": (ERROR,),
    "gltf-validator/glb/empty_file.glb": (ERROR,),
    "gltf-validator/glb/no_header.glb": (ERROR,),
    "gltf-validator/glb/zero_length.glb": (ERROR,),
    "gltf-validator/mesh_data/index_buffer_oob.gltf": (ERROR,),
    "gltf-validator/mesh_data/index_buffer_degenerate_triangle.gltf": (3,),
    "gltf-validator/accessor_data/invalid_elements_float.gltf": (ERROR,),
    "gltf-validator/accessor/unresolved_bufferviews.gltf": (ERROR,),
    "gltf-validator/node/node_loop.gltf": (ERROR,),
    "gltf-validator/json/invalid_syntax.gltf": (ERROR,),
    "gltf-validator/buffer/not_found.gltf": (ERROR,),
    "cgal/degtri_sliding.off": (8,),
    "cgal/tetra_intersected_by_triangle.off": (5,),
    "cgal/open_cube.off": (10,),
    "cgal/hedra.off": (8,),
    "made/truncated_60pct.ply": (ERROR,),
    "made/truncated_60pct.stl": (ERROR,),
    "made/count_0xffffffff.stl": (ERROR,),
    "made/face_count_2e9.ply": (ERROR,),
    "made/nan_vertices.ply": (ERROR,),
    "made/inf_vertex.ply": (ERROR,),
    "made/index_out_of_range.ply": (ERROR, 11100),
    "made/flat_z.ply": (11102,),
    "made/collinear.ply": (11102,),
    "made/one_point.ply": (11102,),
    "made/single_triangle.ply": (1,),
    "made/duplicated_x50.ply": (10000,),
    "made/far_from_origin_1e7.ply": (11102,),
    "made/huge_1e30.ply": (11102,),
    "made/tiny_1e-30.ply": (11102,),
    "made/outlier_1e7x.ply": (11104,),
    "made/grid_aligned_planes.ply": (600,),
}

SECONDS = 20
MEMORY = 2 << 30

# Runs alone, so that neither a hang nor the memory limit can reach the test run: one JSON line a file.
LOADER = """
import json, resource, signal, sys
from pathlib import Path
from clgrid.errors import MeshError
from clgrid.mesh import load

resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]), int(sys.argv[2])))
def late(signum, frame):
    raise KeyboardInterrupt("too slow")
signal.signal(signal.SIGALRM, late)
root = Path(sys.argv[1])
for name in sys.stdin.read().splitlines():
    signal.alarm(int(sys.argv[3]))
    try:
        mesh = load(root / name)
        result = [len(mesh.faces), list(mesh.warnings)]
    except MeshError as error:
        result = ["error", str(error)]
    except BaseException as error:
        result = ["crash", repr(error)]
    signal.alarm(0)
    print(json.dumps([name, *result]), flush=True)
"""


@pytest.fixture(scope="module")
def outcomes() -> dict[str, tuple[object, object]]:
    root = shared_root() / "hostile"
    if not root.is_dir():
        pytest.skip(f"the hostile files are not in {shared_root()} (set CLGRID_SCENES)")
    run = subprocess.run(
        [sys.executable, "-c", LOADER, str(root), str(MEMORY), str(SECONDS)],
        input="\n".join(EXPECTED),
        capture_output=True,
        text=True,
        cwd=Path(__file__).resolve().parents[1],
        timeout=SECONDS * 10,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-2000:]
    return {name: (result, text) for name, result, text in map(json.loads, run.stdout.splitlines())}


def test_the_table_covers_the_manifest() -> None:
    rows = manifest("hostile")
    if not rows:
        pytest.skip(f"the hostile files are not in {shared_root()} (set CLGRID_SCENES)")
    assert {row["file"] for row in rows} == set(EXPECTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_outcome(name: str, outcomes: dict[str, tuple[object, object]]) -> None:
    result, text = outcomes[name]
    if result == "error":
        assert isinstance(text, str)
        assert "\n" not in text
        assert Path(name).name in text
    elif result == 0:
        assert isinstance(text, list)
        assert text, "an empty mesh without a warning"
        result = EMPTY
    assert result in EXPECTED[name], f"{result}: {text}"
