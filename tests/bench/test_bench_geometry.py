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
    for name in geometry.TABLES:
        lines = said.split(f"**{name}**")[1].split("**")[0].splitlines()
        rows = [line for line in lines if line.startswith("|")]
        assert len(rows) >= 3 and len({line.count("|") for line in rows}) == 1
    assert "no test data" in said and "as one graph" in said


def test_with_test_data(capsys, data_folder):
    assert geometry.main(["--quick", "--only", "quality"]) == 0
    lines = [line.split("|") for line in capsys.readouterr().out.splitlines() if "gpureg" in line]
    assert len(lines) == 2
    for cells in lines:
        assert float(cells[3]) <= float(cells[4])  # the angle, and the bar
