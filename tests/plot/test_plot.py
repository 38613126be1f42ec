"""Pictures of results: comparisons, quality, titles."""

from __future__ import annotations

import os
import pickle

import numpy as np
import pytest
from cases import rng

import gpureg as gr

pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")
pytest.importorskip("skimage", reason="scikit-image, of the extra 'plot', is not installed")
from drawn import picture
from matplotlib.colors import to_rgb
from PIL import Image
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

ORANGE = np.array(to_rgb("#ff7f0e"))


def drawn(axes):
    """The colours that a panel shows, (H, W, 3)."""
    (image,) = axes.get_images()
    return np.asarray(image.get_array())


@pytest.mark.parametrize(("shape", "axis"), [((20, 31), None), ((18, 21, 3), -1), ((9, 10, 11), None)])
def test_quality_is_scikit_images(shape, axis):
    clean, noisy = picture(shape)
    psnr, ssim = gr.plot.quality(noisy, clean, 1, channel_axis=axis)
    assert psnr == pytest.approx(peak_signal_noise_ratio(clean, noisy, data_range=1), abs=1e-12)
    assert ssim == pytest.approx(structural_similarity(clean, noisy, data_range=1, channel_axis=axis), abs=1e-12)


def test_quality_counts_the_known_pixels_alone():
    clean, noisy = picture((30, 40))
    holed = noisy.copy()
    holed[10:13, 20:22] = np.nan
    known = np.isfinite(holed)
    psnr, ssim = gr.plot.quality(holed, clean, 1)
    assert psnr == pytest.approx(-10 * np.log10(((noisy - clean)[known] ** 2).mean()), abs=1e-12)
    # by hand: the mean over all windows of 7 pixels without a hole
    _, similar = structural_similarity(clean, noisy, data_range=1, full=True)
    kept = [similar[i, j] for i in range(3, 27) for j in range(3, 37) if known[i - 3 : i + 4, j - 3 : j + 4].all()]
    assert ssim == pytest.approx(np.mean(kept), abs=1e-12)
    assert len(kept) < 24 * 34


def test_quality_at_the_ends():
    clean, noisy = picture((30, 40))
    assert gr.plot.quality(clean, clean) == (np.inf, pytest.approx(1))
    assert np.isnan(gr.plot.quality(np.full((30, 40), np.nan), clean)).all()
    psnr, ssim = gr.plot.quality(noisy[:2], clean[:2])
    assert np.isfinite(psnr) and np.isnan(ssim)
    assert np.isfinite(gr.plot.quality(noisy[:5], clean[:5])).all()


@pytest.mark.parametrize(
    ("image", "reference", "width"),
    [
        (np.uint8, np.uint8, 255),
        (np.uint16, np.float64, 65535),
        (np.float64, np.uint8, 255),
        (np.float64, np.float64, None),  # of the reference
        (np.bool_, np.float64, 1),
    ],
)
def test_the_data_range_is_that_of_the_integers_or_the_references(image, reference, width):
    values = rng(3).integers(0, 200, (12, 12))
    one, two = (
        (values > 90).astype(image) if image is np.bool_ else values.astype(image),
        (values // 2).astype(reference),
    )
    width = np.ptp(two.astype(float)) if width is None else width
    assert gr.plot.quality(one, two) == gr.plot.quality(one, two, width)
    assert gr.plot.quality(one, two) == gr.plot.quality(one, two, (-1, width - 1))


def test_other_titles():
    figure = gr.plot.compare(*picture((20, 30)), titles=("theirs", "ours"))
    assert [axes.get_title() for axes in figure.axes[:3]] == ["theirs", "ours", "theirs - ours"]
    for wrong in (("a",), "ab", 5, None, ("a", 1)):
        with pytest.raises(ValueError, match="titles must be two"):
            gr.plot.compare(*picture((20, 30)), titles=wrong)


def test_a_notebook_is_shown_the_picture():
    """IPython asks a value for this method; what it gives is the picture that would be written."""
    import io

    figure = gr.plot.compare(*picture((20, 30)))
    with Image.open(io.BytesIO(figure._repr_png_())) as shown:
        assert shown.format == "PNG"
        assert shown.size == tuple(figure.canvas.get_width_height())
    again = pickle.loads(pickle.dumps(figure))
    assert [axes.get_title() for axes in again.axes] == [axes.get_title() for axes in figure.axes]
    assert again._repr_png_()[:4] == b"\x89PNG"


def test_compare_grey(tmp_path):
    clean, noisy = picture((40, 60))
    eight = np.clip(np.rint(255 * noisy), 0, 255).astype(np.uint8)
    smooth = np.clip(np.rint(255 * clean), 0, 255).astype(np.uint8)
    figure = gr.plot.compare(eight, smooth, reference=smooth, path=tmp_path / "a.png", caption="words " * 60)
    left, middle, right, _ = figure.axes
    psnr, ssim = gr.plot.quality(eight, smooth)
    assert left.get_title() == f"noisy\nPSNR {psnr:.2f} dB, SSIM {ssim:.3f}"
    assert middle.get_title() == "denoised\nPSNR inf dB, SSIM 1.000"
    np.testing.assert_allclose(drawn(left), np.repeat(eight[..., None] / 255, 3, axis=-1))
    np.testing.assert_allclose(drawn(middle), np.repeat(smooth[..., None] / 255, 3, axis=-1))
    difference = eight.astype(float) - smooth
    spread = np.quantile(np.abs(difference), 0.995)
    np.testing.assert_allclose(drawn(right)[..., 0], np.clip(0.5 + difference / (2 * spread), 0, 1))
    assert os.listdir(tmp_path) == ["a.png"]
    with Image.open(tmp_path / "a.png") as opened:
        assert np.asarray(opened.convert("L"), float).std() > 20


def texts_lie_inside(figure):
    """Whether titles and caption stay inside the figure and apart from each other."""
    figure.draw_without_rendering()
    texts = [axes.title for axes in figure.axes if axes.get_title()] + figure.texts
    boxes = [text.get_window_extent() for text in texts]
    inside = all(0 <= b.x0 and b.x1 <= figure.bbox.x1 and 0 <= b.y0 and b.y1 <= figure.bbox.y1 for b in boxes)
    panels = [axes.get_window_extent() for axes in figure.axes]
    apart = not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[k + 1 :] + panels)
    return len(boxes) > 2 and inside and apart


