"""Device buffers with every byte accounted for."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.device import Device
from clgrid.errors import GridTooLargeError

_ADVICE = "lower the density or the resolution"


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
        Bytes in buffers made here and not released, now and at most.
    """

    def __init__(self, device: Device, max_bytes: int | None = None) -> None:
        self._device = device
        self._max_bytes = max_bytes
        self.in_use = 0
        self.peak_nbytes = 0

    def check(self, nbytes: int, what: str, largest: int | None = None, transient: int = 0) -> None:
        """Raise GridTooLargeError if a structure of so many bytes may not or cannot be.

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
        """
        cl_device = self._device.cl_device
        largest = nbytes if largest is None else largest
        limits = [
            (nbytes, self._max_bytes, "the limit given (max_memory)"),
            (nbytes + transient, int(cl_device.global_mem_size), "the device's memory"),
            (largest, int(cl_device.max_mem_alloc_size), "the device's largest allocation"),
        ]
        for need, limit, name in limits:
            if limit is not None and need > limit:
                raise GridTooLargeError(
                    f"{what} needs {need:,} bytes, more than {name} of {limit:,}; {_ADVICE}"
                )

    def buffer(self, nbytes: int) -> Any:
        """A new read-write buffer; one byte at least, since OpenCL has no empty ones."""
        import pyopencl as cl

        try:
            buffer = cl.Buffer(self._device.context, cl.mem_flags.READ_WRITE, max(nbytes, 1))
        except (cl.MemoryError, cl.LogicError) as error:
            held = f"{nbytes:,} bytes beside {self.in_use:,} in use"
            raise GridTooLargeError(f"the device has no room for {held} ({error}); {_ADVICE}") from error
        self.in_use += buffer.size
        self.peak_nbytes = max(self.peak_nbytes, self.in_use)
        return buffer

    def upload(self, array: npt.NDArray[Any]) -> Any:
        """A read-only buffer with a copy of the array."""
        import pyopencl as cl

        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self._device.context, flags, hostbuf=np.ascontiguousarray(array))

    def share(self, array: npt.NDArray[Any]) -> Any:
        """A read-only buffer over the host array itself: no copy on CPU devices.

        The array must be C-contiguous; the buffer keeps it alive.
        """
        import pyopencl as cl

        if array.nbytes == 0:
            return self.buffer(1)
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
        return cl.Buffer(self._device.context, flags, hostbuf=array)

    def results(self, array: npt.NDArray[Any]) -> Any:
        """A buffer over the C-contiguous host array, for a kernel to write; see ``bring_home``."""
        import pyopencl as cl

        flags = cl.mem_flags.WRITE_ONLY | cl.mem_flags.USE_HOST_PTR
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

    def release(self, *buffers: Any) -> None:
        """Give buffers back."""
        for buffer in buffers:
            self.in_use -= buffer.size
            buffer.release()
