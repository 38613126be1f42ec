"""Weight functions on both kinds of graph, against the formulas of section 5.2."""

from __future__ import annotations

import numpy as np
import pytest
from cases import function, graph, rng

import gpureg as gr
from gpureg import backends
from gpureg.weights import Weights

ORACLE = backends.get("numpy", np.float64)


def on_edges(weights: Weights, made: gr.Graph | gr.GridGraph, f0: np.ndarray) -> np.ndarray:
    """Weights as one per directed edge, in the order of the CSR form."""
    values = ORACLE.get_weights(weights.prepare(ORACLE, made, f0))
    if values is None:
        return np.ones(made.n_edges)
    return made.edges.gather_half(values) if isinstance(made, gr.GridGraph) else values


def ends(made: gr.Graph | gr.GridGraph) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both ends of each directed edge, and the positions of all vertices."""
    stored = made.to_graph() if isinstance(made, gr.GridGraph) else made
    return stored.edge_rows(), stored.indices, stored.positions


FORMULAS = {
    # of features x, and of squared distances between ends of edges: in space, of values, of features
    "constant": lambda x, space, value, far: (gr.weights.constant(), np.ones(len(space))),
    "bilateral": lambda x, space, value, far: (
        gr.weights.bilateral(1.5, 0.3),
        np.exp(-space / 1.5**2) * np.exp(-value / 0.3**2),
    ),
    "bilateral, values": lambda x, space, value, far: (gr.weights.bilateral(np.inf, 0.3), np.exp(-value / 0.3**2)),
    "bilateral, space": lambda x, space, value, far: (gr.weights.bilateral(1.5, np.inf), np.exp(-space / 1.5**2)),
    "patch": lambda x, space, value, far: (gr.weights.patch(0, 0.4), np.exp(-value / 0.4**2)),
    # 2 sigma^2 comes off per sample and channel, and nothing goes below 0
    "patch of noise": lambda x, space, value, far: (
        gr.weights.patch(0, 0.4, sigma=0.1),
        np.exp(-np.maximum(value - 2 * 0.1**2 * 2, 0) / 0.4**2),
    ),
    "1/d^2": lambda x, space, value, far: (gr.weights.inverse_distance(), 1 / space),
    "1/d": lambda x, space, value, far: (gr.weights.inverse_distance(1), space**-0.5),
    "gaussian": lambda x, space, value, far: (gr.weights.gaussian(x, 0.5), np.exp(-far / 0.25)),
    "guided": lambda x, space, value, far: (
        gr.weights.guided(gr.weights.patch(0, 0.4), x),
        np.exp(-far / 0.4**2),
    ),
}


@pytest.mark.parametrize("kind", FORMULAS)
@pytest.mark.parametrize("name", ["small grid", "small disk", "small masked", "small csr", "small row"])
def test_formulas(name: str, kind: str) -> None:
    made, f0 = graph(name), function(graph(name), 2)
    u, v, places = ends(made)
    features = rng(9).random((made.n_vertices, 4))
    distances = [((values[u] - values[v]) ** 2).sum(axis=1) for values in (places, f0, features)]
    weights, expected = FORMULAS[kind](features, *distances)
    assert np.abs(on_edges(weights, made, f0) - expected).max() < 1e-14 * max(1, expected.max())


@pytest.mark.parametrize("a", [None, 0.8])
def test_patches_on_a_grid_and_on_its_csr_twin(a: float | None) -> None:
    grid = graph("disk")
    f0 = function(grid, 3)
    weights = gr.weights.patch(2, 1.5 if a is None else 0.4, sigma=0.05, patch_sigma=a)
    assert np.abs(on_edges(weights, grid, f0) - on_edges(weights, grid.to_graph(), f0)).max() < 1e-14


def test_gaussian_patch_sums_to_one() -> None:
    """A constant difference c gives rho = c^2, whatever the patch's size."""
    grid = gr.GridGraph((9, 16), 8, "chebyshev")
    f0 = np.repeat([[0.0, 0.5]], 8, axis=1) * np.ones((9, 1))
    half = ORACLE.get_weights(gr.weights.patch(2, 1.0, patch_sigma=1.0).prepare(ORACLE, grid, f0.reshape(-1, 1)))
    # from column 2 to column 10: both patches lie inside their own side
    k = next(i for i, step in enumerate(grid.forward_offsets.tolist()) if step == [0, 8])
    assert half[k][4, 2] == pytest.approx(np.exp(-0.25), rel=1e-14)


def test_arrays_of_weights_reach_the_process(device: str) -> None:
    grid = graph("grid")
    f0 = function(grid)
    half = rng(13).random((grid.half_window, *grid.shape)) * grid.edges.unit_half()
    flat = grid.edges.gather_half(half)
    as_csr = gr.regularize(f0, grid.to_graph(half), p=1, lam=2, max_iter=5, backend=device)
    given = gr.regularize(f0, grid, weights=flat, p=1, lam=2, max_iter=5, backend=device)
    # The two kinds of graph add the same numbers in the same order, but may contract products differently.
    assert np.abs(as_csr.value - given.value).max() < 1e-5
    plain = gr.regularize(f0, grid, p=1, lam=2, max_iter=5, backend=device)
    assert np.abs(plain.value - given.value).max() > 1e-3


