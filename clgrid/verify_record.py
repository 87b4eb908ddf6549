"""The JSON record of ``clgrid verify``."""

from __future__ import annotations

import msgspec

from clgrid.record import Header


class FailedRay(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The first ray that fails a check.

    Attributes
    ----------
    check : str
        A field of ``VerifyRow``.
    rays : int
        How many fail it.
    kind : str
        Of the first of them.
    origin, direction : (x, y, z)
        Of the first of them, every bit.
    found, expected : str
    """

    check: str
    rays: int
    kind: str
    origin: tuple[float, float, float]
    direction: tuple[float, float, float]
    found: str
    expected: str


class VerifyRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The rays of one rung, and how many of them fail each check; None where it does not apply.

    Attributes
    ----------
    escapes : int or None
        From inside of a closed mesh, without a hit; of ``inside`` rays.
    odd_lines, even_inside : int or None
        Whole lines that cross a closed mesh an odd number of times, and rays from inside that do so an even
        number of times.
    bits : int
        Nearest hits that differ from brute force in a bit of t, id, u, v or t_err; of ``checked`` rays.
    counts : int
        Numbers of hits that differ from brute force; likewise.
    wrong_hits, wrong_ids, wrong_counts : int
        Hit where exact arithmetic misses or the reverse; another triangle; another number of hits. Of
        ``exact_checked`` rays.
    late : int
        Hits whose t is farther from the exact one than t_err, or whose t_err is infinite; of ``exact_hits``,
        those whose triangle the ray exactly crosses. None on ``fast``, which knows no t_err.
    worst_ulps : float or None
        Largest error of t, in units in the last place, of float32 on the rung robust and else of float64; of
        the way through the mesh, if that is longer than t.
    worst_share, median_share : float or None
        Of the errors of t over their t_err; None without hits.
    broken : tuple of str
        The checks that the rung promises and fails.
    first : list of FailedRay
        Of each failed check, promised or not.
    """

    accuracy: str
    resolution: tuple[int, int, int]
    references: int
    grid_bytes: int
    rays: int
    hits: int
    inside: int
    escapes: int | None
    odd_lines: int | None
    even_inside: int | None
    checked: int
    bits: int
    counts: int
    exact_checked: int
    wrong_hits: int
    wrong_ids: int
    wrong_counts: int
    exact_hits: int
    late: int | None
    worst_ulps: float | None
    worst_share: float | None
    median_share: float | None
    broken: tuple[str, ...]
    first: list[FailedRay]


class VerifyRecord(Header, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``clgrid verify --json``.

    Attributes
    ----------
    open_edges : int
        Edges that an odd number of triangles have; escapes and parity are asked of closed meshes only.
    kinds : dict of str to int
        Rays of each kind.
    """

    scene: str
    triangles: int
    open_edges: int
    layout: str
    density: float | str
    skipping: bool
    kinds: dict[str, int]
    rows: list[VerifyRow]
    warnings: tuple[str, ...] = ()
