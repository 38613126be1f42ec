"""Graph and GridGraph: what they refuse, what they store, and the neighbourhoods they mean."""

from __future__ import annotations

import dataclasses
import itertools

import cases
import numpy as np
import paper
import pytest
from numpy.testing import assert_array_equal
from scipy import sparse

from gpureg.graphs.csr import Graph
from gpureg.graphs.grid import GridGraph

# Graph: every refusal, one line each

PATH = ([0, 1, 3, 4], [1, 0, 2, 1])  # 0 - 1 - 2

REFUSED_GRAPHS = [
    (TypeError, "indptr must hold integers, got float64", lambda: Graph([0.0, 1, 2], [1, 0])),
    (TypeError, "indices must hold integers, got float64", lambda: Graph([0, 1, 2], [1.0, 0])),
    (ValueError, r"indptr must have 1 dimension.*\(2, 2\)", lambda: Graph([[0, 1], [1, 2]], [1, 0])),
    (ValueError, r"indices must have 1 dimension.*\(2, 1\)", lambda: Graph([0, 1, 2], [[1], [0]])),
    (ValueError, "at least one vertex", lambda: Graph([0], [])),
    (ValueError, "at least one vertex", lambda: Graph([], [])),
    (ValueError, r"indptr must rise from 0 to len\(indices\) = 2", lambda: Graph([0, 1, 3], [1, 0])),
    (ValueError, "indptr must rise", lambda: Graph([1, 1, 2], [1, 0])),
    (ValueError, "indptr must rise", lambda: Graph([0, 3, 1, 4], PATH[1])),
    (ValueError, r"indices must lie in 0\.\.1, got 2", lambda: Graph([0, 1, 2], [2, 0])),
    (ValueError, r"indices must lie in 0\.\.1, got -1", lambda: Graph([0, 1, 2], [1, -1])),
    (ValueError, r"weights must have shape \(4,\).*got \(2,\)", lambda: Graph(*PATH, [1.0, 2.0])),
    (ValueError, "weights must be finite, got nan", lambda: Graph(*PATH, [1, np.nan, 1, 1])),
    (ValueError, "weights must be finite, got inf", lambda: Graph(*PATH, [1, np.inf, 1, 1])),
    (ValueError, r"weights must be >= 0, got -0\.5", lambda: Graph(*PATH, [-0.5, -0.5, 1, 1])),
    (TypeError, "weights must be real numbers, got complex", lambda: Graph(*PATH, [1j, 1j, 1, 1])),
    (ValueError, "self-loops are not allowed, vertex 1 has one", lambda: Graph([0, 1, 3], [1, 0, 1])),
    (ValueError, r"\(0, 1\) is repeated", lambda: Graph([0, 2, 4], [1, 1, 0, 0])),
    (ValueError, r"\(0, 1\) is stored but \(1, 0\) is not", lambda: Graph([0, 1, 1], [1])),
    (
        ValueError,
        r"both directions, edge \(0, 1\) has 1\.0 one way and 2\.0 the other",
        lambda: Graph(*PATH, [1.0, 2.0, 1.0, 1.0]),
    ),
    (
        ValueError,
        r"positions must be finite and of shape \(3, d\), got shape \(2, 2\)",
        lambda: Graph(*PATH, None, np.zeros((2, 2))),
    ),
    (ValueError, "positions must be finite", lambda: Graph(*PATH, None, np.full((3, 2), np.nan))),
    (ValueError, r"positions .* got shape \(3,\)", lambda: Graph(*PATH, None, np.zeros(3))),
    (ValueError, "the grid has 4 vertices, the graph 3", lambda: Graph(*PATH, None, None, GridGraph(4))),
    (ValueError, r"edges must have shape \(E, 2\) or \(2, E\), got \(1, 3\)", lambda: Graph.from_edges([[0, 1, 2]])),
    (ValueError, r"edges must have 2 dimension", lambda: Graph.from_edges([0, 1])),
    (TypeError, "edges must hold integers", lambda: Graph.from_edges([[0.0, 1.0]])),
    (ValueError, "without edges needs n_vertices", lambda: Graph.from_edges([])),
    (ValueError, "n_vertices must be >= 1, got 0", lambda: Graph.from_edges([], n_vertices=0)),
    (ValueError, r"edges must join vertices 0\.\.1, got 0\.\.2", lambda: Graph.from_edges([[0, 2]], n_vertices=2)),
    (ValueError, r"edges must join vertices 0\.\.2, got -1\.\.2", lambda: Graph.from_edges([[-1, 2]])),
    (ValueError, r"weights must have shape \(1,\).*per undirected edge", lambda: Graph.from_edges([[0, 1]], [1, 2])),
    (ValueError, "is repeated", lambda: Graph.from_edges([[0, 1], [1, 0]])),
    (ValueError, "vertex 2 has one", lambda: Graph.from_edges([[0, 1], [2, 2]])),
    (ValueError, "the matrix must be square", lambda: Graph.from_scipy(sparse.csr_array(np.ones((2, 3))))),
    (ValueError, "both directions", lambda: Graph.from_scipy(sparse.csr_array([[0, 1.0], [2.0, 0]]))),
    (ValueError, "self-loops", lambda: Graph.from_scipy(sparse.eye_array(3))),
]


