"""``clgrid verify``: whether every rung keeps its promises on a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from clgrid.cli import options, output, report_files

if TYPE_CHECKING:
    from rich.table import Table

    from clgrid.verify_record import VerifyRecord, VerifyRow

RAYS = "Rays"

Accuracies = Annotated[
    str,
    typer.Option(
        "--accuracy",
        metavar="NAMES",
        help="Rungs of the accuracy ladder: robust,precise,exact or some of them. Default: all that promise"
        " anything.",
        rich_help_panel=options.GRID,
        show_default=False,
    ),
]
Rays = Annotated[
    int,
    typer.Option(
        min=1,
        help="At vertices, edges and faces; along edges, planes and cells; from afar, from inside; random.",
        rich_help_panel=RAYS,
    ),
]
Check = Annotated[
    int | None,
    typer.Option(
        metavar="RAYS",
        min=0,
        help="Compare so many with brute force. Default: all, or what 4e9 tests of a triangle allow.",
        rich_help_panel=RAYS,
        show_default=False,
    ),
]
Exact = Annotated[
    int,
    typer.Option(
        metavar="RAYS", min=0, help="Compare so many with exact rational arithmetic.", rich_help_panel=RAYS
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Of the rays.", rich_help_panel=RAYS)]
AimedAt = Annotated[
    str,
    typer.Option(
        "--aim",
        metavar="XxYxZ",
        help="Resolution of the grid at whose planes and corners rays are aimed. Default: the first rung's.",
        rich_help_panel=RAYS,
        show_default=False,
    ),
]


def verify(
    scene: options.SceneName,
    accuracy: Accuracies = "",
    rays: Rays = 100_000,
    check: Check = None,
    exact: Exact = 2000,
    seed: Seed = 0,
    aim: AimedAt = "",
    layout: options.Layout = "compact",
    density: options.Density = "auto",
    resolution: options.Resolution = "",
    device: options.DeviceName = None,
    max_memory: options.MaxMemory = "",
    skipping: options.Skipping = False,
    html: report_files.Html = None,
    csv: report_files.Csv = None,
    plot: report_files.Plot = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> int:
    """Check what each rung of accuracy promises, on a scene. Exit code 2: a promise is broken.

    Casts structured rays through the grid, by brute force and, for a sample, in exact arithmetic. What a rung
    does not promise is counted too: parity, ids and counts on robust and precise.
    """
    memory = options.parse_bytes(max_memory)
    cells_per_triangle, cells = options.parse_density(density), options.parse_resolution(resolution)
    aimed_at = options.parse_resolution(aim, "--aim")
    files = report_files.Files(html, csv, plot)
    files.check()

    from clgrid import record
    from clgrid.device import choose
    from clgrid.rungs import LOSSLESS
    from clgrid.scene import load_scene
    from clgrid.verify import Plan, broken_promises
    from clgrid.verify import verify as examine

    plan = Plan(
        accuracies=tuple(dict.fromkeys(name for name in accuracy.split(",") if name)) or LOSSLESS,
        rays=rays,
        check=check,
        exact=exact,
        seed=seed,
        layout=layout,
        density=cells_per_triangle,
        resolution=cells,
        max_memory=memory,
        skipping=skipping,
        aim=aimed_at,
    )
    chosen = choose(device)
    with output.progress(quiet=quiet) as show:
        say = show or (lambda step, share: None)
        say(f"load {scene}", None)
        loaded = load_scene(scene)
        output.warn(loaded.mesh.warnings, quiet=quiet)
        result = output.signed(examine(loaded, plan, chosen, say))
    files.write(result)
    if json:
        output.emit(record.encode(result))
    elif not quiet:
        output.emit_table(_table(result, chosen.description.line()))
        output.emit(_footnote(result))
    broken = broken_promises(result)
    for message in broken:
        typer.echo(f"clgrid: error: {message}", err=True)
    return 2 if broken else 0


def _table(result: VerifyRecord, device: str) -> Table:
    from rich.table import Table
    from rich.text import Text

    title = f"{result.scene}, {result.triangles:,} triangles; {device}"
    table = Table(title=title, title_justify="left", pad_edge=False)
    table.add_column("rays of seed " + str(result.seeds["rays"]), overflow="fold")
    for row in result.rows:
        table.add_column(row.accuracy, justify="right", no_wrap=True)
    for name, check in _LINES:
        table.add_row(name, *(Text(*_cell(row, check)) for row in result.rows))
    table.add_row("worst error of t, in its last places", *map(_worst, result.rows))
    table.add_row("worst, median share of t_err used", *map(_shares, result.rows))
    table.add_row("promises", *("broken" if row.broken else "kept" for row in result.rows))
    return table


# Each check with the number of rays that it is asked of.
_LINES = (
    ("rays", "rays"),
    ("escapes from inside", "escapes"),
    ("even counts from inside", "even_inside"),
    ("odd counts of whole lines", "odd_lines"),
    ("bits other than brute force's", "bits"),
    ("counts other than brute force's", "counts"),
    ("hits where exact arithmetic misses, or the reverse", "wrong_hits"),
    ("nearest triangles other than exact", "wrong_ids"),
    ("counts other than exact", "wrong_counts"),
    ("t farther off than t_err", "late"),
)
_ASKED = {
    **dict.fromkeys(("escapes", "even_inside"), "inside"),
    "odd_lines": "rays",
    **dict.fromkeys(("bits", "counts"), "checked"),
    **dict.fromkeys(("wrong_hits", "wrong_ids", "wrong_counts"), "exact_checked"),
    "late": "exact_hits",
}


def _cell(row: VerifyRow, check: str) -> tuple[str, str]:
    """A number of rays in words, and its colour: red where it breaks a promise."""
    value = getattr(row, check)
    if check not in _ASKED:
        return f"{value:,}", ""
    asked = getattr(row, _ASKED[check])
    if value is None or not asked:
        return "-", ""
    return f"{value:,} of {asked:,}", "red" if check in row.broken else ""


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _worst(row: VerifyRow) -> str:
    return _number(row.worst_ulps)


def _shares(row: VerifyRow) -> str:
    return f"{_number(row.worst_share)}, {_number(row.median_share)}"


def _footnote(result: VerifyRecord) -> str:
    if result.open_edges:
        return (
            f"{result.open_edges:,} edges have an odd number of triangles: the mesh is not closed, so that"
            " nothing is asked of escapes and parity\n"
        )
    if not result.rows[0].inside:
        return "no points well inside of the mesh were found, so that nothing is asked of escapes\n"
    return ""
