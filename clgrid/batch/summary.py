"""What a run did, as one record: for ``--json``, and for the table at the end."""

from __future__ import annotations

from statistics import median

import msgspec

import clgrid
from clgrid import record
from clgrid.batch.item import DONE, FAILED, SKIPPED, ItemRecord
from clgrid.batch.run import Outcome
from clgrid.record import DeviceRecord


class RunRecord(msgspec.Struct, frozen=True, kw_only=True):
    """What a run did.

    Attributes
    ----------
    asked, done, skipped, failed, missing : int
        Items; ``missing`` are those that had not begun when the run was ended.
    seconds : float
        Of the whole run.
    ledger : str
        Where the records of the items are.
    items : list of ItemRecord
    """

    schema: str
    clgrid: str
    device: DeviceRecord | None
    compiled: tuple[str, ...]
    seeds: dict[str, int]
    asked: int
    done: int
    skipped: int
    failed: int
    missing: int
    seconds: float
    ledger: str
    items: list[ItemRecord]


def record_of(outcome: Outcome) -> RunRecord:
    """The record of a run."""
    drawn = [each for each in outcome.records if each.status == DONE]
    last = drawn[-1] if drawn else None
    return RunRecord(
        schema=record.schema("batch"),
        clgrid=clgrid.__version__,
        device=None if last is None else last.device,
        compiled=() if last is None else last.compiled,
        seeds={} if last is None else last.seeds,
        asked=outcome.asked,
        done=outcome.count(DONE),
        skipped=outcome.count(SKIPPED),
        failed=outcome.count(FAILED),
        missing=outcome.asked - len(outcome.records),
        seconds=outcome.seconds,
        ledger=str(outcome.ledger),
        items=outcome.records,
    )


def stages(records: list[ItemRecord]) -> list[tuple[str, float, float]]:
    """Each stage of the work with its seconds in all and its median of those that took any."""
    found = []
    for name in ("wait", "compile", "build", "render", "write"):
        taken = [seconds for each in records for seconds in getattr(each, f"{name}_s") if seconds > 0]
        if taken:
            found.append((name, sum(taken), median(taken)))
    return found
