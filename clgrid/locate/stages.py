"""What a trace holds (cl/trace.h): records, their values by name, and what computes each.

An operation is what the kernels' C computes, as statements of the values before; the last one is the value.
"""

from __future__ import annotations

from dataclasses import dataclass

FLOAT, DOUBLE, LONG, UINT, BOOL, TRIANGLE = "float", "double", "long", "uint", "bool", "triangle"
REAL = "real"
"""``float`` on the rung ``robust``, ``double`` on the others."""


@dataclass(frozen=True)
class Value:
    """One value of a record.

    Attributes
    ----------
    name, type : str
    operation : str
        Statements of clgrid.locate.arithmetic, a line each; or, if it begins with ``:``, words.
    """

    name: str
    type: str
    operation: str


@dataclass(frozen=True)
class Stage:
    """One kind of record.

    Attributes
    ----------
    number : int
        ``STAGE_...`` of cl/trace.h.
    name : str
    of : str
        What its item is: ``ray``, ``cell`` or ``triangle``.
    values : tuple of Value
    """

    number: int
    name: str
    of: str
    values: tuple[Value, ...]


_AXES = "xyz"
# The origin in local units and the direction at unit length, as prepare_ray has them in float64.
_LOCAL_O = "o_{a} = (caller_origin_{a} - offset_{a}) * scale"
_LOCAL_D = "d_{a} = caller_direction_{a} * first_factor * second_factor"
_NEAR = "near_{a} = ((-ENTRY_CUBE if d_{a} > 0 else ENTRY_CUBE) - o_{a}) / d_{a} if d_{a} != 0 else -FAR"
# point_at: the product and the sums with what rounding takes from them (cl/pair.h).
_POINT_AT = (
    "ct = 134217729.0 * t_entry; th = ct - (ct - t_entry); tl = t_entry - th",
    "cd = 134217729.0 * d_{a}; dh = cd - (cd - d_{a}); dl = d_{a} - dh",
    "high = t_entry * d_{a}",
    "low = tl * dl - (((high - th * dh) - tl * dh) - th * dl)",
    "sum = o_{a} + high; of_b = sum - o_{a}; lost = (o_{a} - (sum - of_b)) + (high - of_b)",
    "origin_{a} = clamped(sum + (lost + (rest + low)))",
)
_REST = (
    "moved = caller_origin_{a} - offset_{a}; of_o = moved - caller_origin_{a}",
    "rest = ((caller_origin_{a} - (moved - of_o)) + (-offset_{a} - of_o)) * scale",
)


def _each(*lines: str) -> str:
    """The lines for every axis."""
    return "\n".join(line.format(a=a) for a in _AXES for line in lines)


def _along(a: str, *lines: str) -> str:
    return "\n".join(line.format(a=a) for line in lines)


_RAY = Stage(
    1,
    "ray",
    "ray",
    (
        Value("valid", BOOL, ": the ray is finite and has a direction"),
        Value("reaches", BOOL, ": the ray comes near the mesh"),
    ),
)


def _start(wide: bool) -> Stage:
    direction = "direction_{a} = d_{a}" if wide else "direction_{a} = float(d_{a})"
    start = (
        (_LOCAL_O, _LOCAL_D, *_REST, *_POINT_AT)
        if wide
        else (_LOCAL_O, _LOCAL_D, "start = o_{a} + t_entry * d_{a}", "origin_{a} = float(clamped(start))")
    )
    near = _each(_LOCAL_O, _LOCAL_D, _NEAR)
    far = "farthest = max(abs(o_x), abs(o_y), abs(o_z))"
    entry = "t_entry = max(near_x, near_y, near_z) if farthest > START_LIMIT else 0.0"
    values = [Value("t_unit", DOUBLE, "t_unit = inverse_scale * first_factor * second_factor")]
    values += [Value(f"direction_{a}", REAL, _along(a, _LOCAL_D, direction)) for a in _AXES]
    values += [Value("t_entry", DOUBLE, f"{near}\n{far}\n{entry}")]
    values += [Value(f"origin_{a}", REAL, _along(a, *start)) for a in _AXES]
    return Stage(13, "start", "ray", tuple(values))


