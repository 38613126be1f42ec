"""The page on meshes, curves and points runs and prints what it says."""

from __future__ import annotations

from pathlib import Path

import pages
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "meshes.md"
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="the page is not beside the tests")


def test_page_prints_what_it_says(tmp_path: Path) -> None:
    """Rounded numbers, of which the last place may show a device's digits; counts of what met to 15 percent."""
    pytest.importorskip("matplotlib")
    (tmp_path / "images").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("GPUREG_BACKEND", raising=False)
        ran = list(pages.run(PAGE, tmp_path))
    assert len(ran) == 5
    assert pages.differing(ran, 0.15) == []
    # what is exact
    assert ran[1].printed.startswith("0.0 True\n") and "6 sides; 1 part" in ran[2].printed
    assert ran[2].printed.startswith("200 of 1538 vertices, closed: True\n")
    assert ran[4].printed.endswith("[400 400 400]\n")
    assert {path.name for path in (tmp_path / "images").iterdir()} == {"mesh.png", "skeleton.png"}
