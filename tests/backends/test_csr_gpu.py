"""Stored graphs as a GPU takes them, in slices of rows or by teams of work items, on one OpenCL driver."""

from __future__ import annotations

from typing import Any

import cases
import numpy as np
import pytest
import rows as _rows  # noqa: F401, fills ROWS
from checking import as_gpu, check
from guards import guarded
from numpy.testing import assert_array_equal
from primitives import ROWS
from problems import HOT, Kind
from second_order import Setting, compare
from test_multilevel import hold

from gpureg.graphs.csr import Graph

pytestmark = pytest.mark.one_driver

# The primitive, work items of a team, edges of a piece, and the problem. Rows have up to some dozens of edges; 0: a
# team is not asked for, and rows of similar lengths are in slices.
CASES = [
    ("jacobi_step", 8, 8, Kind(cases.Setup("csr", 3, coupled=False), directed=True)),
    ("dual_step", 8, 8, Kind(cases.Setup("csr", 3, coupled=False), classes=HOT)),
    ("difference", 8, 8, Kind(cases.Setup("csr"))),
    ("gradient_norm", 8, 1000, Kind(cases.Setup("csr", 3))),
    ("energy", 8, 8, Kind(cases.Setup("csr"), edge_norm=True)),
    ("primal", 4, 8, Kind(cases.Setup("csr", 3, coupled=False), classes=HOT)),
    ("largest_weight", 1, 4, Kind(cases.Setup("csr"))),
    ("p_laplacian", 32, 16, Kind(cases.Setup("csr"), "float64")),
    ("p_laplacian", 0, 0, Kind(cases.Setup("csr of grid"), directed=True)),
    ("adjoint", 0, 0, Kind(cases.Setup("csr of grid", 3))),
]


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch, device: str) -> Any:
    """Makes a backend that has a GPU's forms of stored graphs, with teams and pieces of this size.

    Without optimisation, as a driver for CPUs takes long to make loops of all work items between two barriers.
    """
    if not device.startswith("opencl"):
        pytest.skip("the forms are OpenCL's")
    from gpureg.backends.opencl import rows

    def make(dtype: str = "float32", team: int = 0, piece: int = 0) -> Any:
        if team:
            monkeypatch.setattr(rows, "_TEAMS", ((0.0, team),))
            monkeypatch.setattr(rows, "_ROOM", 0.0)
            monkeypatch.setattr(rows, "_TRIPS", 0)
            monkeypatch.setattr(rows, "_LEAST_PIECE", piece)
        backend = as_gpu(device, dtype, monkeypatch)
        backend._options += ("-cl-opt-disable",)
        return backend

    return make


def built(backend: Any, primitive: str) -> set[tuple[str, ...]]:
    """The build options that choose a form, of each kernel of a primitive that this file built."""
    chosen = ("-DSLICED", "-DTEAM", "-DSPLIT", "-DHUBS")
    return {
        tuple(option for option in options if option.startswith(chosen))
        for name, options in backend._shared.kernels
        if name == primitive and "-cl-opt-disable" in options
    }


@pytest.mark.parametrize(("name", "team", "piece", "kind"), CASES, ids=[f"{case[0]}-{case[1]}" for case in CASES])
def test_primitive(gpu, name, team, piece, kind):
    """Within the bound of additions in any order, the same bits twice, and nothing written outside of an array."""
    backend = gpu(kind.dtype, team, piece)
    check(backend, ROWS[name], kind.make())
    form = (f"-DTEAM={team}" if team else "-DSLICED",)
    split = (*form, "-DSPLIT"), ("-DTEAM=32", "-DHUBS")
    name = {"largest_weight": "degree", "energy": "gradient_norm"}.get(name, name)
    collects = split if name != "difference" else split[:1]  # nothing to add up
    assert built(backend, name) >= set(collects if 0 < piece < 1000 else [form])


@pytest.mark.parametrize("edge_norm", [False, True])
def test_newton(gpu, edge_norm):
    backend = gpu("float32", 8, 8)
    compare(backend, Setting(Kind(cases.Setup("csr", 3), edge_norm=edge_norm).make(), 1.5, 0.125, True))
    split = ("-DTEAM=8", "-DSPLIT"), ("-DTEAM=32", "-DHUBS")
    assert built(backend, "hessian") >= set(split)
    assert built(backend, "shorten") >= set(split[:1] if edge_norm else split)


@pytest.mark.parametrize(("team", "piece"), [(0, 0), (8, 8)])
def test_multigrid(gpu, team, piece):
    """The parts of a level: the two fused kernels are for rows of one work item."""
    backend = gpu("float32", team, piece)
    hold(guarded(backend), Kind(cases.Setup("csr" if team else "csr of grid", 3)))
    assert not built(backend, "descend")
    assert (("-DTEAM=8", "-DSPLIT") if team else ("-DSLICED",)) in built(backend, "relax")


