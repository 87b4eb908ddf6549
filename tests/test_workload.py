from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from agreement import KINDS
from meshes import MESHES

import clgrid
from clgrid import workload as module
from clgrid.bench import Work
from clgrid.camera import Camera
from clgrid.cli import main
from clgrid.errors import InputError
from clgrid.hits import Hits
from clgrid.mesh import Mesh
from clgrid.procedural import cube, icosphere, terrain
from clgrid.record import BenchRecord, WorkloadRecord, decode, encode
from clgrid.scene import Scene, default_camera
from clgrid.wavefront import (
    NAMES,
    Batch,
    Workload,
    batches,
    camera_rays,
    diffuse_rays,
    light_position,
    random_rays,
)
from clgrid.workload import Survey, bench_workload, bench_workloads, bit_rows, broken_promises, even_parts

SMALL = Work(width=24, height=16, repetitions=2, density=4.0)


def all_batches(mesh: Mesh, device: object, workload: Workload, view: Camera | None = None) -> list[Batch]:
    survey = Survey(clgrid.build(mesh, device=device), workload, 1)
    return list(batches(mesh, view or view_of(mesh), 24, 16, workload, survey.look))


def view_of(mesh: Mesh) -> Camera:
    return default_camera(mesh, 24 / 16)


def outside_light(mesh: Mesh) -> np.ndarray:
    def look(batch: Batch) -> Hits:
        raise AssertionError("seen from outside, no ray is needed")

    return light_position(mesh, view_of(mesh), look)


def room() -> Mesh:
    """A closed box from -1 to 1 with a ball of radius 0.3 in its middle."""
    walls, ball = cube(), icosphere(3)
    return Mesh(
        np.concatenate([walls.vertices, ball.vertices * np.float32(0.3)]),
        np.concatenate([walls.faces, ball.faces + np.uint32(len(walls.vertices))]),
    )


def falsify(monkeypatch, change) -> None:
    """Let brute force give other answers than it found."""
    right = module.brute_force

    def wrong(*rays: object, **options: object) -> Hits:
        return change(right(*rays, **options))

    monkeypatch.setattr(module, "brute_force", wrong)


def changed(hits: Hits, field: str, where: int) -> Hits:
    values = getattr(hits, field).copy()
    flat = values.reshape(-1)
    flat[where] = (
        flat[where] + 1 if field == "primitive_ids" else np.nextafter(flat[where], flat.dtype.type(9))
    )
    if field in hits.computed:
        return replace(hits, computed={**hits.computed, field: values})
    return replace(hits, **{field: values})


# Rays


def test_primary_rays_are_the_cameras_in_tiles():
    mesh = icosphere(2)
    view = default_camera(mesh, 20 / 12)
    rays = camera_rays(view, 20, 12)
    origins, directions = view.rays(20, 12)
    first_tile = directions[:8, :8].reshape(-1, 3)
    assert np.array_equal(rays.directions[:64], first_tile)
    assert np.array_equal(rays.directions[64:128], directions[:8, 8:16].reshape(-1, 3))
    assert sorted(map(tuple, rays.directions)) == sorted(map(tuple, directions.reshape(-1, 3)))
    assert np.array_equal(rays.origins, origins.reshape(-1, 3))
    assert rays.origins.flags.c_contiguous
    assert rays.directions.flags.c_contiguous


def test_shadow_rays_end_at_the_light_and_start_on_the_viewers_side(device):
    mesh = icosphere(3)
    (rays,) = all_batches(mesh, device, Workload("shadow"))
    primary = camera_rays(view_of(mesh), 24, 16)
    hits = clgrid.build(mesh, device=device).cast(primary.origins, primary.directions)
    points, normals = hits.points[hits.mask], hits.primitive_normals[hits.mask]
    assert rays.t_max == 1.0
    assert np.allclose(rays.origins + rays.directions, outside_light(mesh), atol=1e-12)
    # The triangles of a ball wind outwards, and that is where the viewer is.
    height = np.einsum("ij,ij->i", rays.origins - points, normals)
    assert np.allclose(height, 2.0 * 2.0**-16, rtol=1e-2)
    assert (outside_light(mesh) > mesh.bounds[1]).all()


