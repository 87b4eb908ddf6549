"""The exceptions a caller can meet; each message is one line: what, where, what to do."""

from __future__ import annotations


class ClgridError(Exception):
    """Base of all errors that clgrid raises on purpose.

    Attributes
    ----------
    exit_code : int
        What the command line returns when the error ends the program.
    """

    exit_code = 1


class MeshError(ClgridError):
    """A mesh file or mesh arrays that cannot be used."""


class InputError(ClgridError, ValueError):
    """An argument of the wrong shape, type or range."""


class UnsupportedError(ClgridError, NotImplementedError):
    """A method of another library's interface that clgrid does not have; says what does."""


SMALLER_GRID = "lower the density or the resolution"
"""What to do about a grid that is too large: the end of the message, where the caller chose both."""


class GridTooLargeError(ClgridError):
    """A grid that would not fit in the device, in 32-bit indices or in ``max_memory``."""


class BufferTooLargeError(GridTooLargeError):
    """An array beyond what one buffer of the device may hold."""


class GridFileError(ClgridError):
    """The file of a grid that cannot be written or read, or is not as it was written."""


class ImageError(ClgridError):
    """A picture that cannot be written or read."""


class DeviceError(ClgridError):
    """No OpenCL device, or one that cannot do what was asked."""

    exit_code = 3