@pytest.mark.parametrize("shape", [(64, 64), (8, 200), (300, 10), (20, 30, 8), (4, 5, 100)])
def test_texts_do_not_overlap(shape):
    clean, noisy = picture(shape)
    noisy[(0,) * len(shape)] = np.nan
    figure = gr.plot.compare(noisy, clean, reference=clean, caption="a caption, long enough to be broken; " * 8)
    assert texts_lie_inside(figure)
    assert texts_lie_inside(gr.plot.neighbours(clean, [s // 2 for s in shape], radius=2))


def test_compare_colours_and_unknown_pixels():
    clean, noisy = picture((3, 24, 24))
    noisy[1, 5, 6] = np.nan  # in green alone
    noisy[:, 7, 7] = np.inf
    figure = gr.plot.compare(noisy, clean, reference=clean, data_range=1, channel_axis=0)
    left, _, right, _ = figure.axes
    colours = np.moveaxis(noisy, 0, -1)
    known = np.isfinite(colours).all(axis=-1)
    np.testing.assert_allclose(drawn(left)[known], np.clip(colours, 0, 1)[known])
    for panel in (left, right):
        np.testing.assert_allclose(drawn(panel)[~known], np.broadcast_to(ORANGE, (2, 3)))
    assert [text.get_text() for text in figure.texts] == ["orange: no finite value"]
    assert gr.plot.compare(clean, clean, channel_axis=0).texts == []


def test_compare_volumes_in_three_planes():
    clean, noisy = picture((6, 20, 30))
    figure = gr.plot.compare(noisy, clean, spacing=(3, 1, 1), data_range=(-1, 2))
    assert [axes.get_ylabel() for axes in figure.axes[:9:3]] == ["axis 0 at 3", "axis 1 at 10", "axis 2 at 15"]
    for axes, plane in zip(figure.axes[:9:3], (noisy[3], noisy[:, 10], noisy[:, :, 15]), strict=True):
        np.testing.assert_allclose(drawn(axes)[..., 1], (plane + 1) / 3)
    assert [axes.get_aspect() for axes in figure.axes[:9:3]] == [1, 3, 3]


def test_compare_any_number_of_channels_and_deep_integers():
    values = rng(5).integers(1000, 3000, (20, 20, 2)).astype(np.uint16)
    left = gr.plot.compare(values, values, channel_axis=-1).axes[0]
    low, high = int(values.min()), int(values.max())
    np.testing.assert_allclose(drawn(left)[..., 0], (values.mean(axis=-1) - low) / (high - low))


def test_nothing_to_see_is_drawn_too():
    flat = np.full((8, 8), 5.0)
    assert np.isfinite(drawn(gr.plot.compare(flat, flat).axes[0])).all()
    empty = np.full((8, 8), np.nan)
    np.testing.assert_allclose(drawn(gr.plot.compare(empty, empty).axes[2]), np.broadcast_to(ORANGE, (8, 8, 3)))