@pytest.mark.parametrize("scale", [1.0, 2.0**60, 1e-20])
def test_a_ball_shades_itself_where_it_turns_from_the_light_and_nowhere_else(device, scale):
    ball = icosphere(3)
    mesh = Mesh((ball.vertices * np.float32(scale)), ball.faces)
    (rays,) = all_batches(mesh, device, Workload("shadow"))
    grid = clgrid.build(mesh, device=device)
    below = grid.cast(rays.origins, -rays.origins, t_max=1.0)
    assert below.mask.all()
    towards = np.einsum("ij,ij->i", below.primitive_normals, rays.directions)
    shaded = grid.cast(rays.origins, rays.directions, t_max=rays.t_max).mask
    assert np.array_equal(shaded, towards < 0)
    assert shaded.any()
    assert not shaded.all()


def test_no_path_meets_a_convex_body_twice(device):
    row = bench_workload("icosphere:4", Workload("diffuse"), SMALL, device)
    kinds = {kind.kind: kind for kind in row.kinds}
    assert list(kinds) == ["primary", "shadow", "bounce 1"]
    assert kinds["primary"].hits == kinds["bounce 1"].rays > 0
    assert kinds["bounce 1"].hits == 0


def test_flipped_triangles_give_the_same_start_points(device):
    mesh = icosphere(2)
    turned = Mesh(mesh.vertices, np.ascontiguousarray(mesh.faces[:, ::-1]))
    (one,), (other,) = (all_batches(m, device, Workload("shadow")) for m in (mesh, turned))
    assert np.allclose(one.origins, other.origins, rtol=0, atol=1e-5)


def test_paths_go_on_where_they_hit_until_the_last_bounce(device):
    found = all_batches(terrain(24), device, Workload("diffuse", bounces=3))
    kinds = [batch.kind for batch in found]
    assert kinds[:3] == ["primary", "shadow", "bounce 1"]
    assert len(kinds) <= 2 * 3 + 2
    sizes = [len(batch.origins) for batch in found]
    assert sizes[1] == sizes[2]
    for shadow, onward in zip(found[1::2], found[2::2], strict=False):
        assert (shadow.kind, onward.kind[:6]) == ("shadow", "bounce")
        assert np.array_equal(shadow.origins, onward.origins)
    assert sizes[2::2] == sorted(sizes[2::2], reverse=True)


def test_diffuse_directions_spread_as_the_cosine():
    normals = np.tile([[0.6, 0.0, 0.8]], (200_000, 1))
    rays = diffuse_rays(np.zeros_like(normals), normals, np.random.default_rng(3), 1)
    unit = rays.directions / np.linalg.norm(rays.directions, axis=1, keepdims=True)
    cosine = unit @ normals[0]
    assert (cosine > 0).all()
    # Of the density cos/pi: cos^2 is uniform, so its mean is 1/2; the mean direction is 2/3 normal.
    assert np.mean(cosine**2) == pytest.approx(0.5, abs=0.005)
    assert np.allclose(unit.mean(axis=0), normals[0] * 2 / 3, atol=0.005)


def test_a_seed_gives_the_same_rays_and_another_one_others(device):
    mesh = MESHES["torus"]
    one, same, other = (all_batches(mesh, device, Workload("diffuse", seed=seed)) for seed in (5, 5, 6))
    assert [batch.kind for batch in one] == [batch.kind for batch in same]
    assert len(one) > 4
    for a, b in zip(one, same, strict=True):
        assert np.array_equal(a.origins, b.origins)
        assert np.array_equal(a.directions, b.directions)
    assert np.array_equal(one[0].directions, other[0].directions)
    assert not np.array_equal(one[2].directions, other[2].directions)


def test_the_size_of_the_sample_changes_no_ray(device):
    rows = [
        bench_workload("icosphere:2", Workload("diffuse", check=check), SMALL, device) for check in (7, 500)
    ]
    assert [[(k.kind, k.rays, k.hits) for k in row.kinds] for row in rows[:1]] == [
        [(k.kind, k.rays, k.hits) for k in row.kinds] for row in rows[1:]
    ]
    assert [row.checked for row in rows] == [7, 500]


