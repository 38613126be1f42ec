"""The page on solvers runs, and prints what it says."""

from __future__ import annotations

from pathlib import Path

import pages
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "solvers.md"


@pytest.mark.skipif(not PAGE.exists(), reason="the page is not beside the tests")
def test_page_prints_what_it_says(tmp_path, monkeypatch):
    """Words are the same; numbers agree to 2 percent: where an iteration stops differs between devices."""
    pytest.importorskip("skimage")
    monkeypatch.delenv("GPUREG_BACKEND", raising=False)
    ran = list(pages.run(PAGE, tmp_path))
    assert len(ran) == 9
    assert [block.line for block in ran if not block.said] == []
    assert pages.differing(ran, 2e-2) == []
