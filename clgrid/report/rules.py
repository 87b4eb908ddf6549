"""How each field of a record is judged when two runs are compared."""

from __future__ import annotations

LESS, MORE, EQUAL, BITS, SAID = "less", "more", "equal", "bits", "said"

# Faults and errors, and bytes: less is better. By the last part of a field's name.
_FAULTS = {
    *("differing", "escapes", "odd_lines", "even_inside", "bits", "counts", "wrong_hits", "wrong_ids"),
    *("wrong_counts", "late", "missed", "false_hits", "wrong_triangles", "other_triangles"),
    *("failed", "broken", "self_test"),
    *("id", "t", "u", "v", "only_first", "only_second", "t_ulps", "u_ulps", "v_ulps"),
    *("wrong_quotients", "wrong_roots", "quotient_ulps", "root_ulps"),
    *("worst_ulps", "median_ulps", "p999_ulps"),
    *("ids", "largest", "mean", "rms", "perceptual", "largest_perceptual"),
}
_BYTES = {"grid_bytes", "peak_bytes"}
# What the same triangles and rays must give, on any device and in any grid.
_ANSWERS = {"hits", "image_hits"}
_DIGESTS = {"digest", "image_digest"}
# What follows from other fields or from the aim of the rays, and what is said in words.
_SAID = {
    *("device", "density", "resolution", "bytes_per_triangle", "empty_share", "load_factor", "mrays_per_s"),
    *("checked", "exact_checked", "exact_hits", "inside", "differing_share", "worst_share", "median_share"),
    *("process_peak_bytes", "warnings", "turns", "reason", "step", "eye", "limited_by", "promised", "equal"),
    *("errors_of", "error", "error_most", "refused", "on_front", "verify", "other_share", "other_share_most"),
    *("missed_most", "false_hits_most", "wrong_triangles_most", "median", "p999", "worst", "floor"),
}
# What caches of the system and of the driver decide.
_CACHED = {"load_s", "first_compile_s", "save_s", "seconds"}


def rule(name: str) -> str:
    """Return how a field that was not timed is judged.

    Returns
    -------
    str
        ``less`` or ``more`` is better; ``equal``: another value is another answer; ``bits``: another value is
        another answer where the same version promises the same bits; ``said``: it is shown only. Any other
        field is ``""``: a change is named and not judged.
    """
    parts = name.split(".")
    if parts[0] in ("cost_s", "grid_digests"):
        return SAID
    last = parts[-1]
    if parts[0] == "nbytes" or last in _BYTES or last in _FAULTS:
        return LESS
    if last == "psnr":
        return MORE
    if last in _ANSWERS:
        return EQUAL
    if last in _DIGESTS:
        return BITS
    return SAID if last in _SAID else ""


def is_size(name: str) -> bool:
    """Whether a field is bytes of a grid, which follow from its resolution."""
    return name.startswith("nbytes.") or name in _BYTES


def is_judged(name: str) -> bool:
    """Whether a time is judged: not what caches decide."""
    return name.split(".")[0] not in _CACHED


def whole(name: str) -> str:
    """Return the time that a time is a part of; empty for none: ``build_s`` of ``build_stages_s.count``."""
    return "build_s" if name.startswith("build_stages_s.") else ""
