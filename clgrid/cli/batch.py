"""``clgrid batch``: all pictures of a job."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clgrid import units
from clgrid.cli import options, output
from clgrid.errors import InputError

if TYPE_CHECKING:
    from clgrid.batch.job import Job
    from clgrid.batch.run import Outcome
    from clgrid.batch.spawn import Spawned

JOB = "Job"
# Not all pictures are there; 128 and the signal's number where one ended the run.
INCOMPLETE = 4

JobFile = Annotated[Path, typer.Argument(metavar="JOB.toml", help="The job file.", show_default=False)]
ShardOption = Annotated[
    str,
    typer.Option(
        "--shard",
        metavar="I/N",
        help="One of N equal parts of the job, from 1/N to N/N.",
        rich_help_panel=JOB,
        show_default=False,
    ),
]
SkipExisting = Annotated[
    bool,
    typer.Option(
        "--skip-existing",
        help="Leave pictures that are whole and were made of the same files, options and version.",
        rich_help_panel=JOB,
    ),
]
KeepGoing = Annotated[
    bool,
    typer.Option(
        "--keep-going/--stop-at-first-failure",
        help="Whether an item that fails ends the run.",
        rich_help_panel=JOB,
    ),
]
TimeLimit = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="Longest time of an item, unless the job has its own.",
        rich_help_panel=JOB,
        show_default=False,
    ),
]
Retries = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="Further tries of an item whose process died or took too long, unless the job says. Default: 1.",
        rich_help_panel=JOB,
        show_default=False,
    ),
]
Sheet = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.html",
        help="Write a contact sheet: thumbnails, seconds, failures.",
        rich_help_panel=options.OUTPUT,
        show_default=False,
    ),
]
Dask = Annotated[
    str,
    typer.Option(
        metavar="tcp://...|local:N",
        help="Draw on the workers of a Dask cluster, or on N processes here.",
        rich_help_panel=JOB,
        show_default=False,
    ),
]


def batch(
    job: JobFile,
    shard: ShardOption = "",
    skip_existing: SkipExisting = False,
    keep_going: KeepGoing = True,
    time_limit: TimeLimit = None,
    retries: Retries = None,
    dask: Dask = "",
    sheet: Sheet = None,
    device: options.DeviceName = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> int:
    """Draw all pictures of a job file. Exit code 0 only if all are there, else 4."""
    from clgrid.batch.spawn import spawned_early

    with spawned_early(wanted=not dask) as spawned:
        from clgrid.batch.job import read_job

        return run_job(
            read_job(job),
            job.absolute().parent,
            shard=shard,
            skip_existing=skip_existing,
            keep_going=keep_going,
            time_limit=time_limit,
            retries=retries,
            dask=dask,
            sheet=sheet,
            device=device,
            json=json,
            quiet=quiet,
            spawned=spawned,
        )


def run_job(
    job: Job,
    base: Path,
    *,
    shard: str,
    skip_existing: bool,
    keep_going: bool,
    time_limit: float | None,
    retries: int | None,
    dask: str,
    sheet: Path | None,
    device: str | None,
    json: bool,
    quiet: bool,
    spawned: Spawned | None = None,
) -> int:
    """Draw a job and say what became of it; the exit code."""
    import msgspec

    from clgrid.batch.plan import Shard, parse_shard, plan
    from clgrid.batch.run import Choices, run
    from clgrid.cli.batch_progress import shown

    if sheet is not None and not sheet.absolute().parent.is_dir():
        raise InputError(f"--sheet {sheet}: no such folder; create it")
    part = parse_shard(shard) if shard else Shard()
    given = {"time_limit": time_limit, "retries": retries}
    missing = {name: value for name, value in given.items() if getattr(job, name) is None}
    planned = plan(msgspec.structs.replace(job, **missing), base)
    choices = Choices(part, skip_existing, keep_going, device or job.device)
    with shown(len(part.of(planned.items)), quiet=quiet) as show:
        if dask:
            from clgrid.batch.cluster import run_on_cluster

            outcome = run_on_cluster(planned, choices, show, dask)
        else:
            outcome = run(planned, choices, show, spawned=spawned)
    if sheet is not None:
        from clgrid.batch.sheet import write_sheet

        write_sheet(sheet, outcome)
    _report(outcome, json=json, quiet=quiet)
    if outcome.signal:
        return 128 + outcome.signal
    return 0 if outcome.complete else INCOMPLETE


def _report(outcome: Outcome, *, json: bool, quiet: bool) -> None:
    from clgrid.batch.summary import record_of, stages
    from clgrid.record import encode

    record = record_of(outcome)
    if json:
        output.emit(encode(record))
        return
    if quiet:
        return
    counts = [("drawn", record.done), ("already there", record.skipped), ("failed", record.failed)]
    counts += [("not begun", record.missing)]
    told = [
        (name, f"{count:,} of {record.asked:,} items") for name, count in counts if count or name == "drawn"
    ]
    for name, total, middle in stages(outcome.records):
        told.append((name, f"{units.seconds(total)} in all, {units.seconds(middle)} the median"))
    told.append(("time", units.seconds(record.seconds)))
    written = sum(each.bytes for item in outcome.records for each in item.outputs)
    told.append(("pictures", units.bytes_text(written)))
    told.append(("records", record.ledger))
    told += [(f"item {each.item}", each.error) for each in outcome.records if each.error][:_MOST_TOLD]
    output.emit_pairs(told)


# Failures in the table; all of them are in the records.
_MOST_TOLD = 20
