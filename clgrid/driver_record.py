"""What a driver says of its device, what its arithmetic was found to do, and how fast it moves bytes."""

from __future__ import annotations

import msgspec


class DriverRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the driver says of the device.

    Attributes
    ----------
    type : str
        ``CPU``, ``GPU``, ``ACCELERATOR``, joined by ``+``.
    version, c_version : str
        Of OpenCL and of its C.
    compute_units : int
        Of the whole device.
    global_memory, max_allocation, local_memory : int
        Bytes: all, the largest buffer, a work-group's.
    fp64 : bool
        Whether kernels can use ``double``.
    correctly_rounded_divide, denormals : bool
        What is promised of float32.
    preferred_widths, native_widths : dict of str to int
        Lanes of a vector, by type: ``char``, ``short``, ``int``, ``long``, ``float``, ``double``.
    note : str
        What clgrid changed to make the device work; mostly empty.
    """

    type: str
    version: str
    c_version: str
    compute_units: int
    global_memory: int
    max_allocation: int
    local_memory: int
    fp64: bool
    correctly_rounded_divide: bool
    denormals: bool
    preferred_widths: dict[str, int]
    native_widths: dict[str, int]
    note: str


class ArithmeticRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the device does with numbers of one type, tried with a small kernel.

    Attributes
    ----------
    type : str
        ``float``, ``float8``, ``double``, ``double4``.
    operands : int
        Of each operation.
    wrong_quotients, wrong_roots : int
        Of ``/`` and ``sqrt``: not the nearest number.
    quotient_ulps, root_ulps : int
        The largest difference to that, in last places.
    contracted, contracted_when_forbidden : str
        Whether ``a * b + c`` is rounded once: ``never``, ``always``, ``partly`` or ``wrong`` (neither once
        nor twice); without and with ``#pragma OPENCL FP_CONTRACT OFF``.
    mad, fma : str
        Likewise, of these functions.
    denormals_read, denormals_made : str
        ``kept``, ``flushed`` or ``partly``: as operands and as results.
    """

    type: str
    operands: int
    wrong_quotients: int
    wrong_roots: int
    quotient_ulps: int
    root_ulps: int
    contracted: str
    contracted_when_forbidden: str
    mad: str
    fma: str
    denormals_read: str
    denormals_made: str


class SpeedRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the device reaches with the smallest kernels: seconds, one entry a repetition.

    Attributes
    ----------
    launches : int
        In each entry of ``launch_s``, one after another, each waited for.
    launch_s : list of float
        Of a kernel that does nothing.
    copied_bytes : int
        Read, and as many written, in each of the others.
    copy_s : list of float
        By a kernel, from one buffer to another.
    upload_s, download_s : list of float
        From a host array to a buffer, and back.
    """

    launches: int
    launch_s: list[float]
    copied_bytes: int
    copy_s: list[float]
    upload_s: list[float]
    download_s: list[float]