def test_inside_a_room_the_light_is_near_the_eye_and_not_behind_a_wall(device):
    mesh = room()
    size = 2.0
    for eye, target, distance in (
        ([0.8, 0.1, 0.1], [0.0, 0.0, 0.0], size / 16),
        # The upper right corner of the picture is at the wall, 0.02 sqrt 2 away from the eye.
        ([0.98, 0.98, 0.5], [0.98, 0.98, -0.5], 0.02 * np.sqrt(2) / 2),
    ):
        view = Camera.look_at(eye, target)
        look = Survey(clgrid.build(mesh, device=device), Workload("shadow"), 1).look
        light = light_position(mesh, view, look)
        away = light - eye
        assert np.linalg.norm(away) == pytest.approx(distance, rel=1e-4)
        assert away @ view.forward == pytest.approx(0, abs=1e-12)
        assert away @ view.right == pytest.approx(away @ view.up)
        assert away @ view.up > 0


def test_a_room_has_light_and_shade_only_from_a_light_inside(device):
    mesh, view = room(), Camera.look_at([0.8, 0.1, 0.1], [0.0, 0.0, 0.0], fov=80)
    (rays,) = all_batches(mesh, device, Workload("shadow"), view)
    shaded = clgrid.build(mesh, device=device).cast(rays.origins, rays.directions, t_max=rays.t_max).mask
    assert len(shaded) == 24 * 16
    assert 0 < np.mean(shaded) < 0.5


def test_random_rays_come_from_a_sphere_and_go_through_the_bounds():
    mesh = terrain(24)
    rays = random_rays(mesh, 20_000, 0)
    low, high = np.asarray(mesh.bounds, np.float64)
    radius = np.linalg.norm(rays.origins - (low + high) / 2, axis=1)
    assert np.allclose(radius, np.linalg.norm(high - low), rtol=1e-12)
    through = (rays.origins + rays.directions - low) / (high - low)
    assert (through > -1e-9).all()
    assert (through < 1 + 1e-9).all()
    # Uniform in both: means of so many differ from those of the distributions by less than five deviations.
    assert np.allclose(through.mean(axis=0), 0.5, atol=5 * np.sqrt(1 / 12 / 20_000))
    assert np.allclose(((rays.origins - (low + high) / 2) / radius[:, None]).mean(axis=0), 0, atol=0.021)
    assert np.isinf(rays.t_max)


def test_random_rays_are_seeded_and_as_many_as_asked(device):
    mesh = icosphere(2)
    (given,) = all_batches(mesh, device, Workload("random"))
    assert (given.kind, given.origins.shape) == ("random", (24 * 16, 3))
    one, same, other = (all_batches(mesh, device, Workload("random", seed=s, rays=99))[0] for s in (5, 5, 6))
    assert one.origins.shape == (99, 3)
    assert np.array_equal(one.origins, same.origins)
    assert np.array_equal(one.directions, same.directions)
    assert not np.isclose(one.origins, other.origins).all(axis=1).any()


@pytest.mark.parametrize("name", ["far_float64", "times_1e-30", "flat", "one"])
def test_random_rays_are_sound_for_meshes_that_strain(device, name):
    (rays,) = all_batches(MESHES[name], device, Workload("random"))
    assert np.isfinite(rays.origins).all()
    assert (rays.directions != 0).any(axis=1).all()
    assert len(np.unique(rays.origins, axis=0)) == len(rays.origins)


# Rows


