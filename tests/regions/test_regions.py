"""The door to simplification: simplify_image, and Regions."""

from __future__ import annotations

import itertools

import cases
import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import csgraph

import gpureg as gr
from gpureg.regions.simplify import ENOUGH, SMOOTHING

HOST = {"backend": "numpy", "dtype": np.float64}


def picture(shape=(24, 31), seed=3, channels=None):
    """Smooth patches with noise: an 8-bit image with regions of all sizes."""
    random = cases.rng(seed)
    rough = ndimage.gaussian_filter(random.normal(0, 1, (*shape, channels or 1)), (2,) * len(shape) + (0,))
    values = 128 + 90 * rough / np.abs(rough).max() + random.normal(0, 2, rough.shape)
    image = np.clip(np.rint(values), 0, 255).astype(np.uint8)
    return image if channels else image[..., 0]


def pieces(labels, connectivity=1):
    """Connected pieces of equal label, all in all."""
    structure = ndimage.generate_binary_structure(labels.ndim, connectivity)
    found = ndimage.find_objects(labels + 1)
    return sum(ndimage.label(labels[cut] == i, structure)[1] for i, cut in enumerate(found))


@pytest.mark.parametrize("metric", ["cityblock", "chebyshev"])
@pytest.mark.parametrize(("shape", "channels"), [((24, 31), None), ((24, 31), 3), ((7, 9, 11), None), ((7, 9, 11), 2)])
def test_every_pixel_is_in_one_connected_zone(device, metric, shape, channels):
    image = picture(shape, channels=channels)
    axis = None if channels is None else -1
    found = gr.simplify_image(image, metric=metric, channel_axis=axis, backend=device)
    assert found.labels.shape == shape
    assert np.array_equal(np.unique(found.labels), np.arange(found.n_regions))
    assert pieces(found.labels, 1 if metric == "cityblock" else len(shape)) == found.n_regions
    assert found.fine.shape == found.value.shape == image.shape
    assert found.fine.dtype == found.value.dtype == image.dtype
    assert found.percent == pytest.approx(100 * found.n_regions / np.prod(shape))
    cells = image.reshape(-1, channels or 1).astype(float)
    flat = found.labels.ravel()
    means = np.stack([cells[flat == i].mean(axis=0) for i in range(found.n_regions)])
    assert found.models == pytest.approx(means, abs=1e-10)
    assert np.abs(found.fine.reshape(-1, channels or 1) - means[flat]).max() <= 0.5 + 1e-9
    assert sum(found.seconds.values()) > 0
    assert set(found.seconds) == {"sources", "partition", "graph", "models", "regularization"}


def test_the_links_one_by_one_are_the_chain():
    """What simplify_image does, by the functions that it is made of."""
    image = picture()
    grid = gr.GridGraph(image.shape, 1, "cityblock")
    seeds = gr.sources.extrema(image, grid)
    labels, graph = gr.energy_partition(image, grid, seeds), None
    graph = gr.region_graph(labels)
    models = gr.region_values(image, labels)
    h = 2 * np.median(graph.distances(models))
    expected = gr.regularize(models, graph, lam=0.05, weights=gr.weights.patch(0, h), max_iter=30, **HOST)
    found = gr.simplify_image(image, smooth=0, **HOST)
    assert np.array_equal(found.labels, labels)
    assert np.array_equal(found.values[:, 0], expected.value)
    assert np.array_equal(found.value, np.rint(expected.value)[labels].astype(np.uint8))
    assert found.result.iterations == 30


def test_smoothing_is_the_least_that_leaves_few_regions():
    image = picture((64, 64)) + cases.rng(9).normal(0, 15, (64, 64))
    grid = gr.GridGraph(image.shape, 1, "cityblock")
    raw = gr.sources.extrema(image, grid).max() + 1
    found = gr.simplify_image(image)
    assert raw > ENOUGH * image.size
    assert found.smooth > 0
    assert found.n_regions <= ENOUGH * image.size
    before = SMOOTHING[SMOOTHING.index(found.smooth) - 1]
    assert gr.simplify_image(image, smooth=before).n_regions > ENOUGH * image.size
    # the models are of the image itself
    assert found.models[:, 0] == pytest.approx(ndimage.mean(image, found.labels, np.arange(found.n_regions)))
    assert gr.simplify_image(np.tile(np.uint8([3, 200]), (8, 4)), smooth=0).smooth == 0


