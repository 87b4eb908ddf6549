"""``clgrid report``: files read and written, exit codes, and errors of one line."""

from __future__ import annotations

import csv
import importlib.util
import io
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
import report_records as made

from clgrid.cli import main
from clgrid.errors import InputError, UnsupportedError
from clgrid.record import decode, encode
from clgrid.report import csvfile, files
from clgrid.report.difference import compare
from clgrid.report.difference_record import DifferenceRecord
from clgrid.report.entries import entries
from clgrid.report.heat import heat_png
from clgrid.report.pages import page
from clgrid.report.quantity import BYTES, COUNT, NUMBER, PERCENT, SECONDS
from clgrid.report.read import Run, read

PLOTS = importlib.util.find_spec("matplotlib") is not None
needs_matplotlib = pytest.mark.skipif(not PLOTS, reason="no matplotlib: the extra plot is not installed")
EVERY = made.every()


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Run ``clgrid report`` in an empty folder: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> tuple[object, str, str]:
        with pytest.raises(SystemExit) as exit_:
            main(["report", *words])
        streams = capsys.readouterr()
        return exit_.value.code, streams.out, streams.err

    return call


def save(name: str, record: msgspec.Struct) -> str:
    Path(name).write_text(encode(record))
    return name


# Numbers


@pytest.mark.parametrize(
    ("quantity", "value", "text"),
    [
        (SECONDS, 0.0123, "12.3 ms"),
        (SECONDS, 0.9997, "1 s"),
        (SECONDS, 0.0, "0 ns"),
        (BYTES, 1500, "1.5 kB"),
        (BYTES, 12, "12 B"),
        (COUNT, 1234567, "1,234,567"),
        (PERCENT, 0.00012, "0.012%"),
        (NUMBER, 2.5e-6, "2.5×10⁻⁶"),
        (NUMBER, 1e-7, "10⁻⁷"),
        (NUMBER, None, "-"),
    ],
)
def test_numbers_have_their_units(quantity: Any, value: float | None, text: str) -> None:
    assert quantity.text(value) == text


def test_a_column_has_one_unit() -> None:
    values = [0.012, 0.5, 0.000004, 0.0]
    size, unit = SECONDS.scale(values)
    digits = SECONDS.decimals(values, size)
    assert unit == "ms"
    assert [SECONDS.write(value, size, digits) for value in values] == ["12.0", "500.0", "0.004", "0"]


# One record


@pytest.mark.parametrize("kind", list(EVERY))
def test_a_record_becomes_a_table_again(run: Any, kind: str) -> None:
    save("r.json", EVERY[kind])
    code, out, err = run("r.json")
    assert (code, err) == (0, "")
    assert "┃" in out
    assert "alert(1)" in out
    assert sorted(path.name for path in Path().iterdir()) == ["r.json"]


