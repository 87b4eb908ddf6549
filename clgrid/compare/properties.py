"""What explains differences between devices: what the driver says, and what small kernels show."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.device import Device
from clgrid.driver_record import ArithmeticRecord, DriverRecord, SpeedRecord
from clgrid.memory import Allocator, largest_buffer
from clgrid.program import kernel

Reals = npt.NDArray[np.floating[Any]]

_VECTORS = ("char", "short", "int", "long", "float", "double")
# Type of the kernel, of its lanes, and how many those are.
_NUMBERS: tuple[tuple[str, type[np.floating[Any]], int], ...] = (
    ("float", np.float32, 1),
    ("float8", np.float32, 8),
    ("double", np.float64, 1),
    ("double4", np.float64, 4),
)
_OPERANDS = 1 << 14
_GROUP = 64
_SEED = 20081
_LAUNCHES = 256
# Beyond caches, and little of a small device's memory.
_MOST_COPIED, _SHARE = 1 << 26, 16
_LANES, _CHUNK = 8, 1 << 12


def driver_record(device: Device) -> DriverRecord:
    """What the driver says of the device."""
    seen, asked = device.description, device.cl_device
    return DriverRecord(
        type=seen.type,
        version=seen.version,
        c_version=seen.c_version,
        compute_units=seen.compute_units,
        global_memory=seen.global_memory,
        max_allocation=seen.max_allocation,
        local_memory=asked.local_mem_size,
        fp64=seen.fp64,
        correctly_rounded_divide=seen.correctly_rounded_divide,
        denormals=seen.denormals,
        preferred_widths={name: getattr(asked, f"preferred_vector_width_{name}") for name in _VECTORS},
        native_widths={name: getattr(asked, f"native_vector_width_{name}") for name in _VECTORS},
        note=seen.note,
    )


def arithmetic(device: Device) -> list[ArithmeticRecord]:
    """What the device does with numbers of each type.

    Raises
    ------
    DeviceError
        If it cannot compile the kernel.
    """
    return [_arithmetic_of(device, *number) for number in _NUMBERS]


def _arithmetic_of(device: Device, name: str, real: type[np.floating[Any]], lanes: int) -> ArithmeticRecord:
    a, b = _operands(real)
    # A sum that is rounded once is then the error of the product, and one that is rounded twice is 0.
    c = -(a * b)
    once = _product_error(a, b)
    free, strict = (_run(device, name, lanes, (a, b, c), fast=fast) for fast in (True, False))
    quotient, root = _last_places_off(strict[0], a / b), _last_places_off(strict[1], np.sqrt(a))
    return ArithmeticRecord(
        type=name,
        operands=_OPERANDS,
        wrong_quotients=int(np.count_nonzero(quotient)),
        wrong_roots=int(np.count_nonzero(root)),
        quotient_ulps=int(quotient.max()),
        root_ulps=int(root.max()),
        contracted=_rounded_once(free[2], once),
        contracted_when_forbidden=_rounded_once(strict[2], once),
        mad=_rounded_once(strict[3], once),
        fma=_rounded_once(strict[4], once),
        denormals_read=_denormals(device, name, real, lanes, made=False),
        denormals_made=_denormals(device, name, real, lanes, made=True),
    )


def _operands(real: type[np.floating[Any]]) -> tuple[Reals, Reals]:
    """(N,) each: above 0, of all digits, products and their errors within range."""
    random = np.random.default_rng(_SEED)
    digits = 1.0 + random.random((2, _OPERANDS))
    a, b = np.ldexp(digits, random.integers(-20, 21, digits.shape)).astype(real)
    return a, b


def _product_error(a: Reals, b: Reals) -> Reals:
    """A * b less its rounding, exactly: the halves of Dekker (1971)."""
    factor = a.dtype.type(2 ** (12 if a.dtype == np.float32 else 27) + 1)

    def halves(x: Reals) -> tuple[Reals, Reals]:
        high = factor * x - (factor * x - x)
        return high, x - high

    (ah, al), (bh, bl) = halves(a), halves(b)
    error: Reals = al * bl - (((a * b - ah * bh) - al * bh) - ah * bl)
    return error


def _rounded_once(found: Reals, once: Reals) -> str:
    """Whether sums are rounded once, told where that makes a difference."""
    telling = once != 0
    fused, separate = (found == once)[telling], (found == 0)[telling]
    if fused.all():
        return "always"
    if separate.all():
        return "never"
    return "partly" if (fused | separate).all() else "wrong"


def _last_places_off(found: Reals, right: Reals) -> npt.NDArray[np.int64]:
    """(N,) how many numbers lie between; for numbers above 0."""
    bits = np.int32 if found.dtype == np.float32 else np.int64
    return np.abs(found.view(bits).astype(np.int64) - right.view(bits).astype(np.int64))


def _denormals(device: Device, name: str, real: type[np.floating[Any]], lanes: int, *, made: bool) -> str:
    """Whether subnormal numbers survive as operands of a product, or as its result."""
    facts = np.finfo(real)
    tiny = np.arange(1, _OPERANDS + 1).astype(real) * facts.smallest_subnormal
    scale = real(2.0**60)
    # The result is subnormal just if the operands are not, and the reverse; both products are exact.
    a, b = (tiny * scale, 1 / scale) if made else (tiny, scale)
    same = np.full(_OPERANDS, b, real)
    found = _run(device, name, lanes, (a, same, same), fast=False)[5]
    kept = found == a * b
    return "kept" if kept.all() else "partly" if kept.any() else "flushed"


def _run(device: Device, name: str, lanes: int, operands: tuple[Reals, ...], *, fast: bool) -> Reals:
    """(6, N) what the kernel makes of (N,) operands each."""
    options = {"RUNG_FAST": 1} if fast else {}
    probe = kernel(device, "probe_arithmetic.cl", "probe_arithmetic", NUMBER=name, **options)
    allocator = Allocator(device)
    inputs = [allocator.upload(array) for array in operands]
    count = len(operands[0])
    results = allocator.buffer(6 * operands[0].nbytes)
    items = count // lanes
    probe(device.queue, (-(-items // _GROUP) * _GROUP,), (_GROUP,), *inputs, np.uint32(items), results)
    found: Reals = allocator.take(results, operands[0].dtype, 6 * count).reshape(6, count)
    return found


def speed(device: Device, repetitions: int) -> SpeedRecord:
    """What launches, copies and transfers take.

    Raises
    ------
    DeviceError
        If the device cannot compile the kernel.
    """
    copy = kernel(device, "probe_copy.cl", "probe_copy")
    allocator, queue = Allocator(device), device.queue
    most = min(_MOST_COPIED, largest_buffer(device) // 2, device.description.global_memory // _SHARE)
    count = most // (4 * _LANES)
    host = np.ones(count * _LANES, np.float32)
    source, target = allocator.filled(host), allocator.buffer(host.nbytes)
    items, chunk = -(-count // _CHUNK), np.uint32(_CHUNK)

    def launch() -> None:
        for _ in range(_LAUNCHES):
            copy(queue, (1,), (1,), source, np.uint32(0), chunk, target)
            queue.finish()

    def copies() -> None:
        copy(queue, (items,), (1,), source, np.uint32(count), chunk, target)
        queue.finish()

    def upload() -> None:
        _enqueue_copy(device, source, host)

    def download() -> None:
        _enqueue_copy(device, host, target)

    return SpeedRecord(
        launches=_LAUNCHES,
        launch_s=_timed(launch, repetitions),
        copied_bytes=host.nbytes,
        copy_s=_timed(copies, repetitions),
        upload_s=_timed(upload, repetitions),
        download_s=_timed(download, repetitions),
    )


def _enqueue_copy(device: Device, to: Any, source: Any) -> None:
    import pyopencl as cl

    cl.enqueue_copy(device.queue, to, source, is_blocking=True)


def _timed(work: Callable[[], None], repetitions: int) -> list[float]:
    """Seconds of each repetition, after one that is not counted."""
    work()
    seconds = []
    for _ in range(repetitions):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return seconds
