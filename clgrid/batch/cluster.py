"""A batch on a Dask cluster: items are tasks, a worker keeps one child process with one OpenCL context.

Items and records go over the network. Pictures go to the file system that all machines share, by the
same rename as anywhere. A worker that dies costs what is under way there one more try, on another.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator
from typing import Any

import msgspec

import clgrid
from clgrid.batch.hand import UNDER_WAY, Hand
from clgrid.batch.item import FAILED, Item, ItemRecord, about
from clgrid.batch.plan import Plan
from clgrid.batch.run import Choices, Outcome, Show, run
from clgrid.errors import InputError

# Of each worker there is one, whose child draws one item at a time: so a device is never shared. A task takes
# a part of it, so that one is drawn while another is read or written.
RESOURCE = "clgrid"
_TAKEN = 1 / UNDER_WAY
_PLUGIN = "clgrid-batch"
_LOCAL = "local:"


def run_on_cluster(plan: Plan, choices: Choices, show: Show, address: str) -> Outcome:
    """Draw what a plan asks for on a cluster's workers.

    Parameters
    ----------
    plan, choices, show
        As of ``run``.
    address : str
        Of the scheduler, ``tcp://host:port``; or ``local:N`` for N workers on this machine.

    Raises
    ------
    InputError
        If ``distributed`` is not installed, or the cluster has no worker for us.
    """
    try:
        import distributed
    except ImportError as error:
        raise InputError("--dask: distributed is not installed; pip install 'clgrid[dask]'") from error
    # It tells of every connection; what matters is in the records.
    logging.getLogger("distributed").setLevel(logging.ERROR)
    count = _local_count(address)
    if count:
        made = distributed.LocalCluster(
            n_workers=count, threads_per_worker=UNDER_WAY, resources={RESOURCE: 1}, dashboard_address=None
        )
    else:
        made = address
    try:
        try:
            client = distributed.Client(made, timeout="30s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(f"--dask {address}: no scheduler answers ({error})") from error
        with client:
            return run(plan, choices, show, lambda ledger: Cluster(client, choices.device, count))
    finally:
        if count:
            made.close()


def _local_count(address: str) -> int:
    """N of ``local:N``; 0 of an address."""
    if not address.startswith(_LOCAL):
        return 0
    number = address.removeprefix(_LOCAL)
    if not number.isdecimal() or not 1 <= int(number) <= 256:
        raise InputError(f"--dask {address!r}: give local:N with N from 1, or the address of a scheduler")
    return int(number)


class Cluster:
    """Those who draw, on a cluster."""

    def __init__(self, client: Any, device: str | None, local: int) -> None:
        self._client = client
        self._stopping = False
        workers = client.scheduler_info(n_workers=-1)["workers"].values()
        self._most = sum(
            min(worker["nthreads"], UNDER_WAY) for worker in workers if RESOURCE in worker["resources"]
        )
        if not self._most:
            raise InputError(
                f"--dask: no worker has the resource {RESOURCE}, which keeps a device to one item at a time; "
                f"start them with: dask worker ADDRESS --nthreads {UNDER_WAY} --resources {RESOURCE}=1"
            )
        client.register_plugin(_plugin(device, local), name=_PLUGIN)

    def draw(self, items: Iterable[Item]) -> Iterator[ItemRecord]:
        """Draw items, two a worker; the next one is handed out when a record comes back."""
        from distributed import as_completed

        source = iter(items)
        by_key: dict[str, Item] = {}
        tasks = as_completed([], loop=self._client.loop)
        while True:
            while not self._stopping and len(by_key) < self._most:
                item = next(source, None)
                if item is None:
                    break
                task = self._submit(item)
                by_key[task.key] = item
                tasks.add(task)
            if not by_key:
                return
            done = next(tasks)
            yield _record(done, by_key.pop(done.key))

    def _submit(self, item: Item) -> Any:
        return self._client.submit(
            _draw, msgspec.json.encode(item), resources={RESOURCE: _TAKEN}, pure=False, retries=0
        )

    def stop(self) -> None:
        """Finish what is begun, and hand out no more."""
        self._stopping = True

    def kill(self) -> None:
        """End the children on all workers at once."""
        self._client.unregister_worker_plugin(_PLUGIN)

    def close(self) -> None:
        """End the children, which have nothing to do."""
        self._client.unregister_worker_plugin(_PLUGIN)


def _record(done: Any, item: Item) -> ItemRecord:
    try:
        # A worker that dies after its task takes the result along; this then waits for the next try.
        return msgspec.json.decode(done.result(), type=ItemRecord)
    except Exception as error:  # what the scheduler says, such as that several workers died at this one
        said = f"{type(error).__name__}: {error}".splitlines()[0]
    return msgspec.structs.replace(about(item, clgrid.__version__, FAILED), error=said)


def _plugin(device: str | None, local: int) -> Any:
    """What a worker keeps: defined here, for its base is there only with ``distributed``."""
    from distributed import WorkerPlugin

    class Hands(WorkerPlugin):  # type: ignore[misc]
        """Keeps the child process of a worker."""

        def setup(self, worker: Any) -> None:
            """Nothing starts before the first item."""
            self.hand = Hand(device, cores_of(worker.name, local))

        def teardown(self, worker: Any) -> None:
            """End the child."""
            self.hand.close()

    return Hands()


def cores_of(name: Any, local: int) -> list[int] | None:
    """The cores of one of several workers on this machine: an equal share each, where there are enough."""
    if not local or not isinstance(name, int) or not hasattr(os, "sched_getaffinity"):
        return None
    return sorted(os.sched_getaffinity(0))[name % local :: local] or None


def _draw(encoded: bytes) -> bytes:
    """The task: draw an item by the child of this worker."""
    from distributed import get_worker

    item = msgspec.json.decode(encoded, type=Item)
    return msgspec.json.encode(get_worker().plugins[_PLUGIN].hand.draw(item))
