"""Device buffers with every byte accounted for."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid import spare
from clgrid.device import Device
from clgrid.errors import SMALLER_GRID, BufferTooLargeError, GridTooLargeError

# A recycled buffer may be so many times as large as what is asked for, or a little.
_LOOSEST_FIT, _LITTLE = 2, 1 << 16
# Buffers from this size on are made over numpy's arrays where the device shares the host's memory: numpy asks
# the system for huge pages, drivers do not, and a build touches all its memory for the first time.
_HUGE = 1 << 22
_HUGE_PAGE = 1 << 21
# Room to grow, in a buffer that will be recycled: 1/8.
_HEADROOM = 8


def largest_buffer(device: Device) -> int:
    """Most bytes of one buffer on the device."""
    return int(device.cl_device.max_mem_alloc_size)


class Allocator:
    """Allocates device buffers, and knows how much is in use and how much was at most.

    Parameters
    ----------
    device : Device
    max_bytes : int or None
        Refuse finished structures above this; the device's own limits hold in any case.

    Attributes
    ----------
    in_use, peak_nbytes : int
        Bytes of buffers handed out here and not given back, now and at most.
    recycles : bool
        Whether released buffers are kept for the next that fits them. A rebuild then allocates nothing.
    allocations : int
        Buffers made so far.
    finished : int
        Bytes of finished structures, which further ones are checked together with.
    """

    def __init__(self, device: Device, max_bytes: int | None = None) -> None:
        self._device = device
        self._max_bytes = max_bytes
        self._spare: list[Any] = []
        # Of each buffer handed out, by its address: what is counted as in use.
        self._counted: dict[int, int] = {}
        self.in_use = 0
        self.peak_nbytes = 0
        self.recycles = False
        self.allocations = 0
        self.finished = 0

    def check(self, nbytes: int, what: str, largest: int | None = None, transient: int = 0) -> None:
        """Raise if a structure of so many bytes may not or cannot be.

        Parameters
        ----------
        nbytes : int
            Of the whole structure.
        what : str
            Names it in the message.
        largest : int, optional
            Its largest single array, if that is not all of it.
        transient : int
            Bytes that the build holds beside it for a while.

        Raises
        ------
        BufferTooLargeError
            If nothing but the size of a single buffer is in the way.
        GridTooLargeError
            In any other case.
        """
        largest = nbytes if largest is None else largest
        memory = int(self._device.cl_device.global_mem_size)
        for need, limit, name, kind in (
            (nbytes + self.finished, self._max_bytes, "the limit given (max_memory)", GridTooLargeError),
            (nbytes + self.finished + transient, memory, "the device's memory", GridTooLargeError),
            (largest, largest_buffer(self._device), "the device's largest allocation", BufferTooLargeError),
        ):
            if limit is not None and need > limit:
                raise kind(f"{what} needs {need:,} bytes, more than {name} of {limit:,}; {SMALLER_GRID}")

    def check_arrays(self, sizes: dict[str, int], what: str) -> None:
        """``check`` for a structure of so many bytes by array."""
        self.check(sum(sizes.values()), what, largest=max(sizes.values()))

    def buffer(self, nbytes: int) -> Any:
        """A read-write buffer of at least so many bytes, and of one, since OpenCL has no empty ones."""
        own = self._fitting(nbytes)
        if own is not None:
            return own
        size = max(nbytes, 1)
        limit = largest_buffer(self._device)
        if size > limit:
            raise BufferTooLargeError(
                f"an array of {nbytes:,} bytes exceeds the device's {limit:,}; {SMALLER_GRID}"
            )
        if self.recycles:
            size = max(size, min(size + size // _HEADROOM, limit))
        buffer = spare.take(self._device, size)
        if buffer is None:
            buffer = self._made(size)
            self.allocations += 1
        self._counted[buffer.int_ptr] = size
        self.in_use += size
        self.peak_nbytes = max(self.peak_nbytes, self.in_use)
        return buffer

    def _made(self, size: int) -> Any:
        """A new buffer."""
        import pyopencl as cl

        flags = cl.mem_flags.READ_WRITE
        try:
            if size >= _HUGE and self._device.cl_device.host_unified_memory:
                host = _in_huge_pages(size)
                return cl.Buffer(self._device.context, flags | cl.mem_flags.USE_HOST_PTR, hostbuf=host)
            return cl.Buffer(self._device.context, flags, size)
        except (cl.MemoryError, cl.LogicError, MemoryError) as error:
            held = f"{size:,} bytes beside {self.in_use:,} in use"
            raise GridTooLargeError(f"the device has no room for {held} ({error}); {SMALLER_GRID}") from error

    def _fitting(self, nbytes: int) -> Any:
        """The smallest spare buffer that fits, taken from the spare ones, or None."""
        fits = [b for b in self._spare if nbytes <= b.size <= max(_LOOSEST_FIT * nbytes, _LITTLE)]
        if not fits:
            return None
        best = min(fits, key=lambda b: int(b.size))
        self._spare.remove(best)
        return best

    def upload(self, array: npt.NDArray[Any]) -> Any:
        """A read-only buffer with a copy of the array."""
        import pyopencl as cl

        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self._device.context, flags, hostbuf=np.ascontiguousarray(array))

    def filled(self, array: npt.NDArray[Any]) -> Any:
        """A ``buffer`` with a copy of the array."""
        import pyopencl as cl

        buffer = self.buffer(array.nbytes)
        cl.enqueue_copy(self._device.queue, buffer, np.ascontiguousarray(array), is_blocking=True)
        return buffer

    def share(self, array: npt.NDArray[Any]) -> Any:
        """A read-only buffer over the host array itself: no copy on CPU devices.

        The array must be C-contiguous; the buffer keeps it alive.

        Raises
        ------
        BufferTooLargeError
            If the array is more than one buffer of the device may be.
        """
        import pyopencl as cl

        if array.nbytes == 0:
            return self.buffer(1)
        limit = largest_buffer(self._device)
        if array.nbytes > limit:
            raise BufferTooLargeError(f"an array of {array.nbytes:,} bytes exceeds the device's {limit:,}")
        # Read-only buffers are copied by Intel's runtime unless they start at a page; no kernel writes these.
        access = cl.mem_flags.READ_WRITE if array.flags.writeable else cl.mem_flags.READ_ONLY
        return cl.Buffer(self._device.context, access | cl.mem_flags.USE_HOST_PTR, hostbuf=array)

    def adopt(self, array: npt.NDArray[Any]) -> Any:
        """A read-write buffer that holds the array: over it where the device shares the host's memory.

        The array must be C-contiguous and writeable; the buffer keeps it alive.

        Raises
        ------
        BufferTooLargeError
            If the array is more than one buffer of the device may be.
        """
        if not array.nbytes or not self._device.cl_device.host_unified_memory:
            return self.filled(array) if array.nbytes else self.buffer(0)
        buffer = self.share(array)
        self.in_use += buffer.size
        self.peak_nbytes = max(self.peak_nbytes, self.in_use)
        return buffer

    def results(self, array: npt.NDArray[Any]) -> Any:
        """A buffer over the C-contiguous host array, for a kernel to write; see ``bring_home``.

        What the array holds, the kernel finds.
        """
        import pyopencl as cl

        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR
        return cl.Buffer(self._device.context, flags, hostbuf=array)

    def bring_home(self, array: npt.NDArray[Any], buffer: Any) -> None:
        """Wait for the kernels, make the array under a buffer of ``results`` current, and release that.

        Mapping is what makes the array current; on CPU devices it moves nothing.
        """
        import pyopencl as cl

        queue = self._device.queue
        mapped, _ = cl.enqueue_map_buffer(queue, buffer, cl.map_flags.READ, 0, array.shape, array.dtype)
        mapped.base.release(queue)
        queue.finish()
        buffer.release()

    def download(self, buffer: Any, dtype: npt.DTypeLike, count: int) -> npt.NDArray[Any]:
        """The first ``count`` items of the buffer."""
        import pyopencl as cl

        array = np.zeros(count, dtype)
        if count:
            cl.enqueue_copy(self._device.queue, array, buffer, is_blocking=True)
        return array

    def take(self, buffer: Any, dtype: npt.DTypeLike, count: int) -> npt.NDArray[Any]:
        """``download``, then ``release``."""
        array = self.download(buffer, dtype, count)
        self.release(buffer)
        return array

    def release(self, *buffers: Any) -> None:
        """Take buffers back that kernels to come do not use: they wait for the next that is asked for."""
        if self.recycles:
            self._spare += buffers
            return
        for buffer in buffers:
            self._count_out(buffer)

    def drop(self) -> None:
        """Forget all buffers, spare ones too: each goes with the last that refers to it."""
        self._spare = []
        self.start_again()

    def keep_only(self, *buffers: Any) -> None:
        """Forget all buffers but these and spare ones: each goes with the last that refers to it."""
        kept = (*buffers, *self._spare)
        self._counted = {each.int_ptr: self._counted.get(each.int_ptr, each.size) for each in kept}
        self.in_use = sum(self._counted.values())

    def start_again(self) -> None:
        """Forget what an abandoned build had in use: it goes with the build's own variables."""
        self.keep_only()
        self.finished = 0

    def give_with(
        self, owner: object, buffers: Sequence[Any], wait: Callable[[], None]
    ) -> weakref.finalize[Any, Any]:
        """Have buffers that were made here wait for the next build once nobody refers to their owner.

        Parameters
        ----------
        owner : object
        buffers : sequence of buffer
        wait : callable
            Returns when no kernel reads them.

        Returns
        -------
        weakref.finalize
            What does it, to be detached if they are released before.
        """
        made = [buffer for buffer in buffers if buffer.int_ptr in self._counted]
        ending = weakref.finalize(owner, _give_after, wait, self._device, made)
        ending.atexit = False
        return ending

    def _count_out(self, buffer: Any) -> None:
        """Let a buffer go: one that was made here to the next build."""
        counted = self._counted.pop(buffer.int_ptr, None)
        self.in_use -= buffer.size if counted is None else counted
        if counted is None:
            buffer.release()
        else:
            spare.give(self._device, buffer)


def _give_after(wait: Callable[[], None], device: Device, buffers: list[Any]) -> None:
    wait()
    spare.give(device, *buffers)


def _in_huge_pages(nbytes: int) -> npt.NDArray[np.uint8]:
    """Memory that starts at a huge page: numpy's own would begin and end in small ones, a fault for each.

    What lies before it is asked of the system, but never touched.
    """
    room = np.empty(nbytes + _HUGE_PAGE, np.uint8)
    start = -room.ctypes.data % _HUGE_PAGE
    return room[start : start + nbytes]
