"""Pictures of weights and of energies, and what wrong arguments get."""

from __future__ import annotations

import os
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
from drawn import picture
from matplotlib.collections import PolyCollection


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
    found = [weights_in(axes) for axes in figure.axes[2::3]]
    expected = [
        {(v[x], v[y]): paper.w1(pixel, v, [f0], 2, 0.3) for v in around if v[fixed] == pixel[fixed]}
        for fixed, y, x in ((0, 1, 2), (1, 0, 2), (2, 0, 1))
    ]
    assert found == [pytest.approx(plane, abs=2e-6) for plane in expected]  # float32
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
    found = weights_in(figure.axes[2])
    expected = {(x, y): 1 / ((y - 4) ** 2 + 0.49 * (x - 9) ** 2) for x, y in found}
    assert found == pytest.approx(expected, rel=1e-6)  # float32


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
        (lambda: gr.plot.neighbours(IMAGE, (1, 2), radius=1, graph=gr.GridGraph((6, 7))), r"give only one"),
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
    with pytest.raises(ValueError, match=r"the result has no energies: runs in tiles"):
        gr.plot.energy(bare)
    with pytest.raises(ValueError, match=r"the result 'bare' has no energies"):
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
