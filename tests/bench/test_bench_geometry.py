"""The tables of meshes, curves and points run, whatever peers there are."""

from __future__ import annotations

import pytest

pytest.importorskip("skimage", reason="scikit-image, of the extra 'bench', is not installed")

from bench import geometry


def test_tables(capsys, monkeypatch):
    """Each has rows as wide as its head; without test data they say so."""
    monkeypatch.delenv("GPUREG_DATA", raising=False)
    assert geometry.main(["--quick"]) == 0
    said = capsys.readouterr().out
    lines = {name: said.split(f"**{name}**")[1].split("**")[0].splitlines() for name in geometry.TABLES}
    bars = {name: [line.count("|") for line in lines[name] if line.startswith("|")] for name in geometry.TABLES}
    assert {name: widths for name, widths in bars.items() if len(widths) < 3 or len(set(widths)) > 1} == {}
    assert "no test data" in said and "as one graph" in said


def test_with_test_data(capsys, data_folder):
    assert geometry.main(["--quick", "--only", "quality"]) == 0
    lines = [line.split("|") for line in capsys.readouterr().out.splitlines() if "gpureg" in line]
    assert len(lines) == 2
    # the angle, and the bar
    assert [cells for cells in lines if not float(cells[3]) <= float(cells[4])] == []