def _shear(wide: bool) -> Stage:
    x, y, z = ("double(float(direction_k{a}))" if wide else "double(direction_k{a})",) * 3
    over = [(a, text.format(a=a)) for a, text in zip(_AXES, (x, y, z), strict=True)]
    depth = over[2][1]
    origin = "float(origin_k{a})" if wide else "origin_k{a}"
    values = [Value(f"k{a}", LONG, ": axes, by the largest component of the direction") for a in _AXES]
    values += [Value(f"o{a}", FLOAT, f"o{a} = {origin.format(a=a)}") for a in _AXES]
    values += [Value(f"s{a}", FLOAT, f"s{a} = float({text} / {depth})") for a, text in over[:2]]
    values += [Value("sz", FLOAT, f"sz = float(1.0 / {depth})")]
    return Stage(2, "shear", "ray", tuple(values))


def _wide_shear() -> Stage:
    values = [Value(f"o{a}", DOUBLE, f"o{a} = origin_k{a}") for a in _AXES]
    values += [Value(f"s{a}", DOUBLE, f"s{a} = direction_k{a} / direction_kz") for a in "xy"]
    values += [Value("sz", DOUBLE, "sz = 1.0 / direction_kz")]
    return Stage(3, "shear in float64", "ray", tuple(values))


_T_BOUND = "{name} = {bound} / t_unit - t_entry {sign} (2.0 * T_SLACK + TWO_TO_MINUS_50 * abs(t_entry))"
_BOUNDS = Stage(
    4,
    "bounds",
    "ray",
    (
        Value("t_first", DOUBLE, _T_BOUND.format(name="t_first", bound="t_min", sign="-")),
        Value("t_last", DOUBLE, _T_BOUND.format(name="t_last", bound="t_max", sign="+")),
        Value("enters", BOOL, ": the ray passes the grid between them"),
    ),
)

_CLIMB = (
    "c_{a} = double(SMALLEST_CLIMB if abs(direction_{a}) < SMALLEST_CLIMB else direction_{a})",
    "inverse_{a} = 1.0 / c_{a}",
)
_IN = "in_{a} = ((lower_{a} if c_{a} > 0 else upper_{a}) - double(origin_{a})) * inverse_{a}"
_K = "k_{a} = ((double(origin_{a}) + t_in * c_{a}) - lower_{a}) / cell_size_{a}"
_PLANE = "plane_{a} = lower_{a} + (double(cell_{a} + 1) if c_{a} > 0 else double(cell_{a})) * cell_size_{a}"
_PACE = "between_{a} = min((cell_size_{a} * abs(inverse_{a})) * TICKS, MOST_TICKS)"
_NEXT = "first_{a} = ((plane_{a} - double(origin_{a})) * inverse_{a} - t_in) * TICKS"


def _entry(nested: bool) -> Stage:
    """Ticks of a nested grid are of its finest cells, then brought to those of the top: not followed here."""
    t_in = _each(*_CLIMB, _IN) + "\nt_in = max(t_first, in_x, in_y, in_z)"
    ahead = "next_{a} = long(min(max(first_{a}, 0.0), between_{a}))"
    ways = {
        "cell": (*_CLIMB, _K, "cell_{a} = long(min(max(k_{a}, 0.0), double(cells_{a} - 1)))"),
        "next": (*_CLIMB, _PLANE, _PACE, _NEXT, ahead),
        "pace": (*_CLIMB, _PACE, "pace_{a} = long(between_{a})"),
    }
    values = [Value("t_in", DOUBLE, t_in)]
    for name, lines in ways.items():
        for a in _AXES:
            operation = f": {name}_{a} by planes of the finest cells" if nested else _along(a, *lines)
            values.append(Value(f"{name}_{a}", LONG, operation))
    values.append(Value("stop", LONG, ": the tick at which the grid or the interval ends"))
    return Stage(5, "entry", "ray", tuple(values))


_CELL = Stage(
    6,
    "cell",
    "cell",
    (
        Value("entered", LONG, ": the tick at which the cell is entered, by sums of integers"),
        Value("due", LONG, ": the tick at which it is left, by sums of integers"),
        Value("count", UINT, ": triangles in the cell's list, as the build on the device made it"),
    ),
)


def _triangle() -> Stage:
    values = [Value(f"{p}z", REAL, f"{p}z = {p}_kz - oz") for p in "abc"]
    values += [
        Value(f"{p}{a}", REAL, f"{p}{a} = ({p}_k{a} - o{a}) - s{a} * {p}z") for p in "abc" for a in "xy"
    ]
    values += [
        Value("u", REAL, "u = cx * by - cy * bx"),
        Value("v", REAL, "v = ax * cy - ay * cx"),
        Value("w", REAL, "w = bx * ay - by * ax"),
        Value("open", BOOL, ": the filter of eight triangles at once (cl/shear.h) lets it through"),
    ]
    return Stage(7, "triangle", "triangle", tuple(values))