@pytest.mark.parametrize("smooth", [None, 0, 1.3])
def test_a_constant_image_is_one_region(smooth):
    image = np.full((9, 12), 0.1, np.float32)
    found = gr.simplify_image(image, smooth=smooth)
    assert found.n_regions == 1
    # a mean, and a quotient that is 2 roundings off, 30 times
    assert np.abs(found.value - image).max() <= 0.1 * 62 * 2.0**-24
    assert np.array_equal(found.fine, image)
    pixel = gr.simplify_image([[7]])
    assert pixel.n_regions == 1
    assert pixel.value.tolist() == [[7]]


def test_flat_parts_stay_flat_through_the_gaussian():
    """Rounding errors of the smoothed copy make no extrema: a step between two constants has two."""
    image = np.where(np.arange(40) < 20, 0.1, 0.7) * np.ones((12, 1))
    assert gr.simplify_image(image, smooth=1.5).n_regions == 2


def test_sources():
    image = picture()
    by_seeds = gr.simplify_image(image, sources=6)
    assert by_seeds.n_regions == 4 * 5
    assert by_seeds.smooth == 0
    markers = np.full(image.shape, -1)
    markers[3, 4], markers[20, 25] = 1, 0
    two = gr.simplify_image(image, sources=markers)
    assert two.n_regions == 2
    assert two.labels[3, 4] == 1
    assert two.labels[20, 25] == 0
    valleys = gr.simplify_image(image, sources="gradient", smooth=0)
    assert valleys.n_regions == gr.sources.gradient_minima(image, gr.GridGraph(image.shape, 1, "cityblock")).max() + 1
    round_ones = gr.simplify_image(image, sources=6, compactness=200)
    # a Voronoi diagram of the seeds by steps: cut off from what the picture says
    assert round_ones.graph.borders.sum() < by_seeds.graph.borders.sum()


@pytest.mark.parametrize("model", ["mean", "median", "source"])
def test_models(model):
    image = picture()
    found = gr.simplify_image(image, model=model, smooth=0, max_iter=0)
    assert np.array_equal(found.values, found.models)
    if model == "source":
        seeds = gr.sources.extrema(image, gr.GridGraph(image.shape, 1, "cityblock"))
        assert (found.fine[seeds >= 0] == image[seeds >= 0]).all()
    else:
        expected = getattr(ndimage, model)(image, found.labels, np.arange(found.n_regions))
        assert found.models[:, 0] == pytest.approx(expected)


def test_a_mask_leaves_pixels_out():
    image = picture().astype(np.float32)
    mask = np.ones(image.shape, bool)
    mask[5:12, 8:20] = False
    image[~mask] = np.nan
    found = gr.simplify_image(image, mask=mask)
    assert np.array_equal(found.labels >= 0, mask)
    assert np.isnan(found.value[~mask]).all()
    assert np.isfinite(found.value[mask]).all()
    assert np.isnan(found.fine[~mask]).all()
    assert (found.random_colours()[~mask] == 0).all()
    assert found.percent == pytest.approx(100 * found.n_regions / mask.sum())


