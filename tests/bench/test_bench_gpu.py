"""``python -m bench.gpu``: the model of a GPU, and the report; tests/gpu runs all of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench import machine
from bench.gpu import report, rows, run
from bench.gpu.counts import COUNTS, H200, Count, table

PAGE = Path(__file__).parents[2] / "docs" / "performance.md"
COPY = 2.0**40


def test_the_largest_bound_counts():
    """A billion vertices: 8 bytes at 4.3 TB/s are 1.9 ms, 100 instructions at 22.2e12 a second 4.5 ms."""
    n = 10**9
    assert Count(8).seconds(n) == pytest.approx(8 / 4300 + H200.launch)
    assert Count(8, 100).seconds(n) == pytest.approx(100 / 22200 + H200.launch)
    assert (Count(8).bound(), Count(8, 100).bound(), Count(8, 1, 100).bound()) == (
        "bandwidth", "instructions", "local memory",
    )  # fmt: skip
    # a transfer does not overlap with the kernel
    assert Count(8, host=8, launches=3).seconds(n) == pytest.approx(8 / 4300 + 8 / 50 + 3 * H200.launch)


def test_the_page_has_the_predicted_table():
    if not PAGE.exists():
        pytest.skip("the page is not beside the tests")
    assert report.predicted() in PAGE.read_text("utf-8")
    assert len(table()) == 2 + len(COUNTS)


def test_rows_have_counts():
    """Each prediction has its row; roads of the test data and what has another data or solver has none."""
    assert set(COUNTS) <= {row.name for row in run.all_rows(quick=True)}


def made_up() -> dict:
    """What a run finds, from a row that is timed, one that fails and one that has no time."""
    (device, *_) = run.chosen(["numpy"])
    sweep, nonlocal_means = next(rows.iterated(8, 3, 20, 4)), next(rows.one_step(5))
    broken = rows.Row("combine", "iterated", "1", 1, lambda device: 1 / 0)
    found = {"machine": machine.describe(), "size": "quick", "bounds": {device.id: {"copy": COPY}}, "peers": []}
    check = {"comparisons": 3, "primitives": 2, "wrong": ["dot is off by 7"], "not compared": ["sweep"]}
    measured = [run.measure(device, row, COPY, 2) for row in (sweep, nonlocal_means, broken)]
    return found | {"checks": {device.id: check}, "rows": measured}


def test_a_report(tmp_path):
    pytest.importorskip("matplotlib")
    found = made_up()
    sweep, step, broken = found["rows"]
    assert sweep["share"] == pytest.approx(64 * 12 / sweep["min"] / COPY) and "share" not in step
    assert "ZeroDivisionError" in broken["note"] and "min" not in broken
    said = report.text(found)
    assert "WRONG: dot is off by 7" in said and "not compared: sweep" in said and "ZeroDivisionError" in said
    widths = {line.count("|") for line in said.splitlines() if line.startswith("|")}
    assert widths == {9}
    stored = tmp_path / "gpu.json"
    stored.write_text(json.dumps(found))
    # a wrong result is the exit code, also of a report that is shown again
    assert run.main(["--from", str(stored), "--plot", str(tmp_path / "gpu.png")]) == 1
    assert (tmp_path / "gpu.png").read_bytes().startswith(b"\x89PNG")
