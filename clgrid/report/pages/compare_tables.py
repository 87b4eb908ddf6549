"""The tables on the page of ``clgrid compare``."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from clgrid.compare_record import COMPLETED, CompareDevice, ComparePair, CompareRecord
from clgrid.report.model import BAD, GOOD, Block, Cell, Column, Table, Value
from clgrid.report.pages.shared import named, of, timed
from clgrid.report.quantity import BYTES, COUNT, DECIBELS, MRAYS, NUMBER, SECONDS, ULPS, Quantity

_BANDWIDTH = Quantity(((1e9, "GB/s"),))


def pairs(found: Sequence[ComparePair]) -> Table:
    """Return how every two devices differ on each scene and rung."""
    kinds = [*dict.fromkeys(each.kind for pair in found for each in pair.rays)]
    columns = [
        Column("scene"),
        Column("rung"),
        Column("devices"),
        Column("verdict"),
        Column("grids"),
        *(Column(f"{kind} rays", COUNT, "that differ in any bit of t, id, u or v") for kind in kinds),
        Column("triangles", COUNT, "rays that hit another triangle"),
        Column("flips", COUNT, "hits of one device that are misses of the other"),
        Column("worst t", ULPS, "largest difference of t on the same triangle, in last places"),
        Column("pixels", COUNT, "that differ in any bit of colour or coverage"),
        Column("largest", NUMBER, "difference of linear colour", detail=True),
        Column("PSNR", DECIBELS, detail=True),
        Column("FLIP", NUMBER, "mean of the perceptual difference, 0 to 1", detail=True),
    ]
    cells = []
    for pair in found:
        rays = {each.kind: each for each in pair.rays}
        image = pair.image
        cells.append(
            [
                named(pair.scene),
                pair.accuracy,
                f"{pair.first} / {pair.second}",
                _verdict(pair),
                Cell("same") if pair.grids else Cell("differ", note=", ".join(pair.arrays)),
                *(
                    Cell(rays[kind].differing, of(rays[kind].differing, rays[kind].rays))
                    if kind in rays and rays[kind].differing
                    else Cell(0 if kind in rays else None)
                    for kind in kinds
                ),
                sum(each.id for each in pair.rays),
                sum(each.only_first + each.only_second for each in pair.rays),
                max((each.t_ulps for each in pair.rays), default=None),
                image.differing,
                image.largest,
                Cell(image.psnr, "" if image.psnr is not None else "equal"),
                image.perceptual,
            ]
        )
    return Table("Pairs of devices", columns, cells)


def _verdict(pair: ComparePair) -> Cell:
    if pair.equal:
        return Cell("same bits", mark=GOOD)
    return Cell("differs", mark=BAD, note="though promised") if pair.promised else Cell("differs, as it may")


def rays(found: Sequence[ComparePair]) -> Table:
    """Return the first ray in which two devices differ."""
    names = (
        "scene",
        "rung",
        "devices",
        "rays of",
        "number",
        "differs in",
        "first",
        "second",
        "where",
        "replay",
    )
    columns = [Column(name, COUNT if name == "number" else None) for name in names]
    cells = [
        (
            named(pair.scene),
            pair.accuracy,
            f"{pair.first} / {pair.second}",
            ray.kind,
            ray.index,
            ", ".join(ray.differs),
            ray.first,
            ray.second,
            ray.where or "-",
            f"clgrid repro {ray.replay}" if ray.replay else "-",
        )
        for pair in found
        if (ray := pair.ray) is not None
    ]
    return Table("The first ray that differs", columns, cells)


def speed(record: CompareRecord) -> Table:
    """Return what each device takes for each scene and rung."""
    kinds = [
        *dict.fromkeys(each.kind for device in record.devices for row in device.rows for each in row.kinds)
    ]
    columns = [
        Column("scene"),
        Column("rung"),
        Column("device"),
        Column("build", SECONDS),
        Column("render", SECONDS),
        Column("time to image", SECONDS, "build and render"),
        *(Column(kind, MRAYS, "rays, by the median") for kind in kinds),
        Column("grid", BYTES),
        Column("peak", BYTES, "most device bytes that the build held at once"),
        Column("first compile", SECONDS, "depends on caches of the driver"),
    ]
    cells: list[list[Cell | Value]] = []
    for device in record.devices:
        for row in device.rows:
            rates = {each.kind: each.mrays_per_s for each in row.kinds}
            cells.append(
                [
                    Cell(named(row.scene), note=row.scene),
                    row.accuracy,
                    device.label,
                    timed(row.build_s),
                    timed(row.render_s),
                    median(row.build_s) + median(row.render_s) if row.build_s and row.render_s else None,
                    *(rates.get(kind) for kind in kinds),
                    row.grid_bytes,
                    row.peak_bytes,
                    sum(row.first_compile_s) if row.first_compile_s else None,
                ]
            )
    # The same work of all devices together.
    works = [*dict.fromkeys((row.scene, row.accuracy) for device in record.devices for row in device.rows)]
    order = [works.index((row.scene, row.accuracy)) for device in record.devices for row in device.rows]
    cells = [cells[k] for k in sorted(range(len(cells)), key=order.__getitem__)]
    return Table("Times and bytes", columns, cells)


def devices(record: CompareRecord) -> list[Block]:
    """Return what the devices are, how they round, and what the smallest kernels reach."""
    return [_properties(record.devices), _arithmetic(record.devices), _smallest(record.devices)]


def _properties(found: Sequence[CompareDevice]) -> Table:
    columns = (
        Column("device"),
        Column("outcome"),
        Column("name"),
        Column("driver"),
        Column("units", COUNT, "compute units used"),
        Column("OpenCL"),
        Column("memory", BYTES),
        Column("largest buffer", BYTES),
        Column("rounds divide", None, "correctly rounded float32 division is promised"),
        Column("denormals", None, "float32"),
        Column("float lanes", None, "of vectors: preferred, native"),
        Column("note"),
    )
    cells = []
    for each in found:
        driver = each.driver
        outcome = Cell("completed", mark=GOOD) if each.status == COMPLETED else Cell(each.status, mark=BAD)
        limit = f"by {each.limited_by}" if each.limited_by else ""
        if driver is None:
            said: list[Cell | Value] = [each.device.platform, None, None, "-", "-", "-", each.reason]
        else:
            said = [
                driver.version,
                driver.global_memory,
                driver.max_allocation,
                "yes" if driver.correctly_rounded_divide else "no",
                "kept" if driver.denormals else "no promise",
                f"{driver.preferred_widths.get('float', 0)}, {driver.native_widths.get('float', 0)}",
                driver.note or each.reason or "-",
            ]
        cells.append(
            [each.label, outcome, each.device.name, each.device.driver, Cell(each.units, note=limit), *said]
        )
    return Table("Devices", columns, cells)


def _arithmetic(found: Sequence[CompareDevice]) -> Table:
    columns = (
        Column("device"),
        Column("type"),
        Column("wrong quotients", COUNT, "not the nearest number"),
        Column("worst", ULPS),
        Column("wrong roots", COUNT, "not the nearest number"),
        Column("worst", ULPS),
        Column("a*b+c rounded once", None, "with the device's defaults"),
        Column("where forbidden", None, "with FP_CONTRACT OFF"),
        Column("mad rounded once"),
        Column("fma rounded once"),
        Column("denormals read"),
        Column("denormals made"),
    )
    cells = [
        (
            device.label,
            each.type,
            Cell(each.wrong_quotients, of(each.wrong_quotients, each.operands)),
            each.quotient_ulps,
            Cell(each.wrong_roots, of(each.wrong_roots, each.operands)),
            each.root_ulps,
            each.contracted,
            Cell(
                each.contracted_when_forbidden, mark="" if each.contracted_when_forbidden == "never" else BAD
            ),
            each.mad,
            each.fma,
            each.denormals_read,
            each.denormals_made,
        )
        for device in found
        for each in device.arithmetic
    ]
    return Table("Arithmetic, as tried", columns, cells)


def _smallest(found: Sequence[CompareDevice]) -> Table:
    columns = (
        Column("device"),
        Column("launch", SECONDS, "of a kernel that does nothing, waited for"),
        Column("copy", _BANDWIDTH, "read and written by a kernel"),
        Column("upload", _BANDWIDTH, "from a host array"),
        Column("download", _BANDWIDTH, "to a host array"),
        Column("whole run", SECONDS, "of the device's process"),
        Column("memory", BYTES, "most that the process held at once"),
    )
    cells = []
    for device in found:
        speed = device.speed
        said: list[float | None] = [None] * 4
        if speed is not None:
            moved = speed.copied_bytes
            said = [
                median(speed.launch_s) / speed.launches if speed.launch_s else None,
                *(
                    count / median(times) if times else None
                    for count, times in (
                        (2 * moved, speed.copy_s),
                        (moved, speed.upload_s),
                        (moved, speed.download_s),
                    )
                ),
            ]
        cells.append([device.label, *said, sum(device.seconds), device.process_peak_bytes])
    return Table("The smallest kernels", columns, cells)
