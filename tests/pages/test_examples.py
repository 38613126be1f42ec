"""The page on images runs, prints what it says, and shows the gains that it promises."""

from __future__ import annotations

import re
from pathlib import Path

import pages
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "images.md"
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="the page is not beside the tests")

# Two lines of a section, and the least difference in dB of the second from the first: a little less than on the page,
# so that the last digits of another device or library do not matter.
GAINS = [
    ("Without parameters", "noisy", "denoised", 9.0),
    ("What the noise is", "noisy", "white", 8.0),
    ("What the noise is", "white", "impulses replaced", -1.9),
    ("What the noise is", "with impulses", "impulses replaced", 11.0),
    ("What the noise is", "with stripes", "stripes stay", 7.0),
    ("What the noise is", "stripes stay", "stripes subtracted", 0.8),
    ("What the noise is", "mosaic", "mosaic denoised", 4.0),
    ("A volume", "noisy", "denoise_image", 15.0),
    ("A volume", "noisy", "denoise_nl_means", 14.0),
    ("A volume", "slice by slice", "denoise_image", 0.35),
    ("A series in colour", "ball, noisy", "ball, two pixels apart", 9.0),
    ("A series in colour", "ball, frame by frame", "ball, two pixels apart", 0.6),
    ("A series in colour", "ball, frame by frame", "ball, one pixel apart", 1.2),
    ("A series in colour", "pan, frame by frame", "pan, two pixels apart", 0.25),
    ("A series in colour", "pan, frame by frame", "pan, one pixel apart", 0.25),
    ("Holes and a mask", "noisy", "denoised", 9.0),
    ("Holes and a mask", "holes taken for black", "near holes", 4.5),
    ("Channels", "channel 0", "0, by its level", 4.0),
    ("Channels", "channel 1", "1, by its level", 4.0),
    ("Channels", "channel 2", "2, by its level", 10.5),
    ("Channels", "0, one sigma", "0, by its level", 3.5),
    ("Channels", "2, by its level", "2, guided by 0 and 1", 2.5),
    ("Photon noise", "noisy", "without parameters", 10.0),
    ("Photon noise", "one sigma, estimated", "without parameters", 7.0),
    ("Photon noise", "photon", "without parameters", -0.1),
    ("Photon noise", "with the offset", "without parameters", -0.1),
    ("Photon noise", "Anscombe and back", "without parameters", -0.2),
    ("The filters one by one", "centre once", "largest, averaged patches", 0.7),
    ("The filters one by one", "one h", "map of h", 1.8),
    ("The filters one by one", "by itself", "with a guide", 8.0),
    ("Choosing parameters", "the best there is", "calibrated", -0.1),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder in which the page is run and draws its pictures."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "images").mkdir()
    return folder


@pytest.fixture(scope="module")
def ran(folder: Path) -> list[pages.Block]:
    """The page's blocks, run once."""
    for peer in ("cv2", "matplotlib", "skimage"):
        pytest.importorskip(peer)
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("GPUREG_BACKEND", raising=False)
        return list(pages.run(PAGE, folder))


def test_page_prints_what_it_says(ran: list[pages.Block]) -> None:
    """Words are the same; numbers agree to half a percent, 0.15 dB, where devices differ by 0.01 dB."""
    assert len(ran) > 15
    assert pages.differing(ran, 5e-3) == []


@pytest.mark.parametrize(("section", "less", "more", "gain"), GAINS, ids=lambda value: str(value))
def test_gains(ran: list[pages.Block], section: str, less: str, more: str, gain: float) -> None:
    lines = [line for block in ran if block.section == section for line in block.printed.splitlines()]
    psnr = {line[:26].strip(): float(line[26:-2]) for line in lines if line.endswith(" dB")}
    assert psnr[more] - psnr[less] > gain


def test_pictures(ran: list[pages.Block], folder: Path) -> None:
    """The page shows the pictures that it draws; each is in the checkout and small."""
    shown = {f"images/{path.name}" for path in (folder / "images").iterdir()}
    assert shown == set(re.findall(r"!\[.*?\]\((.*?)\)", PAGE.read_text("utf-8")))
    assert [name for name in shown if (PAGE.parent / name).stat().st_size >= 150_000] == []


def test_a_page_that_says_something_else_is_found() -> None:
    assert pages.same("noisy  22.07 dB\n", "noisy 22.0 dB", 5e-3)
    assert not pages.same("noisy  22.07 dB\n", "noisy 21.0 dB", 5e-3)
    assert not pages.same("noisy  22.07 dB\n", "clean 22.07 dB", 5e-3)
    assert not pages.same("", "noisy 22.07 dB", 5e-3)
    assert not pages.same("noisy 22.07 dB\n", "", 5e-3)
