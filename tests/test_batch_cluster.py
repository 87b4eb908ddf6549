"""A batch on a Dask cluster: complete and identical, also when a worker is killed."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import msgspec
import pytest
from test_batch_run import CAMERAS, files, planned

from clgrid.batch import cluster
from clgrid.batch.item import DONE, FAILED, ItemRecord, about
from clgrid.batch.run import Choices, run
from clgrid.cli.batch_progress import Quiet
from clgrid.device import Device
from clgrid.errors import InputError

ROOT = Path(__file__).resolve().parent.parent
MISSING = "distributed is not installed: pip install '.[dask]'"
TEXT = (
    'scenes = ["cube", "icosphere:2", "terrain:8", "terrain:9", "terrain:10", "terrain:11"]\n'
    'output = "WHERE/{scene}.{camera}.exr"\nsize = [96, 64]\n' + CAMERAS
)


def test_local_is_a_number_of_workers() -> None:
    assert cluster._local_count("local:3") == 3
    assert cluster._local_count("tcp://host:8786") == 0
    for text in ("local:", "local:0", "local:x"):
        with pytest.raises(InputError, match="local:N"):
            cluster._local_count(text)


def test_workers_of_one_machine_share_its_cores_out() -> None:
    shares = [cluster.cores_of(k, 2) or [] for k in range(2)]
    assert sorted(core for share in shares for core in share) == sorted(os.sched_getaffinity(0))
    assert cluster.cores_of("tcp://host:1", 0) is None


class Lost:
    """A task whose result was lost with its worker: it is not finished when it is looked at, and then is."""

    status = "lost"

    def __init__(self, outcome: bytes | Exception) -> None:
        self.outcome = outcome

    def exception(self) -> None:
        return None

    def result(self) -> bytes:
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return self.outcome


@pytest.mark.host
def test_a_result_lost_with_its_worker_is_waited_for(tmp_path) -> None:
    item = planned(tmp_path, TEXT.replace("WHERE", "one")).items[0]
    record = about(item, "0", DONE)
    assert cluster._record(Lost(msgspec.json.encode(record)), item) == record
    failed = cluster._record(Lost(RuntimeError("three\nworkers died")), item)
    assert (failed.status, failed.error) == (FAILED, "RuntimeError: three")


class Killer(Quiet):
    """Kills a worker once the first picture is there."""

    def __init__(self, victim: int) -> None:
        self.victim = victim

    def item(self, record: ItemRecord) -> None:
        if self.victim:
            os.kill(self.victim, signal.SIGKILL)
            self.victim = 0


@pytest.mark.slow
@pytest.mark.host
def test_three_workers_one_killed_give_the_same_pictures(tmp_path, device: Device, monkeypatch) -> None:
    distributed = pytest.importorskip(
        "distributed", reason="distributed is not installed: pip install '.[dask]'"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    choices = Choices(device=device.label)
    assert run(planned(tmp_path, TEXT.replace("WHERE", "one")), choices, Quiet()).complete
    workers = distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, resources={cluster.RESOURCE: 1}, dashboard_address=None
    )
    with workers, distributed.Client(workers, set_as_default=False) as client:
        pids = client.run(os.getpid)
        killer = Killer(next(iter(pids.values())))
        plan = planned(tmp_path, TEXT.replace("WHERE", "many"))
        outcome = cluster.run_on_cluster(plan, choices, killer, workers.scheduler_address)
    assert killer.victim == 0
    assert outcome.complete, [record.error for record in outcome.records]
    assert files(tmp_path / "many") == files(tmp_path / "one")


@pytest.mark.slow
@pytest.mark.host
def test_a_cluster_without_the_resource_is_refused(tmp_path, device: Device) -> None:
    distributed = pytest.importorskip(
        "distributed", reason="distributed is not installed: pip install '.[dask]'"
    )
    plan = planned(tmp_path, TEXT.replace("WHERE", "many"))
    with (
        distributed.LocalCluster(n_workers=1, dashboard_address=None) as workers,
        pytest.raises(InputError, match="--resources clgrid=1"),
    ):
        cluster.run_on_cluster(plan, Choices(), Quiet(), workers.scheduler_address)
