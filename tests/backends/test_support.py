"""The rows of the primitives: they cover the protocol, say what devices support, and count the traffic."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
import support
from primitives import COLUMN, EDGES, FUNCTION, NORMS, NUMBER, ROWS, SCRATCH, Primitive
from problems import Kind
from test_primitives import PAIRS

from gpureg.backends import Backend
from gpureg.graphs.grid import GridGraph

# Made of primitives, or not computing anything; test_groups_of_patches.py has groups, which are no function.
OTHERS = {
    *("patch_groups", "get_groups", "group_step"),
    *("put", "get", "empty", "put_edges", "get_edges", "empty_edges", "channels"),
    *("prepare", "prepare_gamma", "get_weights", "conductances", "copy", "finish"),
    *("numbers", "read", "max_change_into", "dot_into", "energy_into", "duality_gap_into"),  # test_sums.py
    *("scalars", "begin_scalars", "watch", "mix_coefficients", "judge_mix"),  # test_scalars.py
    *("cosines", "cosine_solve", "overwrite", "record", "release"),  # test_cosines.py, test_recorded.py
    *("on_device", "on_host", "put_cells", "get_cells", "blur", "mix"),  # cells, not functions on a graph
    *("restrict", "prolong", "relax", "aggregates", "descend", "ascend"),  # test_multilevel.py
    *("gradient_product", "hessian", "shorten", "dual_newton"),  # test_curvature.py
    *("put_memory", "get_memory", "reads"),  # arrays of other libraries
}


def test_the_rows_are_the_protocol():
    methods = {
        name
        for name, member in inspect.getmembers(Backend, inspect.isfunction)
        if not name.startswith("_") and not name.endswith("_bytes")
    }
    assert methods - OTHERS == set(ROWS)


@pytest.mark.parametrize("name", ROWS)
def test_arguments_are_those_of_the_method(name):
    given = list(inspect.signature(getattr(Backend, name)).parameters)[2:]
    row = ROWS[name]
    assert set(given) - set(row.args) <= {"out", "storage", "largest"}
    assert set(row.args) <= set(given)
    assert ("out" in given) == (row.out and row.args.get("previous") is None)


@pytest.mark.parametrize("graph", support.GRAPHS)
@pytest.mark.parametrize("name", ROWS)
def test_numpy_supports_all(oracle, name, graph):
    expected = "yes" if graph in ROWS[name].graphs else "not asked for"
    assert support.verdict(oracle, ROWS[name], graph) == expected


def test_the_table_has_every_primitive():
    lines = list(support.table(["numpy"]))
    assert [line.split("`")[1] for line in lines[2:-1]] == list(ROWS)
    assert lines[0] == "| primitive | numpy, grid | numpy, stored |"
    assert lines[-1] == "| weights held | full | full |"


# Traffic


def counted(row: Primitive, one, call) -> tuple[float, float]:
    """Numbers in the arrays of a call, and in what the oracle gives for it."""
    graph = one.graph
    read = 0
    for name, value in call.args.items():
        kind = row.args[name]
        if isinstance(value, np.ndarray) and kind != SCRATCH:
            read += one.host(value).size if kind == EDGES else value.size
    if row.weights:
        stored = 2 * graph.n_edges + graph.n_vertices
        read += graph.n_vertices * graph.half_window if isinstance(graph, GridGraph) else stored
    per_result = {FUNCTION: one.channels, NORMS: 1 if one.coupled else one.channels, COLUMN: 1}
    written = per_result.get(row.result, 0) * graph.n_vertices
    return read, one.host(one.H).size if row.result == EDGES else written


KINDS = [
    (kind, name)
    for kind, name in PAIRS
    if isinstance(kind, Kind)
    and kind.setup.graph in ("grid", "csr")
    and kind.dtype == "float32"
    and not ROWS[name].parts
    and ROWS[name].result in (FUNCTION, NORMS, COLUMN, EDGES, NUMBER)
]


@pytest.mark.parametrize(("kind", "name"), KINDS, ids=[f"{name}-{kind.id}" for kind, name in KINDS])
def test_traffic_is_the_size_of_the_arrays(kind, name):
    """Of every call whose arguments are what the count is of: gradient norms given, one channel to divide by."""
    row, one, compared, wrong = ROWS[name], kind.make(), 0, []
    graph = one.graph
    stored = not isinstance(graph, GridGraph)
    neighbours = graph.n_edges / graph.n_vertices if stored else 2 * graph.half_window
    for call in row.calls(one):
        columns = {n: v for n, v in call.args.items() if row.args[n] == COLUMN and isinstance(v, np.ndarray)}
        needed = [call.args[n] for n, kind in row.args.items() if kind in (NORMS, FUNCTION)]
        if any(v.shape[1] > 1 for v in columns.values()) or not all(isinstance(v, np.ndarray) for v in needed):
            continue
        compared += 1
        norms = 1 if one.coupled else one.channels
        found = row.traffic(
            neighbours, channels=one.channels, norms=norms, stored=stored, arrays=tuple(columns), itemsize=1
        )
        if np.multiply(found, graph.n_vertices) != pytest.approx(counted(row, one, call)):
            wrong.append(call.what)
    assert not wrong
    assert compared or one.edge_norm or not one.plain


@pytest.mark.parametrize(("stored", "expected"), [(False, 56), (True, 160)], ids=["grid", "stored"])
def test_traffic_of_an_iteration(stored, expected):
    """bench/README.md counts it by hand: a sweep of one channel with 8 neighbours."""
    assert sum(ROWS["sweep"].traffic(8, stored=stored)) == expected


@pytest.mark.parametrize(
    ("name", "settings", "expected"),
    [
        ("combine", {}, (8, 4)),
        ("combine", {"arrays": ("over",), "channels": 3}, (28, 12)),
        ("dual_step", {}, (4 * (2 * 8 + 2 + 4), 32)),
        ("patch_distance", {}, (4, 16)),
        ("similarity_step", {"arrays": ("guide",)}, (12, 4)),
        ("influence_zones", {"stored": True}, (36, 12)),
    ],
)
def test_traffic_by_hand(name, settings, expected):
    assert ROWS[name].traffic(8, **settings) == expected