@pytest.mark.parametrize("kind", list(EVERY))
def test_csv_gives_back_what_the_record_says(run: Any, kind: str) -> None:
    save("r.json", EVERY[kind])
    assert run("r.json", "--csv", "r.csv", "-q") == (0, "", "")
    with open("r.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    expected = entries(Run.of(EVERY[kind], "").document)
    assert len(rows) == len(expected)
    for row, entry in zip(rows, expected, strict=True):
        for name, value in {**entry.names, **entry.marks, **entry.values}.items():
            kind_of = type(value)
            text = row[name]
            if value is None or kind_of is bool:
                assert text == {None: "", True: "true", False: "false"}[value]
            else:
                assert kind_of(text) == value
        for name, times in entry.times.items():
            assert [float(each) for each in row[name + csvfile.ALL].split()] == times
            assert min(times) <= float(row[name]) <= max(times)


def test_json_gives_the_record_back(run: Any) -> None:
    save("r.json", EVERY["compare"])
    assert run("r.json", "--json") == (0, encode(EVERY["compare"]), "")


@needs_matplotlib
@pytest.mark.parametrize(("kind", "suffix"), [*((kind, ".png") for kind in EVERY), ("compare", ".svg")])
def test_plots_are_drawn(run: Any, kind: str, suffix: str) -> None:
    save("r.json", EVERY[kind])
    assert run("r.json", "--plot", f"p{suffix}", "-q") == (0, "", "")
    data = Path(f"p{suffix}").read_bytes()
    assert data.startswith(b"\x89PNG") if suffix == ".png" else b"<svg" in data


def test_a_missing_matplotlib_is_one_line(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    save("r.json", EVERY["bench"])
    code, out, err = run("r.json", "--plot", "p.png", "--html", "p.html")
    assert (code, out) == (1, "")
    assert err == "clgrid: error: --plot needs matplotlib; pip install 'clgrid[plot]'\n"
    assert not Path("p.html").exists()


def test_help_names_the_extra(run: Any) -> None:
    assert "clgrid[plot]" in "".join(run("--help")[1].replace("│", "").split())


def test_matplotlib_is_not_imported_without_a_plot(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    path.write_text(encode(EVERY["bench"]))
    script = (
        "import sys\nfrom clgrid.cli import main\n"
        f"try:\n    main(['report', {str(path)!r}, '-q', '--html', {str(tmp_path / 'r.html')!r}])\n"
        "except SystemExit as done:\n    print(done.code, 'matplotlib' in sys.modules)"
    )
    root = Path(__file__).parent.parent
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=root, capture_output=True, text=True, check=True
    )
    assert done.stdout == "0 False\n"


EMPTY: dict[str, dict[str, object]] = {
    "bench": {"rows": []},
    "workload": {"rows": []},
    "frames": {"rows": []},
    "verify": {"rows": []},
    "compare": {"devices": [], "pairs": []},
    "tradeoff": {"rows": [], "front": [], "recommendation": None, "nearest": "nothing"},
}


@pytest.mark.parametrize("kind", list(EMPTY))
def test_a_record_of_nothing_has_a_page(run: Any, kind: str) -> None:
    save("r.json", msgspec.structs.replace(EVERY[kind], **EMPTY[kind]))
    code, _, err = run("r.json", "--html", "r.html", "--csv", "r.csv")
    assert (code, err) == (0, "")
    assert "<h1>" in Path("r.html").read_text()


# Two records


def test_exit_code_2_is_a_regression_and_nothing_else(run: Any) -> None:
    row = made.row()
    slow = msgspec.structs.replace(row, render_s=[2 * each for each in row.render_s])
    save("a.json", made.bench(row)), save("b.json", made.bench(slow))
    code, out, err = run("a.json", "b.json")
    assert code == 2
    assert "1 regression beyond noise" in out
    assert re.fullmatch(r"clgrid: error: b\.json is worse than a\.json: .*: render 2×\n", err)
    assert run("b.json", "a.json")[0] == 0
    assert run("a.json", "a.json")[0] == 0
    assert run("a.json", "b.json", "--threshold", "150%", "-q") == (0, "", "")
    code, out, _ = run("a.json", "b.json", "--json")
    found = decode(out, DifferenceRecord)
    assert (code, found.threshold, found.first.file) == (2, 0.1, "a.json")


def test_the_files_of_a_comparison(run: Any) -> None:
    save("a.json", made.bench(made.row())), save("b.json", made.bench(made.row(hits=1)))
    assert run("a.json", "b.json", "--csv", "d.csv", "--html", "d.html", "-q")[0] == 2
    found = compare(read("a.json"), read("b.json"))
    rows = list(csv.DictReader(io.StringIO(Path("d.csv").read_text())))
    assert [(row["row"], row["field"], row["verdict"]) for row in rows] == [
        (each.row, each.field, each.verdict) for each in found.findings
    ]
    hits = next(row for row in rows if row["field"] == "hits")
    assert (hits["first"], hits["second"], hits["verdict"]) == ("123456", "1", "worse")
    assert "regression" in Path("d.html").read_text()


# What is refused


def _broken(change: Callable[[dict[str, Any]], object], kind: str = "bench") -> str:
    document = json.loads(encode(EVERY[kind]))
    change(document)
    return json.dumps(document)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no JSON"),
        ("{", "no JSON"),
        ("\xff\xfe", "no JSON"),
        ("[" * 100_000, "no JSON"),
        ("[1, 2]", r"`\$\.schema`"),
        ('{"name": "other"}', r"`\$\.schema`"),
        ('{"schema": 3}', r"`\$\.schema`"),
        ('{"schema": "clgrid.info/1"}', "'clgrid.info/1', which no report is for"),
        ('{"schema": "clgrid.bench/2"}', "'clgrid.bench/2', which no report is for"),
        (_broken(lambda d: d.pop("rows")), "missing required field `rows`"),
        (_broken(lambda d: d["rows"][0].pop("hits")), r"missing required field `hits` - at `\$\.rows\[0\]`"),
        (_broken(lambda d: d["rows"][0].update(build_s=0.5)), r"at `\$\.rows\[0\]\.build_s`"),
        (_broken(lambda d: d["rows"][0].update(extra=1)), "unknown field `extra`"),
        (_broken(lambda d: d["rows"][0].update(render_s=[0.1, -0.5])), r"at `\$\.rows\[0\]\.render_s\[1\]`"),
        (_broken(lambda d: d["rows"][1].update(render_s=[])), r"at `\$\.rows\[1\]\.render_s`"),
        (_broken(lambda d: d["recommendation"].update(row=99), "tradeoff"), r"`\$\.recommendation`"),
        (_broken(lambda d: d["rows"][2].update(errors_of=99), "tradeoff"), r"`\$\.rows\[2\]\.errors_of`"),
        (_broken(lambda d: d["rows"][2].update(turns=[0]), "tradeoff"), r"`\$\.rows\[2\]\.turns`"),
        (_broken(lambda d: d.update(slowness=[1.0]), "tradeoff"), r"`\$\.rows\[0\]\.turns`"),
        (_broken(lambda d: d["pairs"][0]["heat_map"].update(width=3), "compare"), r"\[0\]\.heat_map`"),
    ],
)
def test_damaged_and_foreign_files_are_one_line(run: Any, text: str, said: str) -> None:
    Path("odd.json").write_text(text, encoding="latin-1")
    code, out, err = run("odd.json")
    assert (code, out) == (1, "")
    assert re.fullmatch(rf"clgrid: error: odd\.json: [^\n]*{said}[^\n]*\n", err), err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("none.json",), "none.json: cannot be read"),
        (("r.json", "r.json", "r.json"), "3 records; give one, or two"),
        (("r.json", "--threshold", "5%"), "--threshold belongs to two records"),
        (("r.json", "--unknown-noise", "5%"), "--unknown-noise belongs to two records"),
        (("r.json", "r.json", "--threshold", "much"), "--threshold 'much': give a share"),
        (("r.json", "r.json", "--threshold", "-1"), "--threshold '-1': give a share"),
        (("r.json", "r.json", "--threshold", "nan"), "--threshold 'nan': give a share"),
        (("r.json", "--html", "no/such/p.html"), "no such folder"),
        (("r.json", "--csv", "."), "is a folder"),
        (("r.json", "--plot", "p.pdf"), "end its name in .png or .svg"),
    ],
)
def test_wrong_usage_is_one_line(run: Any, words: tuple[str, ...], said: str) -> None:
    save("r.json", EVERY["bench"])
    code, out, err = run(*words)
    assert (code, out) == (1, "")
    assert re.fullmatch(r"clgrid: error: [^\n]+\n", err)
    assert said in err


