"""The pages on other libraries, on parameters and on performance run, and print what they say."""

from __future__ import annotations

from pathlib import Path

import pages
import pytest

from gpureg import backends

DOCS = Path(__file__).parents[2] / "docs"


def _run(name: str, folder: Path, *needed: str) -> list[pages.Block]:
    """Run a page where all that it imports is installed."""
    page = DOCS / name
    if not page.exists():
        pytest.skip("the page is not beside the tests")
    for peer in needed:
        pytest.importorskip(peer)
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("GPUREG_BACKEND", raising=False)
        patch.delenv("GPUREG_MEMORY", raising=False)
        ran = list(pages.run(page, folder))
    assert all(block.said for block in ran), [block.line for block in ran if not block.said]
    return ran


def test_coming_from_prints_what_it_says(tmp_path: Path) -> None:
    """Distances have two digits, of which the last may show a device or a peer's version."""
    ran = _run("coming_from.md", tmp_path, "skimage", "cv2", "networkx", "pyamg")
    assert len(ran) == 9
    assert pages.differing(ran, 0.15) == []
    # what is exact
    printed = "".join(block.printed for block in ran)
    assert "the same partition: True" in printed and "within its bound: True" in printed
    assert printed.count("below 1e-09") >= 8


def test_parameters_prints_what_it_says(tmp_path: Path) -> None:
    """Decibels and shares have few digits; sweeps until a test is met differ between devices."""
    ran = _run("parameters.md", tmp_path, "skimage")
    assert len(ran) == 13
    assert pages.differing(ran, 0.15) == []
    # what is exact
    printed = "".join(block.printed for block in ran)
    assert ": False" not in printed and printed.count(": True") == 4
    assert "\n0.0 " in printed, "pinned vertices keep their data"


def test_arrays_prints_what_it_says(tmp_path: Path) -> None:
    ran = _run("arrays.md", tmp_path, "torch", "warp", "pyopencl")
    assert len(ran) == 5
    assert pages.differing(ran, 0) == []


def test_performance_prints_what_it_says(tmp_path: Path) -> None:
    """Bytes a vertex differ by the padding of a device; the rest is exact."""
    if "opencl" in backends.absent():
        pytest.skip("the page tells the memory of an OpenCL device, and there is none")
    ran = _run("performance.md", tmp_path)
    assert len(ran) == 5
    assert pages.differing(ran, 0.15) == []
    assert "False" not in "".join(block.printed for block in ran)
