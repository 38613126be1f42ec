"""What public functions take for a graph besides our own, and the names in their errors."""

from __future__ import annotations

import warnings

import networkx as nx
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy import sparse

import gpureg as gr
from gpureg.graphs.accepted import as_graph, as_stored

EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (1, 3)]
WEIGHTS = [1.0, 0.5, 2.0, 0.25, 1.5]
GRAPH = gr.Graph.from_edges(EDGES, WEIGHTS)
MATRIX = GRAPH.to_scipy()
F = np.array([0.0, 3.0, 1.0, 2.0])


def of_networkx(kind: type = nx.Graph) -> nx.Graph:
    g = kind()
    g.add_nodes_from(range(4))
    for (u, v), w in zip(EDGES, WEIGHTS, strict=True):
        g.add_edge(u, v, weight=w)
        if g.is_directed():
            g.add_edge(v, u, weight=w)
    return g


def with_diagonal() -> sparse.csr_array:
    return sparse.csr_array(MATRIX + sparse.diags_array([0.0, 3.0, 0.0, 1.0]))


LIKE = {
    "csr_array": MATRIX,
    "csr_matrix": sparse.csr_matrix(MATRIX),
    "coo": sparse.coo_array(MATRIX),
    "lil": sparse.lil_matrix(MATRIX),
    "Graph of networkx": of_networkx(),
    "DiGraph": of_networkx(nx.DiGraph),
    "MultiGraph": of_networkx(nx.MultiGraph),
    "MultiDiGraph": of_networkx(nx.MultiDiGraph),
}


def same(found: gr.Graph, expected: gr.Graph) -> None:
    assert isinstance(found, gr.Graph)
    assert_array_equal(found.indptr, expected.indptr)
    assert_array_equal(found.indices, expected.indices)
    assert_array_equal(found.weights, expected.weights)


@pytest.mark.parametrize("like", LIKE.values(), ids=LIKE)
def test_the_same_graph(like):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        same(as_graph(like), GRAPH)
        same(as_stored(like, degrees=True), GRAPH)


def test_ours_are_taken_as_they_are():
    grid = gr.GridGraph((2, 3))
    assert as_graph(GRAPH) is GRAPH
    assert as_graph(grid) is grid
    assert as_stored(GRAPH) is GRAPH
    with pytest.raises(TypeError, match=r"graph must be a Graph, got a GridGraph: give grid\.to_graph\(\)"):
        as_stored(grid)


@pytest.mark.parametrize("wrong", [None, 3, "graph", MATRIX.toarray(), EDGES, {0: [1]}], ids=str)
def test_everything_else_is_refused(wrong):
    allowed = "a Graph, a GridGraph, a sparse matrix of scipy or a graph of networkx"
    with pytest.raises(TypeError, match=f"g must be {allowed}, got {type(wrong).__name__}"):
        as_graph(wrong, name="g")


def test_a_function_of_stored_edges_says_what_it_takes():
    with pytest.raises(TypeError, match="must be a Graph, a sparse matrix of scipy or a graph of networkx, got int"):
        as_stored(3)


def loops() -> dict[str, object]:
    g, multi = of_networkx(), of_networkx(nx.MultiGraph)
    g.add_edge(1, 1, weight=3.0)
    multi.add_edges_from([(3, 3), (3, 3)], weight=1.0)
    return {"matrix": with_diagonal(), "coo": with_diagonal().tocoo(), "networkx": g, "multigraph": multi}


@pytest.mark.parametrize("name", loops())
def test_loops_are_left_out_with_a_warning_where_they_change_nothing(name):
    like = loops()[name]
    with pytest.warns(UserWarning, match=r"graph has .*, left out: an edge from a vertex to itself") as caught:
        found = gr.regularize(F, like, p=1, max_iter=5, backend="numpy").value
    assert_array_equal(found, gr.regularize(F, GRAPH, p=1, max_iter=5, backend="numpy").value)
    assert [each.filename for each in caught] == [__file__]
    if sparse.issparse(like):
        assert like.diagonal().sum() == 4
    else:
        assert nx.number_of_selfloops(like) >= 1


