"""What is shown of each kind of record."""

from __future__ import annotations

from collections.abc import Sequence

from clgrid.compare_record import CompareRecord
from clgrid.record import BenchRecord, FramesRecord, RenderRecord, WorkloadRecord
from clgrid.report.model import Page
from clgrid.report.pages import bench, compare, frames, tradeoff, verify, workload
from clgrid.report.read import Run
from clgrid.tradeoff_record import TradeoffRecord
from clgrid.verify_record import VerifyRecord


def page(run: Run, commands: Sequence[str] = ()) -> Page:
    """Return the page of a record.

    Parameters
    ----------
    commands : sequence of str
        How to repeat it, where the record does not say.
    """
    record = run.record
    if isinstance(record, CompareRecord):
        return compare.page(record, commands)
    if isinstance(record, TradeoffRecord):
        return tradeoff.page(record, commands)
    if isinstance(record, WorkloadRecord):
        return workload.page(record, commands)
    if isinstance(record, FramesRecord):
        return frames.page(record, commands)
    if isinstance(record, VerifyRecord):
        return verify.page(record, commands)
    if isinstance(record, RenderRecord):
        return bench.page_of_picture(record, commands)
    if isinstance(record, BenchRecord):
        return bench.page(record, commands)
    raise TypeError(f"no page for {type(record).__name__}")
