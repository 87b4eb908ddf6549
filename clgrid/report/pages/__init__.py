"""What is shown of each kind of record."""

from __future__ import annotations

from clgrid.compare_record import CompareRecord
from clgrid.record import BenchRecord, FramesRecord, RenderRecord, WorkloadRecord
from clgrid.report.model import Page
from clgrid.report.pages import bench, compare, frames, tradeoff, verify, workload
from clgrid.report.read import Run
from clgrid.tradeoff_record import TradeoffRecord
from clgrid.verify_record import VerifyRecord


def page(run: Run) -> Page:
    """Return the page of a record."""
    record = run.record
    if isinstance(record, CompareRecord):
        return compare.page(record)
    if isinstance(record, TradeoffRecord):
        return tradeoff.page(record)
    if isinstance(record, WorkloadRecord):
        return workload.page(record)
    if isinstance(record, FramesRecord):
        return frames.page(record)
    if isinstance(record, VerifyRecord):
        return verify.page(record)
    if isinstance(record, RenderRecord):
        return bench.page_of_picture(record)
    if isinstance(record, BenchRecord):
        return bench.page(record)
    raise TypeError(f"no page for {type(record).__name__}")