@pytest.mark.parametrize("name", loops())
@pytest.mark.parametrize(
    "work",
    [
        lambda like: gr.regularize(F, like, gamma="normalized"),
        lambda like: gr.regularization_path(F, like, lam=[1.0, 2.0], gamma="degree"),
        lambda like: gr.operators.laplacian(F, like, gamma="normalized"),
        lambda like: gr.spectral.averaging_filter(like),
        lambda like: gr.spectral.eigenpairs(like, 2),
        lambda like: gr.spectral.diffuse(F, like, 2),
        lambda like: gr.reordered(like),
        lambda like: gr.write_graph("never.npz", like),
    ],
)
def test_loops_are_refused_where_they_would_count(name, work):
    with pytest.raises(ValueError, match="self-loops are not allowed here, where they would count in the degrees"):
        work(loops()[name])


def test_zeros_on_the_diagonal_say_nothing():
    rows, columns = np.array([*EDGES, (2, 2)]).T
    both = sparse.coo_array(
        ([*WEIGHTS, *WEIGHTS, 0.0], ([*rows[:-1], *columns[:-1], 2], [*columns[:-1], *rows[:-1], 2])), shape=(4, 4)
    )
    assert both.nnz == 11
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        same(as_graph(both, degrees=True), GRAPH)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (sparse.csr_array(np.triu(MATRIX.toarray())), "must be symmetric"),
        (sparse.csr_array((2, 3)), r"square, got shape \(2, 3\)"),
        (-MATRIX, "weights must be >= 0"),
        (nx.DiGraph([(0, 1)]), "every edge must lead both ways"),
        (nx.Graph(), "at least one vertex"),
    ],
    ids=["directed", "not square", "negative", "directed networkx", "empty"],
)
def test_what_is_no_undirected_graph_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        as_graph(wrong)


LABELS = np.array([0, -1, -1, 1])
DOORS = {
    "regularize": lambda g: gr.regularize(F, g, p=1, initial=F + 1, max_iter=5, backend="numpy").value,
    "regularization_path": lambda g: gr.regularization_path(F, g, lam=[1, 2], max_iter=5, backend="numpy")[1].value,
    "memory_needed": lambda g: gr.memory_needed(g, backend="numpy"),
    "energy_partition": lambda g: gr.energy_partition(F, g, LABELS, backend="numpy"),
    "extrema": lambda g: gr.sources.extrema(F, g, backend="numpy"),
    "gradient_minima": lambda g: gr.sources.gradient_minima(F, g, backend="numpy"),
    "difference": lambda g: gr.operators.difference(F, g, backend="numpy"),
    "edge_derivative": lambda g: gr.operators.edge_derivative(F, g, EDGES, backend="numpy"),
    "adjoint": lambda g: gr.operators.adjoint(np.arange(10.0), g, backend="numpy"),
    "divergence": lambda g: gr.operators.divergence(np.arange(10.0), g, backend="numpy"),
    "gradient_norm": lambda g: gr.operators.gradient_norm(F, g, backend="numpy"),
    "laplacian": lambda g: gr.operators.laplacian(F, g, gamma="normalized", backend="numpy"),
    "curvature": lambda g: gr.operators.curvature(F, g, eps=0.1, backend="numpy"),
    "energy": lambda g: gr.operators.energy(F, F + 1, g, 1, 2.0, backend="numpy"),
    "dirichlet_energy": lambda g: gr.operators.dirichlet_energy(F, g, 1, backend="numpy"),
    "averaging_filter": lambda g: gr.spectral.averaging_filter(g).neighbours.toarray(),
    "markov_matrix": lambda g: gr.operators.markov_matrix(g).toarray(),
    "diffuse": lambda g: gr.spectral.diffuse(F, g, 2),
    "eigenpairs": lambda g: gr.spectral.eigenpairs(g, 2).vectors,
    "spectral_filter": lambda g: gr.spectral.spectral_filter(F, g, 2),
    "discrepancy": lambda g: gr.tuning.discrepancy(F, g, 0.5, max_iter=5, backend="numpy").result.value,
    "ring_graph": lambda g: gr.ring_graph(g, 2).indices,
    "reordered": lambda g: gr.reordered(g)[0].weights,
}


