"""The benchmark: every check of every case at tiny size, and a report as text, Markdown, JSON and picture. No times."""

from __future__ import annotations

import json

import pytest

from bench import cases as bench_cases
from bench import machine, table
from bench.model import Setup
from bench.run import Run
from gpureg import backends

# the first of each backend
DEVICES = list({device.backend: device.id for device in reversed(backends.devices())}.values())[::-1]


@pytest.mark.parametrize("names", bench_cases.CASES, ids=lambda names: names[0])
def test_results_are_checked_before_they_are_timed(names):
    """Ours against numpy, and against each peer that is installed at the tolerance of bench/README.md."""
    found = list(bench_cases.check(DEVICES, names))
    wrong = [f"{case}, {row}: {said}" for case, row, good, said in found if not good]
    assert not wrong
    ours = [said for _, row, _, said in found if row.split()[0] in DEVICES and not said.startswith("skipped")]
    skipped = [said for _, _, _, said in found if said.startswith("skipped")]
    assert ours or skipped
    assert all(said for said in ours)


@pytest.fixture(scope="module")
def report():
    """What a run of one case at tiny size writes down, with bounds that are made up."""
    bounds = {name: {"memory": 1e10, "best_rate": 1e11} for name in DEVICES}
    bounds["host"] = {"memory": 1e10, "best_rate": 1e11, "rate": 1e11, "array_bytes": 1e6}
    for threads in {1, machine.describe()["cores"]}:
        bounds["host"] |= {f"copy_{threads}": 1e10, f"triad_{threads}": 1e10}
    run = Run(Setup("tiny", DEVICES), 2, bounds)
    case = next(bench_cases.CASES[("digital-tv",)](run.setup))
    rows = run.measure(case)
    entry = {"name": case.name, "work": case.work, "notes": case.notes, "rows": rows}
    return {"machine": machine.describe(), "size": "tiny", "bounds": bounds, "cases": [entry]}


def test_a_report_says_what_was_measured(report):
    rows = [row for row in report["cases"][0]["rows"] if "min" in row]
    assert {row["who"] for row in rows} >= set(DEVICES)
    assert [row for row in rows if not (0 < row["min"] <= row["median"] and len(row["seconds"]) == 2)] == []
    ours = [row for row in rows if row["who"] == DEVICES[0]]
    assert all(row["check"] and row["bound"]["share"] > 0 for row in ours)
    # a bar is judged at full size alone
    assert [bar["met"] for row in ours for bar in row["bars"]] == [None]
    assert json.loads(json.dumps(report)) == report


@pytest.mark.parametrize("form", [table.plain, table.markdown], ids=["plain", "markdown"])
def test_a_report_as_text(report, form):
    text = form(report)
    assert [device for device in DEVICES if device not in text] == []
    assert "not judged" in text


def test_a_report_as_a_picture(report, tmp_path):
    pytest.importorskip("matplotlib")
    from bench.plot import draw

    picture = tmp_path / "bench.png"
    draw(report, picture)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_row_that_is_wrong_gets_no_time():
    """The check comes first: what it refuses is not timed, and the run goes on."""
    run = Run(Setup("tiny", DEVICES), 1, {})
    case = next(bench_cases.CASES[("digital-tv",)](run.setup))
    case.entries = [entry for entry in case.entries if entry.who == "numpy"]
    case.entries[0].check = lambda: (False, "off by 7")
    rows = run.measure(case)
    assert rows[0]["check"] is False and "min" not in rows[0] and "off by 7" in rows[0]["note"]
    assert "min" in rows[1]