@pytest.mark.parametrize("skipping", [False, True])
@pytest.mark.parametrize("name", ["diffuse", "random"])
def test_steps_per_ray_are_the_means_of_what_the_casts_count(device, name, skipping):
    work, workload = replace(SMALL, skipping=skipping), Workload(name, bounces=2)
    row = bench_workload("terrain:24", workload, work, device)
    grid = clgrid.build(terrain(24), density=4.0, skipping=skipping, device=device)
    counted: dict[str, list[int]] = {}
    for batch in all_batches(grid.mesh, device, workload):
        hits = grid.cast(batch.origins, batch.directions, t_max=batch.t_max, fields=("steps",))
        counted.setdefault(batch.kind, []).extend(hits["steps"].tolist())
    assert row.skipping is skipping
    assert {k.kind: k.steps_per_ray for k in row.kinds} == {k: np.mean(v) for k, v in counted.items()}
    assert row.steps_per_ray == pytest.approx(np.mean([s for steps in counted.values() for s in steps]))


def test_skipping_makes_steps_fewer_and_counts_its_bytes(device):
    plain, skipping = (
        bench_workload("icosphere:5", Workload("random"), replace(SMALL, density=64, skipping=choice), device)
        for choice in (False, True)
    )
    assert 2 * skipping.steps_per_ray < plain.steps_per_ray
    assert skipping.grid_bytes > plain.grid_bytes


def test_the_camera_of_the_work_casts_the_rays(device):
    work = replace(SMALL, view=lambda scene, aspect: Camera.look_at([5.0, 0, 0], [9.0, 0, 0]))
    row = bench_workload("icosphere:2", Workload("primary"), work, device)
    assert (row.rays, row.hits, row.eye) == (24 * 16, 0, (5.0, 0.0, 0.0))


@pytest.mark.parametrize("name", NAMES)
def test_a_row_adds_up_and_equals_brute_force(device, name):
    row = bench_workload("terrain:24", Workload(name, bounces=3, check=300), SMALL, device)
    assert (row.workload, row.bounces) == (name, 3 if name == "diffuse" else 0)
    assert row.rays == sum(kind.rays for kind in row.kinds) > 0
    assert row.hits == sum(kind.hits for kind in row.kinds)
    assert all(len(kind.cast_s) == 2 and min(kind.cast_s) > 0 for kind in row.kinds)
    for k in range(2):
        assert row.cast_s[k] == pytest.approx(sum(kind.cast_s[k] for kind in row.kinds))
    assert row.mrays_per_s > 0
    assert 0 < row.grid_bytes <= row.peak_bytes
    assert (row.checked, row.differing, row.differing_share) == (min(300, row.rays), 0, 0.0)


@pytest.mark.parametrize("name", ["needle_fan", "far_float64", "times_1e-30", "flat", "one"])
def test_meshes_that_strain_equal_brute_force_too(device, name):
    scene = Scene(name, MESHES[name])
    view = view_of(scene.mesh)
    survey = Survey(SMALL.build(scene, device, view), Workload("diffuse"), 1)
    for batch in batches(scene.mesh, view, 24, 16, Workload("diffuse"), survey.look):
        survey.measure(batch)
    checked, differing = survey.compare()
    assert checked == sum(kind.rays for kind in survey.kinds.values()) > 0
    assert differing == 0


@pytest.mark.thorough
@pytest.mark.parametrize(("layout", "skipping"), KINDS)
def test_every_layout_casts_the_same_rays_with_the_same_hits(device, layout, skipping):
    work = replace(SMALL, layout=layout, skipping=skipping)
    row = bench_workload("terrain:24", Workload("diffuse", seed=2), work, device)
    plain = bench_workload("terrain:24", Workload("diffuse", seed=2), SMALL, device)
    assert (row.layout, row.differing, row.checked) == (layout, 0, row.rays)
    assert [(k.kind, k.rays, k.hits) for k in row.kinds] == [(k.kind, k.rays, k.hits) for k in plain.kinds]


@pytest.mark.parametrize("field", ["t_hit", "primitive_ids", "primitive_uvs"])
def test_one_changed_bit_is_a_difference(device, monkeypatch, field):
    falsify(monkeypatch, lambda hits: changed(hits, field, 3))
    row = bench_workload("icosphere:2", Workload("diffuse", check=64), SMALL, device)
    assert (row.checked, row.differing, row.differing_share) == (64, 1, 1 / 64)