@pytest.mark.parametrize("p", [1.0, 2.0, 1.5])
def test_borders_and_sizes_make_the_energy_of_the_painted_image(p):
    """With them the energy on the regions is that of the pixels, up to what is lost inside the zones."""
    image = picture().astype(float)
    fine = gr.simplify_image(image, max_iter=0, smooth=0)
    graph, grid = fine.graph, gr.GridGraph(image.shape, 1, "cityblock")
    lam, eps = 0.7, 0.0
    mean = graph.sizes.mean()
    painted, summed = [], []
    for seed in (1, 2):
        values = fine.models[:, 0] + cases.rng(seed).normal(0, 5, fine.n_regions)
        settings = {"p": p, "eps": eps, "norm": "edge"}
        on_regions = gr.operators.energy(
            values,
            fine.models[:, 0],
            graph,
            lam=lam * graph.sizes / mean,
            weights=graph.borders ** (2 / p),
            **settings,
            **HOST,
        )
        on_pixels = gr.operators.energy(values[fine.labels], image, grid, lam=lam / mean, **settings, **HOST)
        summed.append(on_regions + lam / mean / 2 * ((image - fine.fine) ** 2).sum())
        painted.append(on_pixels)
    # sums of 700 terms in float64, of powers that are a few roundings off
    assert summed == pytest.approx(painted, rel=1e-12)


@pytest.mark.parametrize("weights", ["similarity", "constant", "border", gr.weights.bilateral(4.0, 20.0)])
def test_weights(weights):
    image = picture()
    found = gr.simplify_image(image, weights=weights, lam=0.1, max_iter=200)
    roughness = found.graph.distances(found.values).mean()
    assert roughness < 0.9 * found.graph.distances(found.models).mean()
    assert not np.array_equal(found.value, found.fine)


def test_size_weighs_fidelity():
    """A large region holds on to its value, a small one follows it."""
    image = np.full((12, 12), 100.0)
    image[5:7, 5:7] = 200
    settings = {"weights": "constant", "lam": 1.0, "max_iter": 2000, "smooth": 0, **HOST}
    alike, by_size = (gr.simplify_image(image, by_size=given, **settings) for given in (False, True))
    assert alike.values.mean() == pytest.approx(150)
    assert by_size.graph.sizes @ by_size.values[:, 0] == pytest.approx(image.sum())
    assert abs(by_size.values[0, 0] - 100) < abs(alike.values[0, 0] - 100)


def test_rings():
    image = picture()
    one, two = gr.simplify_image(image), gr.simplify_image(image, rings=2)
    assert np.array_equal(one.labels, two.labels)
    assert two.graph.n_edges > 2 * one.graph.n_edges


def test_merged_regions_are_unions_of_neighbours_whose_values_met():
    image = picture((40, 40))
    found = gr.simplify_image(image, p=0.5, lam=0.05, weights="constant", max_iter=200)
    tol = 1.5
    coarse = found.merged(tol)
    assert 1 <= coarse.n_regions < found.n_regions
    assert pieces(coarse.labels) == coarse.n_regions
    # each old region lies in one new one; those that met, and no others, are together
    parent = np.full(found.n_regions, -1)
    parent[found.labels.ravel()] = coarse.labels.ravel()
    assert np.array_equal(parent[found.labels], coarse.labels)
    met = found.graph.distances(found.values) <= tol
    rows, columns = found.graph.edge_rows()[met], found.graph.indices[met]
    assert (parent[rows] == parent[columns]).all()
    links = np.zeros((found.n_regions,) * 2, bool)
    links[rows, columns] = True
    assert csgraph.connected_components(links, directed=False)[0] == coarse.n_regions
    # in the order of their first regions
    assert (np.diff(np.unique(parent, return_index=True)[1]) > 0).all()
    assert coarse.models[:, 0] == pytest.approx(ndimage.mean(image, coarse.labels, np.arange(coarse.n_regions)))
    total = found.graph.sizes @ found.values[:, 0]
    assert coarse.graph.sizes @ coarse.values[:, 0] == pytest.approx(total)
    assert np.array_equal(
        gr.simplify_image(image, p=0.5, lam=0.05, weights="constant", max_iter=200, merge_tol=tol).labels, coarse.labels
    )
    assert found.merged(1e9).n_regions == 1


@pytest.mark.parametrize("model", ["median", "source"])
def test_merging_keeps_medians_and_sources(model):
    image = picture()
    found = gr.simplify_image(image, model=model, smooth=0)
    coarse = found.merged(20.0)
    assert coarse.n_regions < found.n_regions
    if model == "median":
        expected = ndimage.median(image, coarse.labels, np.arange(coarse.n_regions))
    else:
        seeds = gr.sources.extrema(image, gr.GridGraph(image.shape, 1, "cityblock"))
        inside = np.where(seeds >= 0, coarse.labels, -1)
        expected = ndimage.mean(image, inside, np.arange(coarse.n_regions))
    assert coarse.models[:, 0] == pytest.approx(expected)