def test_a_file_appears_only_when_it_is_complete(tmp_path: Path) -> None:
    def fail(path: Path) -> None:
        path.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match="No space left"):
        files.save(tmp_path / "x.html", "--html", fail)
    assert list(tmp_path.iterdir()) == []


def test_errors_of_a_missing_extra_have_their_type(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(UnsupportedError):
        files.check_plot(tmp_path / "x.png")


def test_what_has_no_page_is_refused() -> None:
    with pytest.raises(TypeError, match="no page"):
        page(Run("x", made.ROW_ONLY, {}))  # type: ignore[arg-type]


def test_heat_maps_are_pictures_that_others_read(tmp_path: Path) -> None:
    import numpy as np
    import OpenImageIO as oiio  # noqa: N813

    values = np.array([[0.0, 1.0, 4.0], [np.nan, 0.001, 2.0]])
    (tmp_path / "h.png").write_bytes(heat_png(values))
    image = oiio.ImageBuf(str(tmp_path / "h.png")).get_pixels(oiio.UINT8)
    assert image.shape[:2] == (2, 3)
    light = image[..., :3].astype(int) @ [299, 587, 114]
    # 0 is darkest, more is lighter, and however little is not 0.
    assert light[0, 0] < light[1, 1] < light[0, 1] < light[1, 2] < light[0, 2]
    assert image[1, 0, :3].tolist() == [128, 132, 140]
