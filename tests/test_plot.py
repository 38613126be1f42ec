"""Pictures: what is drawn and written in the titles, and the sentences for what cannot be drawn. Not how it looks."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import paper
import pytest
from cases import rng

import gpureg as gr

pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")
pytest.importorskip("skimage", reason="scikit-image, of the extra 'plot', is not installed")

from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from PIL import Image
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

ORANGE = np.array(to_rgb("#ff7f0e"))


def picture(shape, seed=7):
    """Values in 0..1 with some structure, and the same with noise."""
    clean = sum(np.sin(x) for x in np.meshgrid(*(np.linspace(0, 5, s) for s in shape), indexing="ij")) / 8 + 0.5
    return clean, clean + 0.1 * rng(seed).standard_normal(shape)


def drawn(axes):
    """The colours that a panel shows, (H, W, 3)."""
    (image,) = axes.get_images()
    return np.asarray(image.get_array())


# quality


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


# compare


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


# neighbours


def weights_in(axes):
    """Weights by their place (column, row) as a panel shows them."""
    (squares,) = (c for c in axes.collections if isinstance(c, PolyCollection))
    corners = [path.vertices[:4].mean(axis=0) for path in squares.get_paths()]
    return {tuple(np.rint(c).astype(int).tolist()): w for c, w in zip(corners, squares.get_array(), strict=True)}


@pytest.mark.parametrize("pixel", [(9, 8), (0, 14), (17, 1)])
@pytest.mark.parametrize("metric", ["chebyshev", "euclidean"])
def test_the_weights_drawn_are_the_papers(device, pixel, metric):
    """In the middle and at borders, where patches are filled by reflection, from a part of the image."""
    shape, k = (18, 15), 3
    _, noisy = picture(shape)
    f0 = dict(np.ndenumerate(noisy.astype(np.float32).astype(float)))
    figure = gr.plot.neighbours(noisy, pixel, weights=gr.weights.patch(2, 0.5), radius=k, metric=metric, backend=device)
    around = paper.k_neighbourhood(paper.pixels(shape), pixel, k, metric)
    g = paper.flat_patch(2, 2)
    expected = {(v[1], v[0]): paper.w2(pixel, v, [f0], shape, g, 0.5) for v in around}
    # measured against float64: 4e-7 of weights up to 0.6
    assert weights_in(figure.axes[2]) == pytest.approx(expected, abs=2e-6)
    assert figure.axes[2].get_title() == f"{len(around)} weights, sum {sum(expected.values()):.4g}"


def test_a_part_of_the_image_is_enough(monkeypatch):
    """The weights of one pixel of a large picture take those of a few pixels around it."""
    from gpureg.backends.numpy import primitives as numpy

    seen = []
    compute = numpy.NumpyBackend.patch_distance

    def watched(self, graph, *given, **settings):
        seen.append(graph.shape)
        return compute(self, graph, *given, **settings)

    monkeypatch.setattr(numpy.NumpyBackend, "patch_distance", watched)
    gr.plot.neighbours(picture((300, 200))[1], (5, 100), weights=gr.weights.patch(2, 0.5), radius=4)
    assert seen == [(5 + 1 + 6, 6 + 1 + 6)]


def test_neighbours_in_a_volume():
    _, noisy = picture((7, 9, 11))
    pixel = (3, 4, 5)
    figure = gr.plot.neighbours(noisy, pixel, weights=gr.weights.bilateral(2, 0.3), radius=2)
    f0 = dict(np.ndenumerate(noisy))
    around = paper.k_neighbourhood(paper.pixels(noisy.shape), pixel, 2, "chebyshev")
    for row, (fixed, y, x) in enumerate(((0, 1, 2), (1, 0, 2), (2, 0, 1))):
        plane = [v for v in around if v[fixed] == pixel[fixed]]
        expected = {(v[x], v[y]): paper.w1(pixel, v, [f0], 2, 0.3) for v in plane}
        assert weights_in(figure.axes[3 * row + 2]) == pytest.approx(expected, abs=2e-6)  # float32
    assert figure.axes[2].get_title().startswith("124 weights")


def test_neighbours_in_a_mask_with_spacing_and_without_weights():
    _, noisy = picture((12, 12))
    mask = rng(9).random((12, 12)) < 0.6
    mask[6, 6] = True
    noisy[~mask] = np.nan
    figure = gr.plot.neighbours(noisy, (6, 6), radius=3, spacing=(1.5, 1), mask=mask)
    expected = {(x, y): 1.0 for y in range(4, 9) for x in range(3, 10) if mask[y, x] and (y, x) != (6, 6)}
    assert weights_in(figure.axes[2]) == expected
    assert figure.axes[0].get_aspect() == 1.5


def test_neighbours_where_weights_need_the_whole():
    """Weights whose values hang on the place are not computed on a part."""
    clean, _ = picture((9, 14))
    spacing = (1.0, 0.7)
    figure = gr.plot.neighbours(clean, (4, 9), radius=2, spacing=spacing, weights=gr.weights.inverse_distance(2))
    for (x, y), weight in weights_in(figure.axes[2]).items():
        assert weight == pytest.approx(1 / ((y - 4) ** 2 + 0.49 * (x - 9) ** 2), rel=1e-6)  # float32


def test_neighbours_in_colour_and_by_an_array_of_weights():
    _, noisy = picture((12, 13, 3))
    pixel = (5, 6)
    figure = gr.plot.neighbours(
        np.moveaxis(noisy, -1, 0), pixel, weights=gr.weights.bilateral(3, 0.4), radius=2, channel_axis=0
    )
    f0s = [dict(np.ndenumerate(noisy[..., c])) for c in range(3)]
    around = paper.k_neighbourhood(paper.pixels((12, 13)), pixel, 2, "chebyshev")
    expected = {(v[1], v[0]): paper.w1(pixel, v, f0s, 3, 0.4) for v in around}
    assert weights_in(figure.axes[2]) == pytest.approx(expected, abs=2e-6)  # float32
    grid = gr.GridGraph((12, 13), 2)
    graph = grid.to_graph()
    values = 1.0 + graph.edge_rows() + graph.indices
    figure = gr.plot.neighbours(noisy[..., 0], pixel, graph=grid, weights=values)
    u = 5 * 13 + 6
    assert weights_in(figure.axes[2]) == {(v[1], v[0]): 1.0 + u + 13 * v[0] + v[1] for v in around}


def test_neighbours_in_a_stored_graph():
    """Anywhere in the image, with the graph's weights, with ones, and with weights that are computed."""
    _, noisy = picture((10, 12))
    u, others = 3 * 12 + 4, np.array([0, 50, 51, 119])
    edges = np.stack([np.full(4, u), others], axis=1)
    graph = gr.Graph.from_edges(edges, [0.1, 0.2, 0.3, 0.4], n_vertices=120)
    places = [(v % 12, v // 12) for v in others.tolist()]

    def shown(**given):
        return weights_in(gr.plot.neighbours(noisy, (3, 4), graph=given.pop("graph", graph), **given).axes[2])

    assert shown() == pytest.approx(dict(zip(places, [0.1, 0.2, 0.3, 0.4], strict=True)), abs=1e-7)  # float32
    bare = gr.Graph.from_edges(edges, n_vertices=120)
    assert shown(graph=bare) == dict.fromkeys(places, 1.0)
    expected = np.exp(-((noisy.ravel()[others] - noisy[3, 4]) ** 2) / 0.3**2)
    computed = shown(weights=gr.weights.patch(0, 0.3))
    assert computed == pytest.approx(dict(zip(places, expected, strict=True)), abs=2e-6)  # float32


# energy


@pytest.fixture(scope="module")
def results():
    _, noisy = picture((16, 16))
    grid = gr.GridGraph((16, 16))
    return {
        name: gr.regularize(noisy, grid, p=1, max_iter=50, solver=gr.Jacobi(damping=theta), backend="numpy")
        for name, theta in (("plain", 1.0), ("damped", 0.5))
    }


def test_energy_of_one_run(results, tmp_path):
    run = results["plain"]
    figure = gr.plot.energy(run, path=tmp_path / "e.png")
    left, right = figure.axes
    np.testing.assert_array_equal(left.lines[0].get_xdata(), run.checks)
    np.testing.assert_array_equal(left.lines[0].get_ydata(), run.energy)
    assert right.get_yscale() == "log"
    np.testing.assert_allclose(right.lines[0].get_ydata()[:-1], (run.energy - run.energy.min())[:-1])
    assert right.get_legend() is None
    assert os.listdir(tmp_path) == ["e.png"]


def test_energy_of_several_runs(results):
    figure = gr.plot.energy(results)
    assert [text.get_text() for text in figure.axes[1].get_legend().get_texts()] == ["plain", "damped"]
    least = min(run.energy.min() for run in results.values())
    np.testing.assert_allclose(figure.axes[1].lines[1].get_ydata(), results["damped"].energy - least)
    figure = gr.plot.energy(results, minimum=least - 1)
    np.testing.assert_allclose(figure.axes[1].lines[0].get_ydata(), results["plain"].energy - least + 1)


def test_energy_without_a_fall(results):
    """Nothing above the minimum: no log scale."""
    run = replace(results["plain"], energy=np.ones(3), checks=np.arange(3))
    assert len(gr.plot.energy(run).axes) == 1


# sentences

IMAGE = np.zeros((6, 7))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: gr.plot.compare(IMAGE, IMAGE[1:]), r"denoised must have the shape of noisy"),
        (lambda: gr.plot.compare(IMAGE, IMAGE, reference=IMAGE.T), r"reference must have the shape"),
        (lambda: gr.plot.compare(np.zeros(5), np.zeros(5)), r"two axes or a volume of three.*\(5,\)"),
        (lambda: gr.plot.compare(np.zeros((0, 5)), np.zeros((0, 5))), r"got shape \(0, 5\)"),
        (lambda: gr.plot.compare(IMAGE, IMAGE, channel_axis=2), r"channel_axis must lie in -2\.\.1, got 2"),
        (lambda: gr.plot.compare(IMAGE, IMAGE, data_range=0), r"data_range must be a number > 0.*got 0"),
        (lambda: gr.plot.compare(IMAGE, IMAGE, data_range=(3, 2)), r"white > black.*\(3, 2\)"),
        (lambda: gr.plot.compare(IMAGE, IMAGE, data_range=(1, 2, 3)), r"data_range must be"),
        (lambda: gr.plot.compare(IMAGE, IMAGE, spacing=(1, 0)), r"spacing must hold 2 finite numbers > 0"),
        (lambda: gr.plot.compare(IMAGE, IMAGE, path="picture.xyz"), r"picture.xyz: the extension must be.*\.png"),
        (lambda: gr.plot.compare(IMAGE, IMAGE, path="picture"), r"the extension must be"),
        (lambda: gr.plot.quality(IMAGE, IMAGE[1:]), r"one shape, got \(6, 7\) and \(5, 7\)"),
        (
            lambda: gr.plot.neighbours(IMAGE, (6, 0), radius=1),
            r"pixel must lie in the image of shape \(6, 7\).*\(6, 0\)",
        ),
        (lambda: gr.plot.neighbours(IMAGE, (-1, 0), radius=1), r"counted from 0"),
        (lambda: gr.plot.neighbours(IMAGE, (1, 2, 3), radius=1), r"pixel must lie in the image"),
        (lambda: gr.plot.neighbours(IMAGE, (1, 2)), r"give the radius of the window, or a graph"),
        (lambda: gr.plot.neighbours(IMAGE, (1, 2), radius=1, graph=gr.GridGraph((6, 7))), r"give one of them"),
        (lambda: gr.plot.neighbours(IMAGE, (1, 2), graph=gr.GridGraph((7, 6))), r"a vertex per pixel of \(6, 7\)"),
        (lambda: gr.plot.neighbours(IMAGE, (1, 2), graph=gr.Graph.from_edges([[0, 1]])), r"a vertex per pixel"),
        (
            lambda: gr.plot.neighbours(IMAGE, (1, 2), graph=gr.Graph.from_edges([[0, 1]], n_vertices=42)),
            r"pixel \(1, 2\) has no neighbours in",
        ),
        (
            lambda: gr.plot.neighbours(IMAGE, (1, 2), radius=1, mask=np.zeros((6, 7), bool)),
            r"pixel \(1, 2\) lies outside the mask",
        ),
        (lambda: gr.plot.energy({}), r"the mapping is empty"),
    ],
)
def test_wrong_values(call, words):
    with pytest.raises(ValueError, match=words):
        call()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: gr.plot.compare(IMAGE * 1j, IMAGE), r"noisy must hold real numbers, got complex128"),
        (lambda: gr.plot.neighbours(IMAGE, (1.5, 2), radius=1), r"pixel must hold 2 integers, got \(1.5, 2\)"),
        (lambda: gr.plot.neighbours(IMAGE, 3, radius=1), r"pixel must hold 2 integers, got 3"),
        (lambda: gr.plot.energy(IMAGE), r"the result must be a gpureg.Result, got ndarray"),
        (lambda: gr.plot.energy({"a": 1}), r"the result 'a' must be a gpureg.Result, got int"),
    ],
)
def test_wrong_types(call, words):
    with pytest.raises(TypeError, match=words):
        call()