def test_a_hierarchy_is_nested():
    image = picture((40, 40))
    fine = gr.simplify_image(image, max_iter=0)
    levels = fine.hierarchy(lam=[2.0, 0.5, 0.1], merge_tol=1.0, p=0.7, weights="constant", by_size=True, max_iter=100)
    counts = [fine.n_regions, *(level.n_regions for level in levels)]
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] < counts[0]
    flat = [level.labels.ravel() for level in (fine, *levels)]
    pairs = [np.unique(np.stack([before, after]), axis=1) for before, after in itertools.pairwise(flat)]
    assert [found.shape[1] for found in pairs] == counts[:-1]
    with pytest.raises(ValueError, match=r"lam must decrease from one value to the next, got \[1.0, 1.0\]"):
        fine.hierarchy(lam=[1, 1], merge_tol=1)


def test_spacing_goes_into_sizes_and_borders():
    volume = picture((5, 9, 11))
    plain, thick = gr.simplify_image(volume), gr.simplify_image(volume, spacing=(3.0, 1.0, 0.5))
    assert np.array_equal(plain.labels, thick.labels)
    assert thick.graph.sizes == pytest.approx(1.5 * plain.graph.sizes)
    assert thick.graph.positions == pytest.approx(plain.graph.positions * [3, 1, 0.5])
    assert not np.array_equal(plain.graph.borders, thick.graph.borders)


def test_painting_rounds_and_clips_like_a_door():
    found = gr.simplify_image(picture(), max_iter=0)
    assert found.paint(np.linspace(-50, 400, found.n_regions)).dtype == np.uint8
    assert found.paint(np.full(found.n_regions, 300.0)).min() == 255
    assert found.paint(np.full(found.n_regions, 2.6)).max() == 3
    with pytest.raises(ValueError, match="values must have shape"):
        found.paint([1.0])


def test_channels_first():
    image = picture(channels=3)
    last = gr.simplify_image(image, channel_axis=-1, **HOST)
    first = gr.simplify_image(np.moveaxis(image, -1, 0), channel_axis=0, **HOST)
    assert np.array_equal(np.moveaxis(first.value, 0, -1), last.value)


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.float64, np.float16])
def test_types(dtype):
    image = picture().astype(dtype)
    found = gr.simplify_image(image)
    assert found.value.dtype == dtype
    assert np.array_equal(found.labels, gr.simplify_image(picture()).labels)


def test_an_interrupted_run_holds_an_image():
    def stop(check):
        raise KeyboardInterrupt

    image = picture()
    with pytest.raises(gr.Interrupted) as raised:
        gr.simplify_image(image, callback=stop)
    assert raised.value.result.value.shape == image.shape
    assert raised.value.result.value.dtype == image.dtype