@pytest.mark.parametrize(("error", "message", "make"), REFUSED_GRAPHS)
def test_graph_refuses(error, message, make):
    with pytest.raises(error, match=message):
        make()


def test_rows_are_sorted_and_weights_with_them():
    """A triangle with a tail, its rows out of order."""
    graph = Graph([0, 2, 4, 7, 8], [2, 1, 2, 0, 3, 1, 0, 2], [5.0, 1, 3, 1, 7, 3, 5, 7])
    assert graph.indices.tolist() == [1, 2, 0, 2, 0, 1, 3, 2]
    assert graph.weights.tolist() == [1, 5, 1, 3, 5, 3, 7, 7]
    assert graph.edge_rows().tolist() == [0, 0, 1, 1, 2, 2, 2, 3]
    assert graph.degree().tolist() == [6, 4, 15, 7]


def test_degree_without_weights_counts_neighbours():
    graph = Graph.from_edges([[0, 1], [1, 2], [1, 3]], n_vertices=5)
    assert graph.degree().tolist() == [1, 3, 1, 1, 0]
    assert (graph.n_vertices, graph.n_edges) == (5, 6)
    assert "unweighted" in repr(graph)
    assert "3 undirected edges" in repr(graph)


def test_edges_in_any_order_and_direction_make_the_same_graph():
    a = Graph.from_edges([[0, 1], [1, 2], [0, 3]], [1.0, 2.0, 3.0])
    b = Graph.from_edges([[3, 0], [2, 1], [0, 1]], [3.0, 2.0, 1.0], n_vertices=4)
    for name in ("indptr", "indices", "weights"):
        assert_array_equal(getattr(a, name), getattr(b, name))
    assert a.to_scipy().toarray().tolist() == [[0, 1, 0, 3], [1, 0, 2, 0], [0, 2, 0, 0], [3, 0, 0, 0]]


def test_to_edges_is_the_inverse_of_from_edges():
    W = np.triu(np.random.default_rng(4).random((9, 9)), 1)
    W[W < 0.6] = 0
    edges = np.argwhere(W)
    again, weights = Graph.from_edges(edges[::-1, ::-1], W[tuple(edges[::-1].T)], n_vertices=9).to_edges()
    assert np.array_equal(again, edges) and np.array_equal(weights, W[tuple(edges.T)])
    bare = GridGraph((3, 4), metric="cityblock").to_graph()
    edges, none = bare.to_edges()
    assert len(edges) == bare.n_edges // 2 == 17 and none is None
    alone, weights = Graph.from_edges(np.zeros((0, 2), int), n_vertices=2).to_edges()
    assert alone.shape == (0, 2) and weights is None