def test_a_result_without_energies(results):
    bare = replace(results["plain"], energy=np.empty(0), checks=np.empty(0, np.int64))
    with pytest.raises(ValueError, match=r"the result holds no energies: runs in tiles"):
        gr.plot.energy(bare)
    with pytest.raises(ValueError, match=r"the result 'bare' holds no energies"):
        gr.plot.energy({**results, "bare": bare})


def test_a_file_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    with pytest.raises(OSError, match="cannot be written"):
        gr.plot.compare(IMAGE, IMAGE, path=tmp_path / "nowhere" / "a.png")
    (tmp_path / "a.png").mkdir()
    with pytest.raises(OSError, match="cannot be written"):
        gr.plot.compare(IMAGE, IMAGE, path=tmp_path / "a.png")
    assert os.listdir(tmp_path) == ["a.png"]


@pytest.mark.parametrize(
    ("missing", "call"),
    [
        ("matplotlib", "gr.plot.compare([[1, 2]], [[1, 2]])"),
        ("skimage", "gr.plot.compare([[1, 2]], [[1, 2]], reference=[[1, 2]])"),
        ("skimage", "gr.plot.quality([[1, 2]], [[1, 2]])"),
    ],
)
def test_without_its_libraries(missing, call):
    code = f"import sys; sys.modules[{missing!r}] = None; import gpureg as gr\n{call}"
    got = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert got.returncode == 1
    assert got.stderr.splitlines()[-1].endswith("pip install 'gpureg[plot]'")
