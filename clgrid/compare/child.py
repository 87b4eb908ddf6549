"""The process of one device: does what its order says, and says what it does.

Events go by what was stdout. When stdin ends the parent is gone, and the process ends at once.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid import registration
from clgrid.bench import load_timed
from clgrid.camera import Camera
from clgrid.compare import messages
from clgrid.compare.files import Folder
from clgrid.compare.messages import Event, Order, View
from clgrid.compare.properties import arithmetic, driver_record, speed
from clgrid.compare.work import Stage, measure
from clgrid.compare_record import RungFailure
from clgrid.device import Device, choose
from clgrid.errors import ClgridError, DeviceError
from clgrid.fission import check_units
from clgrid.record import describe_builds, describe_device, process_peak_bytes

Say = Callable[[Event], None]


def work(order: Order, say: Say) -> None:
    """Do all that the order says; what fails is said, and the rest is done."""
    try:
        say(messages.Step("start"))
        device, limited_by = open_device(order.selector, order.units)
        units = device.description.compute_units
        say(messages.Found(describe_device(device), driver_record(device), units, limited_by))
        device.require_usable()
        say(messages.Step("probe arithmetic"))
        say(messages.Arithmetic(arithmetic(device)))
        say(messages.Step("measure launches and copies"))
        say(messages.Speed(speed(device, order.repetitions)))
        folder = Folder(Path(order.folder))
        for number in range(len(order.scenes)):
            _scene(order, number, device, folder, say)
    except DeviceError as error:
        say(messages.Refused(str(error)))
    except Exception as error:
        if not is_out_of_memory(error):
            raise
        say(messages.NoMemory(_in_words(error)))
    else:
        say(messages.Finished(describe_builds(device), process_peak_bytes()))


def _scene(order: Order, number: int, device: Device, folder: Folder, say: Say) -> None:
    name = order.scenes[number]
    say(messages.Step(f"load {name}"))
    scene, load_s = load_timed(name)
    stage = Stage(number, scene, camera_of(order.views[number]), load_s)
    for accuracy in order.accuracies:
        try:
            row = measure(order, stage, accuracy, device, folder, lambda step: say(messages.Step(step)))
        except ClgridError as error:
            say(messages.Failed(RungFailure(scene.name, accuracy, str(error))))
        else:
            say(messages.Done(number, row))


def open_device(selector: str, units: int | None) -> tuple[Device, str]:
    """The device with so many compute units, and how it was limited.

    The process is kept to as many cores, before the driver counts them; a driver that counts more all the
    same is asked for a sub-device.

    Raises
    ------
    DeviceError
        If there is no such device.
    """
    if units is None:
        return choose(selector), ""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:units])
    whole = choose(selector)
    if whole.description.compute_units == units:
        return whole, "affinity"
    check_units(whole.description, units)
    return choose(f"{selector}/{units}"), "fission"


def is_out_of_memory(error: Exception) -> bool:
    """Whether numpy, Python or the driver had no memory left."""
    cl = registration.opencl()
    words = ("OUT_OF_HOST_MEMORY", "OUT_OF_RESOURCES", "MEM_OBJECT_ALLOCATION_FAILURE")
    driver = isinstance(error, cl.Error) and any(word in str(error) for word in words)
    return isinstance(error, (MemoryError, cl.MemoryError)) or driver


def _in_words(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def camera_of(view: View) -> Camera:
    """The camera that an order describes."""
    eye, right, up, forward = (np.array(axis) for axis in (view.eye, view.right, view.up, view.forward))
    return Camera(
        eye,
        right,
        up,
        forward,
        view.fov,
        view.fov_axis,  # type: ignore[arg-type]
        orthographic_height=view.orthographic_height,
    )


def view_of(camera: Camera) -> View:
    """What an order says of a camera."""
    axes = (_three(camera.eye), _three(camera.right), _three(camera.up), _three(camera.forward))
    return View(*axes, camera.fov, camera.fov_axis, camera.orthographic_height)


def _three(vector: npt.NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(1)


def main(order: str) -> None:
    """Run in the child: ``order`` is a file."""
    # Drivers write to stdout; what they say goes where errors go.
    events = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    threading.Thread(target=_end_with_parent, daemon=True).start()

    def say(event: Event) -> None:
        events.write(messages.encode(event) + b"\n")
        events.flush()

    work(messages.order_of(Path(order).read_bytes()), say)
    # Drivers may hang in their own tear-down.
    os._exit(0)