@pytest.mark.parametrize("edges", [None, [], np.empty((0, 2))], ids=["stored", "list", "array"])
def test_a_graph_may_have_no_edges(edges):
    graph = Graph([0, 0], []) if edges is None else Graph.from_edges(edges, n_vertices=1)
    assert (graph.n_vertices, graph.n_edges) == (1, 0)
    assert graph.degree().tolist() == [0]
    assert graph.to_scipy().shape == (1, 1)


@pytest.mark.parametrize("turn", [lambda A: A, sparse.coo_array, sparse.csc_array, sparse.csr_matrix, np.asarray])
def test_from_scipy(turn):
    graph = cases.irregular(23, 60, isolated=5)
    matrix = graph.to_scipy()
    given = matrix.toarray() if turn is np.asarray else turn(matrix)
    again = Graph.from_scipy(given, positions=graph.positions)
    assert_array_equal(again.to_scipy().toarray(), matrix.toarray())
    assert_array_equal(again.positions, graph.positions)


def test_to_scipy():
    graph = cases.irregular(23, 60, isolated=5)
    matrix = graph.to_scipy()
    assert_array_equal(matrix.toarray(), matrix.toarray().T)
    # weights of 0 stay edges in a sparse matrix
    assert (graph.weights == 0).any()
    assert Graph.from_scipy(matrix).n_edges == graph.n_edges
    # what comes out is a copy
    matrix.data[:] = -1
    assert graph.weights.min() >= 0


def test_integer_and_boolean_weights_become_numbers():
    adjacency = sparse.csr_array(np.array([[0, 1], [1, 0]], bool))
    assert Graph.from_scipy(adjacency).weights.dtype == np.float64
    assert Graph.from_edges([[0, 1]], [3]).weights.tolist() == [3, 3]
    assert Graph.from_edges([[0, 1]], np.array([3], np.float32)).weights.dtype == np.float32