@pytest.mark.parametrize("like", [MATRIX, of_networkx()], ids=["scipy", "networkx"])
@pytest.mark.parametrize("door", DOORS)
def test_every_function_takes_them(door, like):
    assert_array_equal(DOORS[door](like), DOORS[door](GRAPH))


@pytest.mark.parametrize("like", [MATRIX, of_networkx()], ids=["scipy", "networkx"])
def test_write_graph_takes_them(tmp_path, like):
    gr.write_graph(tmp_path / "graph.npz", like)
    same(gr.read_graph(tmp_path / "graph.npz"), GRAPH)


# Edge lists


def test_edges_as_two_rows():
    same(gr.Graph.from_edges(np.array(EDGES).T, WEIGHTS), GRAPH)
    two = gr.Graph.from_edges([[0, 1], [2, 3]])
    assert two.to_edges()[0].tolist() == [[0, 1], [2, 3]]
    assert gr.Graph.from_edges(np.array([[4], [1]])).to_edges()[0].tolist() == [[1, 4]]


# The function that was called is named in its error


@pytest.mark.parametrize(
    ("work", "kind", "message"),
    [
        (lambda: gr.Graph([0, 1], [5]), ValueError, r"^Graph: indices must lie in 0\.\.0, got 5"),
        (lambda: gr.Graph([0, 0], [], positions=["a"]), TypeError, "^Graph: positions must hold real numbers"),
        (lambda: gr.Graph.from_edges([[0, 0]]), ValueError, "^Graph.from_edges: self-loops are not allowed"),
        (lambda: gr.Graph.from_edges([[0, 1]], n_vertices=2.0), TypeError, "^Graph.from_edges: n_vertices must be an"),
        (lambda: gr.Graph.from_scipy(with_diagonal()), ValueError, "^Graph.from_scipy: self-loops are not allowed"),
        (lambda: gr.GridGraph((3, 3), "1"), TypeError, "^GridGraph: radius must be a number, got '1'"),
        (lambda: gr.GridGraph((3, 3), spacing="ab"), ValueError, "^GridGraph: spacing must hold 2 numbers"),
        (lambda: gr.GridGraph((3, 3), spacing=("a", 1)), TypeError, "^GridGraph: spacing must hold numbers"),
        (lambda: gr.knn_graph([[0.0], [1.0]], 1.5), TypeError, "^knn_graph: k must be an integer, got 1.5"),
        (lambda: gr.knn_graph([[0.0], [1.0]], 1, reach=0), ValueError, "^knn_graph: reach must be > 0, got 0"),
        (lambda: gr.radius_graph([[0.0], [1.0]], True), TypeError, "^radius_graph: radius must be a number, got True"),
        (lambda: gr.mesh_graph([[np.nan]], []), ValueError, "^mesh_graph: vertices must be finite"),
        (lambda: gr.face_graph([[0.0]], [], across="x"), ValueError, '^face_graph: across must be "edge" or "vertex"'),
        (lambda: gr.curve_graph([[0.0], [1.0]], closed=1), TypeError, "^curve_graph: closed must be True or False"),
        (lambda: gr.ring_graph(GRAPH, 0), ValueError, "^ring_graph: rings must be >= 1, got 0"),
        (lambda: gr.ring_graph(gr.GridGraph(3), 1), TypeError, "^ring_graph: graph must be a Graph, got a GridGraph"),
        (lambda: gr.reordered(gr.GridGraph(3)), TypeError, "^reordered: graph must be a Graph, got a GridGraph"),
        (lambda: gr.reordered(GRAPH, [0, 0, 1, 2]), ValueError, "^reordered: order must hold each of the 4 vertices"),
        (
            lambda: gr.write_graph("a.npz", gr.GridGraph(3)),
            TypeError,
            "^write_graph: graph must be a Graph, got",
        ),
        (lambda: gr.read_graph("a.txt"), ValueError, "^read_graph: a.txt: the extension must be one of"),
        (lambda: gr.to_networkx(gr.GridGraph(3)), TypeError, "^to_networkx: graph must be a Graph, got a GridGraph"),
        (lambda: gr.from_networkx(3), TypeError, "^from_networkx: g must be a networkx graph, got int"),
    ],
)
def test_errors_name_the_function(work, kind, message):
    with pytest.raises(kind, match=message):
        work()