def test_colours_and_picture(tmp_path):
    found = gr.simplify_image(picture())
    colours = found.random_colours()
    assert colours.dtype == np.uint8
    assert colours.shape == (24, 31, 3)
    assert np.array_equal(colours, found.random_colours(0))
    assert not np.array_equal(colours, found.random_colours(1))
    some = range(0, found.n_regions, 7)
    assert [i for i in some if len(np.unique(colours[found.labels == i], axis=0)) != 1] == []
    pytest.importorskip("matplotlib")
    figure = found.plot(path=tmp_path / "out.png")
    assert [axes.get_title() for axes in figure.axes] == ["image", "partition", "fine", "regularized"]
    assert (tmp_path / "out.png").stat().st_size > 0
    volume = gr.simplify_image(picture((5, 9, 11)), spacing=(2, 1, 1)).plot()
    assert len(volume.axes) == 12
    with pytest.raises(ValueError, match="partition must have the image's shape"):
        gr.plot.simplification(picture(), np.zeros((3, 3, 3)), picture(), picture())


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"sources": "saddles"}, "sources must be one of extrema, gradient, an integer or an array, got 'saddles'"),
        ({"sources": 0}, "step must be >= 1, got 0"),
        ({"sources": np.full((24, 31), -1)}, "a label >= 0 at one vertex"),
        ({"sources": np.zeros((3, 3), int)}, "sources must have shape"),
        ({"smooth": -1}, "smooth must be finite and >= 0, got -1"),
        ({"smooth": np.inf}, "smooth must be finite and >= 0, got inf"),
        ({"model": "mode"}, 'model must be "mean", "median" or "source", got '),
        ({"metric": "hamming"}, 'metric must be "cityblock" or "chebyshev"'),
        ({"metric": "euclidean"}, 'metric must be "cityblock" or "chebyshev", got '),
        ({"weights": "cotan"}, "weights must be one of similarity, constant, border"),
        ({"weights": "border", "h": 2.0}, "h belongs to weights='similarity'"),
        ({"weights": gr.weights.constant(), "h": 2.0}, "h belongs to weights='similarity'"),
        ({"weights": "border", "p": 0.01}, "take a larger p"),
        ({"h": 0.0}, "h must be"),
        ({"merge_tol": -1.0}, "merge_tol must be >= 0, got -1"),
        ({"spacing": (1.0,)}, "spacing must hold 2 numbers|spacing must hold 2 finite"),
        ({"mask": np.zeros((24, 31), bool)}, "the mask leaves no pixel"),
        ({"mask": np.zeros((3, 31), bool)}, "mask must be boolean"),
        ({"rings": 0}, "rings must be >= 1, got 0"),
        ({"compactness": -1}, "compactness must be"),
        ({"p": 0}, "p must be"),
        ({"p": 0, "weights": "border"}, "p must be finite and > 0, got 0"),
        ({"p": None, "weights": "border"}, "p must be a number"),
        ({"sources": True}, "sources must be integers, a label for each source"),
        ({"lam": -1}, "lam must be"),
        ({"channel_axis": 5}, "channel_axis must lie in"),
    ],
)
def test_wrong_calls(settings, sentence):
    with pytest.raises((ValueError, TypeError), match=sentence):
        gr.simplify_image(picture(), **settings)


def test_labels_of_another_program_are_numbered_in_their_order():
    """They may begin at 1, have gaps and lie outside the mask, as those of superpixels do."""
    rows, columns = np.indices((24, 31))
    blocks = rows // 6 * 4 + columns // 8
    want = gr.simplify_image(picture(), sources=blocks, backend="numpy")
    for labels in (blocks + 1, (blocks * 7 + 3).astype(np.uint8), blocks.astype(np.int64) * 10**12):
        found = gr.simplify_image(picture(), sources=labels, backend="numpy")
        np.testing.assert_array_equal(found.labels, blocks)
        np.testing.assert_array_equal(found.value, want.value)
    mask = columns < 16
    inside = gr.simplify_image(picture(), sources=blocks + 1, mask=mask, backend="numpy")
    np.testing.assert_array_equal(inside.labels, np.where(mask, rows // 6 * 2 + columns // 8, -1))
    markers = np.zeros((24, 31), int)
    markers[3, 3], markers[20, 20] = 1, 2
    with pytest.warns(UserWarning, match="0 is a label like any other, -1 means no source"):
        gr.simplify_image(picture(), sources=markers, backend="numpy")


def test_wrong_images_and_markers():
    with pytest.raises(ValueError, match="image must be finite"):
        gr.simplify_image(np.array([[0.0, np.nan], [1.0, 2.0]]))
    with pytest.raises(ValueError, match="two or more axes"):
        gr.simplify_image(np.zeros(4))
    mask = np.ones((24, 31), bool)
    mask[:, 15] = False
    with pytest.raises(ValueError, match="reach only a part of the mask"):
        gr.simplify_image(picture(), sources=np.where(np.arange(31) == 3, 0, -1) * np.ones((24, 1), int), mask=mask)