def test_a_graph_is_frozen_and_copies_what_it_is_given():
    weights, positions = np.ones(4), np.zeros((3, 2))
    graph = Graph(np.array(PATH[0]), np.array(PATH[1]), weights, positions)
    weights[:], positions[:] = 9, 9
    assert graph.weights.tolist() == [1, 1, 1, 1]
    assert not graph.positions.any()
    for name in ("indptr", "indices", "weights", "positions"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(graph, name)[0] = 0
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(graph, name, None)


# GridGraph: every refusal

REFUSED_GRIDS = [
    (ValueError, "shape must hold one or more integers >= 1", lambda: GridGraph(())),
    (ValueError, "shape must hold one or more integers >= 1, got 0", lambda: GridGraph(0)),
    (ValueError, r"shape must hold .* got \(3, -1\)", lambda: GridGraph((3, -1))),
    (ValueError, r"shape must hold .* got \(2\.5, 3\)", lambda: GridGraph((2.5, 3))),
    (ValueError, 'metric must be "chebyshev", "euclidean" or "cityblock", got .l2', lambda: GridGraph(3, 1, "l2")),
    (ValueError, r"spacing must hold 2 finite numbers > 0, got \(1,\)", lambda: GridGraph((3, 3), spacing=(1,))),
    (ValueError, "spacing must hold 2 finite", lambda: GridGraph((3, 3), spacing=(1, 0))),
    (ValueError, "spacing must hold 2 finite", lambda: GridGraph((3, 3), spacing=(1, np.inf))),
    (ValueError, "radius must reach the nearest neighbour, got 0.5", lambda: GridGraph(3, 0.5)),
    (ValueError, "radius must be > 0, got nan", lambda: GridGraph(3, np.nan)),
    (ValueError, "radius must reach .* got 1", lambda: GridGraph((3, 3), 1, spacing=(2, 3))),
    (ValueError, r"mask must be boolean of shape \(3,\), got int64", lambda: GridGraph(3, mask=[1, 0, 1])),
    (ValueError, r"mask must be boolean of shape \(3,\).*\(2,\)", lambda: GridGraph(3, mask=[True, False])),
]


@pytest.mark.parametrize(("error", "message", "make"), REFUSED_GRIDS)
def test_grid_refuses(error, message, make):
    with pytest.raises(error, match=message):
        make()


def test_windows_of_the_three_metrics():
    """Radius 2 on a large plane: a square of 25, a disk and a diamond of 13, less the centre. Radius 1: G_1, G_0."""
    sizes = {metric: len(GridGraph((9, 9), 2, metric).offsets) for metric in ("chebyshev", "euclidean", "cityblock")}
    assert sizes == {"chebyshev": 24, "euclidean": 12, "cityblock": 12}
    assert len(GridGraph((9, 9), 1, "chebyshev").offsets) == 8
    assert GridGraph((9, 9), 1, "cityblock").offsets.tolist() == [[-1, 0], [0, -1], [0, 1], [1, 0]]
    # disk and diamond part at radius 3
    disk = {tuple(o) for o in GridGraph((9, 9), 3, "euclidean").offsets.tolist()}
    diamond = {tuple(o) for o in GridGraph((9, 9), 3, "cityblock").offsets.tolist()}
    assert disk - diamond == {(a, b) for a in (-2, 2) for b in (-2, 2)}


GRIDS = [
    ((11,), 3, "chebyshev", None),
    ((5, 6), 1, "chebyshev", None),
    ((5, 6), 2, "cityblock", None),
    ((6, 5), 2.3, "euclidean", None),
    ((4, 7), 1.5, "euclidean", (0.5, 1.5)),
    # 3 * 0.1 is not quite 0.3: the neighbour at the very distance belongs to the window
    ((9,), 0.3, "euclidean", (0.1,)),
    ((5, 4), 0.3, "cityblock", (0.1, 0.1)),
    ((3, 4, 3), 1.8, "euclidean", (1.0, 0.9, 2.0)),
    ((3, 3, 3), 2, "cityblock", None),
    ((2, 3, 2, 2), 1, "chebyshev", None),
    # a window wider than the grid
    ((2, 9), 4, "chebyshev", None),
    ((1, 1), 3, "chebyshev", None),
    ((1, 6), 2, "cityblock", None),
]


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize(("shape", "radius", "metric", "spacing"), GRIDS)
def test_neighbourhoods(shape, radius, metric, spacing, masked):
    """Against the definition of N_k(u), vertex by vertex."""
    mask = cases.rng(31).random(shape) < 0.7 if masked else None
    grid = GridGraph(shape, radius, metric, spacing=spacing, mask=mask)
    vertices = paper.pixels(shape)
    number = {u: i for i, u in enumerate(vertices)}
    inside = [u for u in vertices if mask is None or mask[u]]
    edges = sorted((number[u], number[v]) for u, v in paper.k_graph(inside, radius, metric, spacing))

    graph = grid.to_graph()
    assert graph.n_vertices == grid.n_vertices == len(vertices)
    assert list(zip(graph.edge_rows().tolist(), graph.indices.tolist(), strict=True)) == edges
    assert grid.n_edges == graph.n_edges == len(edges)
    assert graph.weights is None
    assert graph.grid is grid
    assert_array_equal(graph.positions, np.array(vertices) * np.array(spacing or (1.0,) * len(shape)))
    # the half that is stored: 1 where an edge starts
    starts = np.zeros((grid.half_window, *shape))
    for h, step in enumerate(grid.forward_offsets.tolist()):
        for u in inside:
            v = tuple(a + b for a, b in zip(u, step, strict=True))
            starts[(h, *u)] = v in number and (number[u], number[v]) in edges
    assert_array_equal(grid.edges.unit_half(), starts)


@pytest.mark.parametrize(("shape", "radius", "metric", "spacing"), GRIDS)
def test_offsets_are_in_order_and_mirrored(shape, radius, metric, spacing):
    grid = GridGraph(shape, radius, metric, spacing=spacing)
    offsets = [tuple(o) for o in grid.offsets.tolist()]
    assert offsets == sorted(offsets)
    assert offsets == [tuple(-x for x in o) for o in reversed(offsets)]
    assert len(offsets) == 2 * grid.half_window
    assert [tuple(o) for o in grid.forward_offsets.tolist()] == [o for o in offsets if o > (0,) * grid.ndim]


@pytest.mark.parametrize(("shape", "radius", "metric", "spacing"), GRIDS)
def test_numbers_and_places_of_vertices(shape, radius, metric, spacing):
    grid = GridGraph(shape, radius, metric, spacing=spacing)
    cells = list(np.ndindex(shape))
    assert (np.array(cells) @ grid.strides).tolist() == list(range(grid.n_vertices))
    assert_array_equal(grid.positions(), np.array(cells) * np.array(spacing or (1.0,) * len(shape)))
    assert grid.steps.shape == (grid.half_window,)
    found = []
    for offset in grid.forward_offsets.tolist():
        ends = [tuple(np.add(cell, offset)) for cell in cells]
        found.append({cells.index(v) - u for u, v in enumerate(ends) if v in cells})
    assert found == [{step} for step in grid.steps.tolist()]


def test_a_part_of_a_grid():
    mask = np.random.default_rng(3).random((6, 7)) < 0.7
    grid = GridGraph((6, 7), 1.5, "euclidean", spacing=(1, 0.5), mask=mask)
    part = grid.part((slice(2, 5), slice(0, 3)))
    assert (part.shape, part.radius, part.metric, part.spacing) == ((3, 3), 1.5, "euclidean", (1, 0.5))
    assert_array_equal(part.mask, mask[2:5, :3])
    assert GridGraph((6, 7)).part((slice(2, 5), slice(0, 3))).mask is None


@pytest.mark.parametrize("name", ["small grid", "small masked", "small volume"])
def test_a_function_on_the_edges_as_planes(name):
    grid, graph = cases.graph(name), cases.graph(name).to_graph()
    values = np.random.default_rng(4).random((grid.n_edges, 2))
    planes = grid.edges.scatter(values)
    assert planes.shape == (len(grid.offsets), *grid.shape, 2)
    vertices, numbers = paper.pixels(grid.shape), {tuple(o): k for k, o in enumerate(grid.offsets.tolist())}
    expected = np.zeros_like(planes)
    for i, j, value in zip(graph.edge_rows(), graph.indices, values, strict=True):
        expected[(numbers[tuple(np.subtract(vertices[j], vertices[i]).tolist())], *vertices[i])] = value
    assert_array_equal(planes, expected)
    assert_array_equal(grid.edges.gather(planes), values)


def test_a_grid_takes_a_number_for_a_line_and_says_what_it_is():
    line = GridGraph(5)
    assert line.shape == (5,)
    assert line.ndim == 1
    assert repr(GridGraph((2, 3), mask=[[True, False, True]] * 2)) == (
        "GridGraph(shape=(2, 3), radius=1, metric='chebyshev', 4 cells in the mask)"
    )


def test_a_grid_is_frozen_and_copies_its_mask():
    mask = np.ones((3, 4), bool)
    grid = GridGraph((3, 4), mask=mask)
    mask[:] = False
    assert grid.mask.all()
    for array in (grid.mask, grid.offsets):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    for name in ("shape", "radius", "metric", "spacing", "mask"):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(grid, name, None)


# Weights of a grid: once per pair, once per directed edge, dense


@pytest.mark.parametrize("name", ["small grid", "small masked", "small row", "small volume"])
def test_weights_once_per_pair_and_once_per_edge(name):
    grid, half = cases.graph(name), cases.weights(name)
    values = grid.edges.gather_half(half)
    graph = grid.to_graph(half)
    assert values.shape == (grid.n_edges,)
    assert_array_equal(graph.weights, values)
    # the weight of an edge, looked up by hand at its first end
    vertices, numbers = paper.pixels(grid.shape), {tuple(o): h for h, o in enumerate(grid.forward_offsets.tolist())}
    pairs = [sorted([vertices[i], vertices[j]]) for i, j in zip(graph.edge_rows(), graph.indices, strict=True)]
    steps = [tuple(b - a for a, b in zip(u, v, strict=True)) for u, v in pairs]
    assert_array_equal(values, [half[(numbers[step], *u)] for step, (u, _) in zip(steps, pairs, strict=True)])
    assert_array_equal(grid.edges.scatter_half(values), half)
    assert_array_equal(grid.edges.scatter_half(values.tolist()), half)


@pytest.mark.parametrize("name", ["small grid", "small masked", "small volume"])
def test_dense_weights(name):
    """(*shape, K): one per offset; what leads out of the grid or the mask is not looked at."""
    grid, half = cases.graph(name), cases.weights(name)
    dense = np.full((*grid.shape, len(grid.offsets)), np.nan)
    edges = iter(grid.edges.gather_half(half))
    stored = {(int(i), int(j)) for i, j in zip(grid.to_graph().edge_rows(), grid.to_graph().indices, strict=True)}
    vertices = paper.pixels(grid.shape)
    number = {u: i for i, u in enumerate(vertices)}
    for u, (k, step) in itertools.product(vertices, enumerate(grid.offsets.tolist())):
        v = tuple(a + b for a, b in zip(u, step, strict=True))
        if v in number and (number[u], number[v]) in stored:
            dense[(*u, k)] = next(edges)
    assert_array_equal(grid.edges.scatter_half(dense), half)


def test_weights_of_a_grid_that_do_not_fit():
    grid = cases.graph("small grid")
    values = grid.edges.gather_half(cases.weights("small grid"))
    with pytest.raises(ValueError, match=rf"weights must have shape \({grid.n_edges},\).*or \(4, 7, 8\).*got \(3,\)"):
        grid.edges.scatter_half(np.ones(3))
    with pytest.raises(ValueError, match=r"half weights must have shape \(4, 4, 7\), got \(4, 28\)"):
        grid.edges.gather_half(np.ones((4, 28)))
    one_way = values.copy()
    one_way[0] += 1
    with pytest.raises(ValueError, match="the same in both directions"):
        grid.edges.scatter_half(one_way)
    for bad, message in ((-1.0, "must be >= 0"), (np.nan, "must be finite"), (np.inf, "must be finite")):
        with pytest.raises(ValueError, match=message):
            grid.edges.scatter_half(np.where(values == values[0], bad, values))


@pytest.mark.parametrize("block", [1, 17, 1 << 22])
def test_blocks_of_vertices_do_not_show(monkeypatch, block):
    """Neighbours are listed some vertices at a time, to bound the memory; seams between blocks must not matter."""
    grid, half = cases.graph("masked"), cases.half_weights(cases.graph("masked"))
    expected = grid.to_graph(half)
    monkeypatch.setattr("gpureg.graphs.grid_edges.BLOCK_ENTRIES", block)
    graph = grid.to_graph(half)
    for name in ("indptr", "indices", "weights"):
        assert_array_equal(getattr(graph, name), getattr(expected, name))
    assert_array_equal(grid.edges.scatter_half(graph.weights), half)


def test_from_scipy_leaves_the_matrix_as_it_is():
    matrix = sparse.csr_array((np.ones(4), [2, 1, 0, 0], [0, 2, 3, 4]), shape=(3, 3))
    for array in (matrix.data, matrix.indices, matrix.indptr):
        array.flags.writeable = False
    kept = matrix.indices.copy()
    Graph.from_scipy(matrix)
    np.testing.assert_array_equal(matrix.indices, kept)