_REACH = "reach = max(abs(ax), abs(ay), abs(bx), abs(by), abs(cx), abs(cy))"
_HARD = "hard = abs((u + v) + w) < 2 * reach * reach * reach or min(abs(u), abs(v), abs(w)) < {smallest}"
_EDGES = {
    "robust": (
        "U = double(cx) * double(by) - double(cy) * double(bx) if hard else double(u)",
        "V = double(ax) * double(cy) - double(ay) * double(cx) if hard else double(v)",
        "W = double(bx) * double(ay) - double(by) * double(ax) if hard else double(w)",
    ),
    # Edge functions in pairs of doubles are not followed here.
    "precise": ("U = u if not hard else unknown(); V = v; W = w",),
}
_T = {
    "robust": "t = float(((U * double(az) + V * double(bz)) + W * double(cz)) * double(sz) / det)",
    "precise": "t = ((U / det * az + V / det * bz) + W / det * cz) * sz",
}


def _finish(rung: str) -> Stage:
    if rung == "exact":
        det = "D = (u + v) + w if certain else unknown()"
        t = "t = ((u / D * az + v / D * bz) + w / D * cz) * sz"
        of_exact = (
            Value("certain", BOOL, ": whether the filter in float64 decides, or integers"),
            Value("met", BOOL, ": whether the ray crosses the triangle"),
            Value("weight_b", DOUBLE, f"{det}\nweight_b = v / D"),
            Value("weight_c", DOUBLE, f"{det}\nweight_c = w / D"),
            Value("t", DOUBLE, f"{det}\n{t}"),
            Value("error", DOUBLE, ": the error of t (cl/t_error.h)"),
        )
        return Stage(8, "crossing", "triangle", of_exact)
    smallest = "SMALLEST_EDGE" if rung == "robust" else "SMALLEST_PRODUCT"
    before = "\n".join((_REACH, _HARD.format(smallest=smallest), *_EDGES[rung]))
    values = (
        Value("met", BOOL, ": the edge functions, in float64 where they are small, do not rule it out"),
        Value("det", DOUBLE, f"{before}\ndet = (U + V) + W"),
        Value("weight_b", DOUBLE, f"{before}\nweight_b = V / det"),
        Value("weight_c", DOUBLE, f"{before}\nweight_c = W / det"),
        Value("t", REAL, f"{before}\n{_T[rung]}"),
    )
    return Stage(8, "meeting", "triangle", values)


_LAST = (
    Stage(
        9,
        "kept",
        "triangle",
        (
            Value("kept", BOOL, ": it is the nearest so far, within the interval"),
            Value("nearest_t", REAL, ": the t of the nearest so far (meet)"),
            Value("nearest_scene_t", DOUBLE, "nearest_scene_t = (t_entry + double(nearest_t)) * t_unit"),
        ),
    ),
    Stage(
        10,
        "stop",
        "ray",
        (
            Value("stop", LONG, ": the tick from which on no cell can hold a nearer hit"),
            Value("go_on", BOOL, ": to the next cell, or to test all triangles"),
        ),
    ),
    Stage(11, "all", "ray", (Value("id", TRIANGLE, ": the nearest of all triangles, each tested exactly"),)),
    Stage(
        12,
        "hit",
        "ray",
        (
            Value("id", TRIANGLE, ": the nearest triangle"),
            Value("t_hit", DOUBLE, ": t of the hit, in lengths of the direction"),
            Value("hit_u", REAL, ": weight of the second vertex (describe)"),
            Value("hit_v", REAL, ": weight of the third vertex (describe)"),
            Value("t_err", DOUBLE, ": bound of the error of t (cl/t_error.h)"),
        ),
    ),
)


def stages_of(rung: str, *, nested: bool) -> dict[int, Stage]:
    """The kinds of records, by number, with REAL as what it is on a strict rung."""
    wide = rung != "robust"
    every = [
        _RAY,
        _start(wide),
        _shear(wide),
        *([_wide_shear()] if wide else []),
        _BOUNDS,
        _entry(nested),
        _CELL,
    ]
    every += [_triangle(), _finish(rung), *_LAST]
    real = DOUBLE if wide else FLOAT
    return {
        stage.number: Stage(
            stage.number,
            stage.name,
            stage.of,
            tuple(
                Value(each.name, real if each.type == REAL else each.type, each.operation)
                for each in stage.values
            ),
        )
        for stage in every
    }