def test_bits_count_and_not_values(device):
    hits = clgrid.build(icosphere(1), device=device).cast(np.zeros((2, 3)), [[1, 0, 0], [0, 0, 1]])
    uvs = hits.primitive_uvs
    negative, zero, minus = (
        replace(hits, computed={"primitive_uvs": np.asarray(values, np.float32)})
        for values in (np.where(uvs == 0, -0.0, uvs), np.zeros_like(uvs), np.full_like(uvs, -0.0))
    )
    assert bit_rows(hits).shape == (2, 4)
    assert np.array_equal(bit_rows(negative)[:, :2], bit_rows(hits)[:, :2])
    assert (bit_rows(zero) != bit_rows(minus)).any(axis=1).all()


def test_the_sample_is_spread_over_all_batches(device, monkeypatch):
    seen: list[np.ndarray] = []
    right = module.brute_force

    def spy(mesh: Mesh, origins: np.ndarray, *rest: object, **options: object) -> Hits:
        seen.append(origins)
        return right(mesh, origins, *rest, **options)

    monkeypatch.setattr(module, "brute_force", spy)
    mesh = MESHES["torus"]
    workload = Workload("diffuse", bounces=2, check=60)
    survey = Survey(clgrid.build(mesh, device=device), workload, 1)
    cast = []
    for batch in batches(mesh, view_of(mesh), 64, 64, workload, survey.look):
        survey.measure(batch)
        cast.append(batch)
    assert survey.compare() == (60, 0)
    (origins,) = seen
    assert len(cast) == 6
    for batch, part in zip(cast, origins.reshape(6, 10, 3), strict=True):
        assert (batch.origins[None] == part[:, None]).all(-1).any(1).all()


@pytest.mark.parametrize(
    ("sizes", "total", "parts"),
    [
        ([9, 9, 9], 9, [3, 3, 3]),
        ([9, 1, 9], 9, [4, 1, 4]),
        ([2, 3], 9, [2, 3]),
        ([5, 5], 0, [0, 0]),
        ([], 4, []),
    ],
)
def test_parts_are_even_and_never_more_than_there_are(sizes, total, parts):
    assert even_parts(sizes, total) == parts


def test_the_sample_shrinks_with_the_triangles_and_says_so():
    assert Workload("primary").sample_size(871_414) == 4096
    assert Workload("primary").sample_size(56_000_000) == 71
    assert Workload("primary", check=10).sample_size(0) == 10


def test_without_a_sample_there_is_no_share(device):
    row = bench_workload("cube", Workload("primary", check=0), SMALL, device)
    assert (row.checked, row.differing, row.differing_share) == (0, 0, None)


@pytest.mark.parametrize("name", NAMES)
def test_scenes_without_triangles_have_a_row(device, tmp_path, name):
    (tmp_path / "empty.off").write_text("OFF\n0 0 0\n")
    row = bench_workload(str(tmp_path / "empty.off"), Workload(name), SMALL, device)
    assert (row.triangles, row.hits, row.grid_bytes, row.differing) == (0, 0, 0, 0)
    assert row.rays == (0 if name in ("shadow", "random") else 24 * 16)
    assert len(row.cast_s) == 2


def test_one_bad_scene_does_not_stop_the_others(device, tmp_path):
    names = [str(tmp_path / "none.ply"), "cube"]
    result = bench_workloads(names, Workload("shadow", seed=9), SMALL, device)
    assert [row.scene for row in result.rows] == ["cube"]
    assert [failure.scene for failure in result.failures] == names[:1]
    assert result.seeds == {"workload": 9}
    assert result.schema == "clgrid.bench.workload/1"
    assert decode(encode(result), WorkloadRecord) == result
    assert broken_promises(result) == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"name": "sphere"},
        {"bounces": 0},
        {"bounces": 65},
        {"seed": -1},
        {"check": -1},
        {"rays": 0},
        {"rays": 2**24 + 1},
    ],
)
def test_workloads_out_of_range_are_input_errors(wrong):
    with pytest.raises(InputError):
        Workload(**{"name": "diffuse", **wrong})


def test_too_many_pixels_are_an_input_error(device):
    with pytest.raises(InputError, match="pixels"):
        bench_workload("cube", Workload("primary"), Work(8192, 8192, 1), device)


