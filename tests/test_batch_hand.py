"""One child process for two askers at once, as a Dask worker has it."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from test_batch_run import ROOT, files, planned

from clgrid.batch import spawn
from clgrid.batch.hand import UNDER_WAY, Hand
from clgrid.batch.run import remove_partials
from clgrid.device import Device

pytestmark = pytest.mark.host

NAMES = ("fine", "crash-once", "last", "crash")
VIEWS = ", ".join(f'{{ name = "{name}", eye = [{3 + k}, 1, 2] }}' for k, name in enumerate(NAMES))
TEXT = (
    f'scenes = ["cube"]\ncameras = [{VIEWS}]\noutput = "out/{{camera}}.png"\nsize = [8, 8]\nretries = 1\n'
    '[[item]]\ncamera = "crash"\nretries = 0\n'
)


@pytest.fixture(autouse=True)
def _unruly(monkeypatch: pytest.MonkeyPatch) -> None:
    path = [str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path))
    monkeypatch.setattr(spawn, "MODULE", "unruly_worker")


def test_askers_get_what_became_of_their_own_items(tmp_path, device: Device) -> None:
    items = planned(tmp_path, TEXT).items
    hand = Hand(device.label)
    try:
        with ThreadPoolExecutor(UNDER_WAY) as askers:
            records = list(askers.map(hand.draw, items))
    finally:
        hand.close()
    assert [(each.item, each.camera) for each in records] == list(enumerate(NAMES))
    assert [each.status for each in records] == ["done", "done", "done", "failed"]
    assert "SIGABRT" in records[-1].error
    # What a child was writing when it died, the run takes away at its end.
    remove_partials(items)
    assert set(files(tmp_path / "out")) == {"fine.png", "crash-once.png", "last.png"}


def test_a_device_that_is_not_there_fails_items_and_not_the_worker(tmp_path) -> None:
    item = planned(tmp_path, TEXT).items[0]
    hand = Hand("no such device")
    try:
        for _ in range(2):
            assert "no OpenCL device matches" in hand.draw(item).error
    finally:
        hand.close()


def test_what_is_asked_for_when_it_ends_has_failed(tmp_path, device: Device) -> None:
    item = planned(tmp_path, TEXT.replace("fine", "hang")).items[0]
    hand = Hand(device.label)
    with ThreadPoolExecutor(1) as askers:
        asked = askers.submit(hand.draw, item)
        while not list(tmp_path.glob("out/*.tries")):
            assert not asked.done()
            time.sleep(0.02)
        hand.close()
        assert asked.result(60).error == "the worker was told to end"
