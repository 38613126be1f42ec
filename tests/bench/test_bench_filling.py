"""``python -m bench.filling --quick``: every gap is reached, every peer comes near enough, and the table says so."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench import filling


def test_everything_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On numpy, so that nothing is compiled: the other tests of the solvers hold the devices."""
    pytest.importorskip("pyamg")
    pytest.importorskip("skimage")
    found = tmp_path / "filling.json"
    assert filling.main(["--quick", "--device", "numpy", "--json", str(found)]) == 0
    rows = json.loads(found.read_text())["rows"]
    assert {row["p"] for row in rows} == {1, 1.5, 2, 3}
    assert [row["work"] for row in rows if row["gap"] > row["share"]] == []
    # whether a bar is met is a matter of time; that it is judged is not
    assert [row["work"] for row in rows if row["met"] is None] == []
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert {line.count("|") for line in lines} == {len(filling.HEAD) + 1}
    assert len(lines) == len(rows) + 2