# Command line


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)

    def call(*words: str):
        with pytest.raises(SystemExit) as exit_:
            main(words)
        streams = capsys.readouterr()
        return exit_.value.code, streams.out, streams.err

    return call


def test_the_table_has_a_line_a_kind(run, device):
    code, out, err = run(
        "bench", "terrain:24", "--workload", "diffuse", "--bounces", "3", "--size", "16x16", "--reps", "2",
        "--check", "50", "--device", device.label,
    )  # fmt: skip
    assert (code, err) == (0, "")
    for word in (
        "terrain:24",
        "primary",
        "shadow",
        "bounce 1",
        "Mrays/s",
        "steps/ray",
        "0 of 50",
        "medians of 2",
    ):
        assert word in " ".join(out.split()), word  # a long device name breaks the title's line


def test_json_is_one_strict_document(run, device):
    code, out, err = run(
        "bench", "cube", "--workload", "primary", "--size", "16x16", "--reps", "1", "--json", "--seed", "4",
        "--device", device.label,
    )  # fmt: skip
    assert (code, err) == (0, "")
    found = decode(out, WorkloadRecord)
    assert (found.rows[0].rays, found.seeds) == (256, {"workload": 4})
    assert found.process_peak_bytes is None or found.process_peak_bytes > 1 << 20


def test_options_choose_camera_and_rays(run, device):
    common = ("--size", "16x16", "--reps", "1", "--json", "--device", device.label)
    away = ("--eye", "5,0,0", "--look-at", "9,0,0", "--up", "y", "--fov", "30")
    code, out, _ = run("bench", "cube", "--workload", "primary", *away, *common)
    row = decode(out, WorkloadRecord).rows[0]
    assert (code, row.hits, row.eye) == (0, 0, (5.0, 0.0, 0.0))
    code, out, _ = run("bench", "cube", "--workload", "random", "--rays", "77", *common)
    row = decode(out, WorkloadRecord).rows[0]
    assert (code, row.rays, [kind.kind for kind in row.kinds]) == (0, 77, ["random"])
    code, out, _ = run("bench", "cube", *away, *common)
    assert (code, decode(out, BenchRecord).rows[0].hits) == (0, 0)


def test_a_difference_is_exit_code_2_and_a_line(run, device, monkeypatch):
    falsify(monkeypatch, lambda hits: changed(hits, "t_hit", 0))
    code, out, err = run(
        "bench", "icosphere:2", "nosuch.ply", "--workload", "primary", "--size", "16x16", "--reps", "1",
        "--check", "20", "--json", "--device", device.label,
    )  # fmt: skip
    assert code == 2
    assert decode(out, WorkloadRecord).rows[0].differing == 1
    assert re.search(r"^clgrid: error: icosphere:2: 1 of 20 rays differ from brute force", err, re.M)
    assert "nosuch.ply" in err


@pytest.mark.parametrize(
    "words",
    [
        ["--workload", "sphere"],
        ["--workload", "diffuse", "--bounces", "0"],
        ["--workload", "diffuse", "--seed", "-1"],
        ["--workload", "diffuse", "--check", "many"],
        ["--workload", "primary", "--bounces", "3"],
        ["--workload", "primary", "--frames", "a.npy"],
        ["--bounces", "3"],
        ["--seed", "1"],
        ["--check", "1"],
        ["--rays", "9"],
        ["--workload", "primary", "--rays", "9"],
        ["--workload", "random", "--rays", "0"],
        ["--workload", "random", "--bounces", "3"],
        ["--workload", "primary", "--camera", "none"],
        ["--workload", "primary", "--camera", "0", "--eye", "1,2,3"],
        ["--workload", "primary", "--eye", "1,2"],
        ["--eye", "1,2"],
    ],
)
def test_mistakes_end_in_one_line_and_exit_code_1(run, words):
    code, out, err = run("bench", "cube", *words)
    assert (code, out) == (1, "")
    assert re.fullmatch(r"clgrid: error: [^\n]+\n", err), err