def test_constant_takes_the_place_of_a_graphs_own_weights() -> None:
    made = graph("small csr")
    assert (on_edges(gr.weights.constant(), made, function(made)) == 1).all()


@pytest.mark.parametrize(
    ("make", "error", "says"),
    [
        (lambda: gr.weights.bilateral(0, 1), ValueError, "sigma_space must be > 0, got 0"),
        (lambda: gr.weights.bilateral(1, -1), ValueError, "sigma_value must be > 0, got -1"),
        (lambda: gr.weights.bilateral("1", 1), TypeError, "sigma_space must be a number"),
        (lambda: gr.weights.patch(-1, 1), ValueError, "radius must be >= 0, got -1"),
        (lambda: gr.weights.patch(1.5, 1), TypeError, "radius must be an integer"),
        (lambda: gr.weights.patch(1, 0), ValueError, "h must be finite and > 0"),
        (lambda: gr.weights.patch(1, np.nan), ValueError, "h must be finite and > 0"),
        (lambda: gr.weights.patch(1, 1, sigma=-1), ValueError, "sigma must be finite and >= 0"),
        (lambda: gr.weights.patch(1, 1, patch_sigma=0), ValueError, "patch_sigma must be finite and > 0, got 0"),
        (lambda: gr.weights.inverse_distance(0), ValueError, "power must be finite and > 0"),
        (lambda: gr.weights.gaussian([[np.nan]], 1), ValueError, "features must be finite"),
        (lambda: gr.weights.guided("patch", [1.0]), TypeError, "weights must be an object"),
        (lambda: gr.weights.guided(gr.weights.constant(), [np.inf]), ValueError, "guide must be finite"),
    ],
)
def test_wrong_parameters(make, error: type, says: str) -> None:
    with pytest.raises(error, match=says):
        make()


BARE = gr.Graph([0, 1, 2], [1, 0])
TOGETHER = gr.Graph([0, 1, 2], [1, 0], positions=np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("weights", "made", "says"),
    [
        (gr.weights.bilateral(1, 1), BARE, "positions"),
        (gr.weights.inverse_distance(), BARE, "positions"),
        (gr.weights.inverse_distance(), TOGETHER, "same point"),
        (gr.weights.patch(1, 1), BARE, "on a grid"),
        (gr.weights.gaussian([1.0], 1), BARE, "2 rows"),
        (gr.weights.guided(gr.weights.patch(0, 1), [1.0]), BARE, "2 rows"),
    ],
)
def test_weights_that_do_not_fit_the_graph(weights: Weights, made: gr.Graph, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        gr.regularize(np.zeros(2), made, weights=weights, backend="numpy")


def guided_pixels(q: tuple[int, ...]) -> tuple[gr.GridGraph, np.ndarray]:
    """A grid, and a guide in its shape with further axes `q`."""
    return gr.GridGraph((12, 9), 2), rng(2).random((12, 9, *q))


any_guide = pytest.mark.parametrize("q", [(), (3,)])


@any_guide
@pytest.mark.parametrize("stored", [False, True])
def test_a_guide_in_the_shape_of_the_grid(device, q, stored):
    """The same as rows, on the grid and on its stored twin."""
    grid, guide = guided_pixels(q)
    f0 = rng(1).random((12, 9))
    made, data = (grid.to_graph(), f0.ravel()) if stored else (grid, f0)
    shaped, rows = (
        gr.regularize(data, made, weights=gr.weights.guided(gr.weights.patch(1, 0.5), g), max_iter=2, backend=device)
        for g in (guide, guide.reshape(108, -1))
    )
    assert np.array_equal(shaped.value, rows.value)


@any_guide
def test_a_guide_needs_the_same_memory_in_either_shape(device, q):
    grid, guide = guided_pixels(q)
    rows, shaped = (
        gr.memory_needed(grid, weights=gr.weights.guided(gr.weights.patch(1, 0.5), g), backend=device)
        for g in (guide.reshape(108, -1), guide)
    )
    assert rows == shaped


@any_guide
@pytest.mark.parametrize("part", [np.s_[1:], np.s_[:, 1:]], ids=["fewer rows", "fewer columns"])
def test_a_guide_in_another_shape_is_refused(q, part):
    grid, guide = guided_pixels(q)
    weights = gr.weights.guided(gr.weights.patch(1, 0.5), guide[part])
    with pytest.raises(ValueError, match=r"108 rows, one per vertex, or the grid's shape \(12, 9\)"):
        gr.regularize(rng(1).random((12, 9)), grid, weights=weights, backend="numpy")


def test_points_that_all_but_coincide(device):
    """1/d^2 beyond the type gets a sentence; float64 holds it."""
    points = np.random.default_rng(8).random((30, 2))
    points[:2] = [[0, 0], [1e-22, 0]]
    graph = gr.knn_graph(points, 4)
    weights = gr.weights.inverse_distance(2)
    with pytest.raises(ValueError, match=r"largest weight, 1e\+44, is beyond float32: join vertices"):
        gr.regularize(points, graph, weights=weights, dtype=np.float32, backend=device)
    result = gr.regularize(points, graph, weights=weights, dtype=np.float64, backend=device)
    assert np.isfinite(result.value).all()
