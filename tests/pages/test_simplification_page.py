"""The page on simplification runs and prints what it says."""

from __future__ import annotations

import re
from pathlib import Path

import pages
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "simplification.md"
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="the page is not beside the tests")


def test_page_prints_what_it_says(tmp_path: Path) -> None:
    """Partitions to the pixel; PSNR, and counts of what has met after floats moved, to two percent."""
    for peer in ("matplotlib", "skimage"):
        pytest.importorskip(peer)
    (tmp_path / "images").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("GPUREG_BACKEND", raising=False)
        ran = list(pages.run(PAGE, tmp_path))
    assert len(ran) == 4
    assert pages.differing(ran, 0.02) == []
    # what comes before the floats is exact
    assert [block.said.splitlines()[0] for block in ran[:2]] == [block.printed.splitlines()[0] for block in ran[:2]]
    counts = [int(number) for number in re.findall(r"(\d+) regions", ran[3].printed)]
    assert counts == sorted(counts, reverse=True)
    assert {path.name for path in (tmp_path / "images").iterdir()} == {"simplification.png", "merged.png"}