def spread(n: int, degrees: Any) -> Graph:
    """A graph with at least so many edges at each vertex, to the vertices that come next."""
    pairs = [(u, (u + 1 + j) % n) for u, degree in zip(range(n), degrees, strict=False) for j in range(degree)]
    return Graph.from_edges(np.unique(np.sort(pairs, axis=1), axis=0), n_vertices=n)


def test_the_form_is_chosen_by_degrees():
    """Slices for rows of similar lengths; teams of 1, 4, 8 or 32 by the mean degree; pieces for long rows alone."""
    from gpureg.backends.opencl import rows

    def form(graph: Graph, gpu: bool = True) -> tuple[Any, ...]:
        made = rows.csr_layout(lambda host: host, graph, rows.csr_geometry(graph, gpu), 64, gpu)
        return type(made).__name__, getattr(made, "_team", None), getattr(made, "_n_pieces", None)

    ring, star = spread(300, [2] * 300), spread(300, [299])
    uneven, more, dense = spread(300, [1, 2, 3, 20] * 75), spread(300, [2, 2, 2, 40] * 75), spread(300, [40] * 300)
    hub = spread(1200, [1, 2, 3, 20] * 299 + [1199])
    assert form(ring, gpu=False) == form(star, gpu=False) == ("CsrLayout", None, None)
    assert form(ring) == ("SlicedLayout", None, None)
    assert form(star) == ("TeamLayout", 1, 5)  # 299 edges in pieces of 64
    assert form(uneven) == ("TeamLayout", 4, 0)
    assert form(more) == ("TeamLayout", 8, 0)
    assert form(dense) == ("TeamLayout", 32, 0)
    assert form(hub) == ("TeamLayout", 4, 19)  # 1199 edges in pieces of 64
    assert form(Graph([0, 0], [])) == ("CsrLayout", None, None)


def test_slices():
    """Edge j of row u is at the start of its slice + 32 j + u % 32, and its opposite is the edge back."""
    from gpureg.backends.opencl import rows

    graph = cases.graph("csr of disk")
    geometry = rows.csr_geometry(graph, True)
    made = rows.csr_layout(lambda host: host, graph, geometry, 64, True)
    degree, place = np.diff(graph.indptr), []
    for u in range(graph.n_vertices):
        first = 32 * sum(int(degree[at : at + 32].max()) for at in range(0, u - u % 32, 32))
        place += [first + 32 * j + u % 32 for j in range(degree[u])]
    assert_array_equal(made.indices[place], graph.indices)
    assert_array_equal(made.args(None, False)[2], degree)
    assert geometry.n_edges >= max(place) + 1
    values = cases.rng(3).random((graph.n_edges, 2))
    assert_array_equal(made.pack_weights(values[:, 0])[place], values[:, 0])
    assert_array_equal(made.unpack_weights(made.pack_weights(values[:, 0])), values[:, 0])
    assert_array_equal(made.unpack_edges(made.pack_edges(values).ravel(), 2), values)
    mirror = made.args(None, True)[-1]
    assert_array_equal(made.indices[mirror[place]], graph.edge_rows())
    assert_array_equal(mirror[mirror[place]], place)


def test_pieces():
    """They are in the order of the edges, each of one row, and those of a hub follow one another."""
    from gpureg.backends.opencl import rows

    graph = cases.graph("csr")
    made = rows.TeamLayout(lambda host: host, graph, rows.CsrGeometry(graph.n_vertices, graph.n_edges), 64, 8, 8)
    size, row = np.diff(made._starts), made._rows
    assert made._starts[0] == 0 and made._starts[-1] == graph.n_edges
    assert_array_equal(graph.edge_rows(), np.repeat(row, size))
    assert (np.bincount(row) > 0).all()
    hub = np.diff(graph.indptr) > 8
    assert (size[hub[row]] <= 8).all()
    assert_array_equal(made._pieces[hub[row]], np.arange(made._n_pieces))
    assert (made._pieces[~hub[row]] == -1).all()
    for _, edges, (vertices, added) in (made._of_hubs, made._of_pieces):
        for u, (first, last), (begin, end) in zip(vertices, edges, added, strict=True):
            assert (graph.edge_rows()[first:last] == u).all()
            assert (row[hub[row]][begin:end] == u).all()
            assert size[hub[row]][begin:end].sum() == graph.indptr[u + 1] - graph.indptr[u]
    assert_array_equal(made._of_hubs[2][0], np.flatnonzero(hub))
    assert_array_equal(np.diff(made._of_pieces[1]).ravel(), size[hub[row]])


def test_a_look_at_the_zones_reads_one_number(gpu, monkeypatch):
    """The flag of each look is four bytes, and mu and tag are read at the end."""
    backend, sizes = gpu(), []
    download = backend._download
    monkeypatch.setattr(backend, "_download", lambda *args: sizes.append(args[1]) or download(*args))
    graph = cases.graph("csr")
    lengths = np.ones(graph.n_edges, np.int32)
    sources = np.where(np.arange(graph.n_vertices) == 5, 0, -1).astype(np.int32)
    backend.influence_zones(graph, lengths, sources)
    assert sizes[-2:] == [graph.n_vertices] * 2
    assert set(sizes[:-2]) == {1}
