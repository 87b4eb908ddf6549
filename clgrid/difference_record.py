"""The JSON record of ``clgrid diff``."""

from __future__ import annotations

import msgspec


class GroupRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How one group of channels differs between two pictures.

    Attributes
    ----------
    group : str
        ``rgba``, ``depth``, ``normal`` and so on, as ``clgrid render --aov`` calls them.
    differing : int
        Pixels that differ in a bit.
    beyond : int
        Pixels that differ by more than the tolerance; of ids and steps, at all.
    largest, mean : float or None
        Of the absolute differences over all channels; None where infinite.
    psnr : float or None
        Decibels to a signal of 1; None for equal groups, and where a difference is infinite.
    """

    group: str
    differing: int
    beyond: int
    largest: float | None
    mean: float | None
    psnr: float | None


class DiffRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``clgrid diff --json``.

    Attributes
    ----------
    schema : str
        ``clgrid.diff/1``.
    clgrid : str
        Version.
    pixels : int
        Of each picture.
    missing : tuple of str
        Groups that only one of them has.
    flip, largest_flip : float or None
        Mean and maximum of FLIP (of OpenImageIO, 0 to 1, for 67 pixels a degree) of the colours; None
        where it cannot be computed.
    within : bool
        Whether everything asked for is within tolerance.
    """

    schema: str
    clgrid: str
    first: str
    second: str
    width: int
    height: int
    pixels: int
    tolerance: float
    max_flip: float | None
    groups: list[GroupRecord]
    missing: tuple[str, ...]
    flip: float | None
    largest_flip: float | None
    within: bool
