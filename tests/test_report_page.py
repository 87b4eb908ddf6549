"""The page of a report: whole, closed to the network and to what scenes are called, and alive in Chromium."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import report_records as made
from chromium import PROGRAM, Browser, browser

from clgrid.report.difference import compare
from clgrid.report.html import html
from clgrid.report.model import Axis, Cell, Column, HeatMap, Page, Point, Scatter, Section, Table
from clgrid.report.pages import difference, page
from clgrid.report.quantity import SECONDS
from clgrid.report.read import Run
from clgrid.report.scales import Scale
from clgrid.report.svg import front_of

needs_chromium = pytest.mark.skipif(PROGRAM is None, reason="no Chromium: apt-get install chromium")
VOID = {"meta", "link", "img", "br"}
# Of what opens a foreign element, all that is empty closes itself.
DRAWN = {"path", "circle"}


def pages() -> dict[str, Page]:
    found = {name: page(Run.of(record, name)) for name, record in made.every().items()}
    slow = made.row(render_s=made.times(0.9, 5, 7), hits=5)
    runs = [Run.of(record, f"{made.UNTRUSTED}.json") for record in (made.bench(), made.bench(slow))]
    return {**found, "difference": difference.page(compare(*runs))}


PAGES = pages()


class Parsed(HTMLParser):
    """Elements with their attributes and all text, if every element that opens is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attributes)))
        assert len(dict(attributes)) == len(attributes), (tag, attributes)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        assert tag in DRAWN
        self.elements.append((tag, dict(attributes)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open, tag
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        # Numbers are kept beside their units.
        self.text += data.replace("\u00a0", " ")


@pytest.mark.parametrize("name", list(PAGES))
def test_pages_are_whole_and_ask_for_nothing(name: str) -> None:
    text = html(PAGES[name])
    parsed = Parsed(text)
    assert parsed.open == []
    assert "://" not in text
    for tag, attributes in parsed.elements:
        for attribute in ("src", "href", "srcset", "action", "data", "xlink:href"):
            assert (attributes.get(attribute) or "data:").startswith("data:"), tag
        assert not any(attribute.startswith("on") for attribute in attributes), (tag, attributes)
    assert not re.search(r"@import|url\(", text)
    ids = [attributes["id"] for _, attributes in parsed.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    policy = [each.get("content") for _, each in parsed.elements if each.get("http-equiv")]
    assert policy[0] is not None
    assert policy[0].startswith("default-src 'none'")


@pytest.mark.parametrize("name", list(PAGES))
def test_names_are_text(name: str) -> None:
    parsed = Parsed(html(PAGES[name]))
    tags = [tag for tag, _ in parsed.elements]
    assert tags.count("script") == 1
    assert all(
        (attributes.get("src") or "").startswith("data:")
        for tag, attributes in parsed.elements
        if tag == "img"
    )
    assert "onerror=alert(1)" in parsed.text


def test_pages_say_what_they_say_and_how_to_repeat_it() -> None:
    tradeoff = Parsed(html(PAGES["tradeoff"])).text
    assert "Take robust, nested, density 4." in tradeoff
    assert "fast 240 ms (14 wrong pixels of 307,200); robust 400 ms, 1.67× the quickest" in tradeoff
    compared = Parsed(html(PAGES["compare"])).text
    assert "Not the same bits, though promised: 1 of 1 comparison." in compared
    assert "pocl-3.1 crashed at build robust: ended by signal 6" in compared
    assert shlex.join(made.compare().command) in compared
    same = page(Run.of(made.compare(0), "x"))
    assert same.says[0].startswith("The same answers, bit for bit: on robust, 2 devices built")


def test_the_front_is_what_nothing_is_below_and_left_of() -> None:
    assert front_of([(3, 1), (1, 3), (2, 2), (2, 3), (3, 2), (1, 3)]) == [(1, 3), (2, 2), (3, 1)]


def test_zeros_lie_in_a_lane_of_their_own() -> None:
    scale = Scale(Axis("error", SECONDS), [0.0, 1e-6, 1e-3], 400, 0)
    assert scale(0.0) > scale(1e-6) > scale(1e-3) > 0
    assert scale.zero
    assert all(1e-7 < tick < 1e-2 for tick in scale.ticks(8))
    assert not Scale(Axis("time", SECONDS), [1e-6, 1e-3], 400, 0).zero


@pytest.mark.parametrize("values", [[1.0], [0.0], [], [5.0, 5.0], [1e-300, 1e300], [3.0, 3.1]])
@pytest.mark.parametrize("log", [True, False])
def test_axes_have_ticks_within_whatever_the_values(values: list[float], log: bool) -> None:
    scale = Scale(Axis("x", SECONDS, log), values, 0, 300)
    ticks = scale.ticks(7)
    assert 1 <= len(ticks) <= 9
    assert all(0 <= scale(tick) <= 300 for tick in [*ticks, *values])
    assert len({scale(tick) for tick in ticks}) == len(ticks)


# In Chromium


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("profile")) as found:
        yield found


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages")
    for name, each in PAGES.items():
        (folder / f"{name}.html").write_text(html(each), encoding="utf-8")
    return folder


@needs_chromium
@pytest.mark.parametrize("name", list(PAGES))
def test_pages_are_quiet_and_fit_desks_and_phones_by_day_and_by_night(
    name: str, chromium: Browser, written: Path
) -> None:
    inks = []
    for width in (1280, 390):
        for scheme in ("light", "dark"):
            chromium.open(written / f"{name}.html", width, scheme)
            page_width, view = chromium.ask(
                "[document.documentElement.scrollWidth, document.documentElement.clientWidth]"
            )
            assert page_width <= view <= width
            inks.append(chromium.ask("getComputedStyle(document.body).color"))
            # What is not broken: no text beyond its box, but in boxes that scroll.
            assert (
                chromium.ask(
                    "[...document.querySelectorAll('h1, h2, h3, p, li, dd, .legend')]"
                    ".filter(each => each.scrollWidth > each.clientWidth + 1).map(each => each.textContent)"
                )
                == []
            )
            assert chromium.ask("[...document.images].every(each => each.complete && each.naturalWidth > 0)")
    assert len(set(inks)) == 2
    assert chromium.said == []


@needs_chromium
def test_a_name_that_is_a_script_does_not_run(chromium: Browser, written: Path) -> None:
    text = html(PAGES["bench"])
    (written / "evil.html").write_text(text.replace("<main>", "<main><script>window.ran = 1</script>"))
    chromium.open(written / "evil.html")
    assert chromium.ask("window.ran === undefined")
    assert any("Content Security Policy" in said for said in chromium.said)


TABLE = Page(
    "t",
    (),
    [
        Section(
            "s",
            [
                Table(
                    "t",
                    (Column("name"), Column("time", SECONDS)),
                    [("b", 0.02), ("a10", 3.0), ("a9", Cell(0.5, "half")), ("none", None), ("c", 0.02)],
                )
            ],
        )
    ],
)
ORDER = "[...document.querySelectorAll('tbody tr')].map(row => row.cells[0].textContent)"


@needs_chromium
def test_tables_sort_by_value_with_mouse_and_keyboard(chromium: Browser, tmp_path: Path) -> None:
    (tmp_path / "t.html").write_text(html(TABLE), encoding="utf-8")
    chromium.open(tmp_path / "t.html")
    heads = "document.querySelectorAll('th button')"
    given = chromium.ask(ORDER)
    chromium.ask(f"{heads}[1].click()")
    assert chromium.ask(ORDER) == ["a10", "a9", "b", "c", "none"]
    assert chromium.ask("document.querySelectorAll('th')[1].ariaSort") == "descending"
    chromium.ask(f"{heads}[1].focus()")
    chromium.press("Enter")
    assert chromium.ask(ORDER) == ["b", "c", "a9", "a10", "none"]
    assert chromium.ask("document.querySelectorAll('th')[1].ariaSort") == "ascending"
    chromium.ask(f"{heads}[0].click()")
    assert chromium.ask(ORDER) == ["a9", "a10", "b", "c", "none"]
    assert given == ["b", "a10", "a9", "none", "c"]
    assert chromium.ask("document.querySelectorAll('th[aria-sort]').length") == 1


HINT = "hint.hidden ? '' : hint.textContent"
ACTIVE = "(document.activeElement.ariaLabel || '').split('\\n')[0]"


@needs_chromium
def test_points_tell_what_they_are_to_pointer_and_keyboard(chromium: Browser, tmp_path: Path) -> None:
    points = [Point(f"point {k} <b>", 1.0 + k, 10.0 - k, facts=[("time", f"{k} s")]) for k in range(4)]
    axes = Axis("time", SECONDS), Axis("error", SECONDS)
    plot = Scatter("p", *axes, points)
    (tmp_path / "p.html").write_text(html(Page("t", (), [Section("s", [plot])])), encoding="utf-8")
    chromium.open(tmp_path / "p.html")
    assert chromium.ask(HINT) == ""
    chromium.press("Tab")
    assert chromium.ask(ACTIVE) == "point 0 <b>"
    assert chromium.ask(HINT) == "point 0 <b>\ntime: 0 s"
    chromium.press("ArrowRight")
    chromium.press("ArrowRight")
    assert chromium.ask(HINT) == "point 2 <b>\ntime: 2 s"
    chromium.press("ArrowLeft")
    assert chromium.ask(ACTIVE) == "point 1 <b>"
    chromium.press("Escape")
    assert chromium.ask(HINT) == ""
    # One stop of the tab key for the whole plot.
    assert chromium.ask("document.querySelectorAll('.wide .pt[tabindex=\"0\"]').length") == 1
    chromium.ask("document.activeElement.blur()")
    x, y = chromium.ask(
        "(box => [(box.left + box.right) / 2, (box.top + box.bottom) / 2])"
        "(document.querySelectorAll('.wide .pt')[3].querySelector('.mark').getBoundingClientRect())"
    )
    chromium.point(x + 5, y + 5)
    assert chromium.ask(HINT) == "point 3 <b>\ntime: 3 s"
    inside = "(box => box.left >= 0 && box.right <= innerWidth && box.top >= 0)(hint.getBoundingClientRect())"
    assert chromium.ask(inside)
    chromium.point(5, 5)
    assert chromium.ask(HINT) == ""
    assert chromium.said == []


@needs_chromium
def test_phones_get_a_plot_of_their_own(chromium: Browser, written: Path) -> None:
    sizes = []
    for width in (1280, 390):
        chromium.open(written / "tradeoff.html", width)
        shown = chromium.ask(
            "[...document.querySelectorAll('svg.plot')].map(each => each.getBoundingClientRect())"
            ".filter(box => box.width).map(box => [box.width, box.height])"
        )
        ticks = chromium.ask(
            "[...document.querySelectorAll('.tick')].map(each => each.getBoundingClientRect())"
            ".filter(box => box.height).map(box => box.height)"
        )
        assert len(shown) == 2
        # Text keeps its size.
        assert min(ticks) > 10
        sizes.append(shown[0][0])
    assert sizes[0] > 900
    assert 250 < sizes[1] < 366


@needs_chromium
def test_heat_maps_show_where(chromium: Browser, tmp_path: Path) -> None:
    values = np.zeros((4, 6))
    values[1, 2] = 3.0
    heat = HeatMap("h", values)
    (tmp_path / "h.html").write_text(html(Page("t", (), [Section("s", [heat])])), encoding="utf-8")
    chromium.open(tmp_path / "h.html")
    lit = chromium.ask(
        "(image => { const canvas = document.createElement('canvas'); canvas.width = 6; canvas.height = 4;"
        " const draw = canvas.getContext('2d'); draw.drawImage(image, 0, 0); const data ="
        " draw.getImageData(0, 0, 6, 4).data; return [...Array(24).keys()].filter(k => data[4 * k] > 100); })"
        "(document.querySelector('.heat img'))"
    )
    assert lit == [8]
    assert chromium.ask("document.querySelector('.heat img').alt") == "h: at most 3"
