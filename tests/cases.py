"""Named graphs, functions and parameters that the tests and the benchmarks share.

A row of ``GRAPHS`` is a graph with the weights it is used with. Every distinct (kind of graph, number of axes,
channels, coupled, weighted, lam per vertex, conductances, dtype) is a kernel that each device compiles once (0.2 s), so
``SETUPS`` sweeps all variants on two graphs and takes one variant of each on the others.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gpureg.arrays import FloatArray
from gpureg.graphs.csr import Graph
from gpureg.graphs.grid import GridGraph

AnyGraph = Graph | GridGraph

# Degrees of regularity: simplification (p < 1), total variation, in between, Tikhonov.
P = (0.1, 0.5, 0.7, 1.0, 1.5, 2.0)
# Beyond 2 the sweep needs damping; the primitives do not.
P_ALL = (*P, 3.0)

# eps of eq. 15: a power of two, so that it and its square are exact in both types. Far below the functions' range of 1.
EPS = 2.0**-7

UNIT_ROUNDOFF = {"float32": 2.0**-24, "float64": 2.0**-53}

# How far two correct implementations of one sweep may be apart, relative to the largest |f|, for up to 80 neighbours.
#   D = 80 neighbours, M = 3 channels, u the unit roundoff (Higham's counting: a sum of k nonnegative terms is k u off).
#   |grad f|^2 + eps^2 is a sum of D M products of 4 roundings: 246 u. Its power (p - 2)/2, at most 1 in size for p > 0,
#   keeps that and adds pow's 16 ulp = 32 u and 10 u for the exponent's own rounding: 288 u for a conductance.
#   A sweep is a quotient of two sums of D products with two conductances: 2 (288 + 80) + 13 = 749 u.
#   Two implementations may be off in opposite directions: 1498 u, which is 9e-5 in float32 and 1.7e-13 in float64.
# The float64 number is rounded up to what the project promises across devices, 1e-9, which is also what is left of it
# after a few thousand sweeps. tests/backends/test_primitives.py holds single primitives to sharper bounds.
TOLERANCES = {"float32": 1e-4, "float64": 1e-9}


def rng(seed: int) -> np.random.Generator:
    """A generator; seeds are odd by custom, so that a seed of 0 left over somewhere does not go unnoticed."""
    return np.random.default_rng(seed)


def function(graph: AnyGraph, channels: int = 1, seed: int = 11) -> FloatArray:
    """A float64 function (n, channels) that float32 holds exactly, of both signs, flat on its first third.

    Flat, so that gradients vanish somewhere and eps alone keeps the conductances finite.
    """
    values = rng(seed).random((graph.n_vertices, channels), dtype=np.float32).astype(np.float64) - 0.25
    values[: graph.n_vertices // 3] = 0.375
    return values


def fidelity(graph: AnyGraph, seed: int = 29) -> FloatArray:
    """lam per vertex, (n, 1): mostly numbers in 0..4, with zeros (no data) and infinities (pinned) among them."""
    values = 4 * rng(seed).random((graph.n_vertices, 1), dtype=np.float32).astype(np.float64)
    values[::5] = 0
    values[3::7] = np.inf
    return values


def half_weights(grid: GridGraph, seed: int = 17) -> FloatArray:
    """Random weights in [0, 1) that float32 holds exactly, one in eight of them 0, once per pair: (K/2, *shape)."""
    random = rng(seed).random((grid.half_window, *grid.shape), dtype=np.float32)
    random[random < 0.125] = 0
    return (random * grid.edges.unit_half()).astype(np.float64)


def irregular(n: int, n_edges: int, *, isolated: int, weighted: bool = True, seed: int = 23) -> Graph:
    """A random graph of uneven degrees, with one vertex that no edge reaches, and positions."""
    generator = rng(seed)
    # Squaring crowds the edges on vertices of small number: degrees range from 0 to some dozens.
    ends = (generator.random((n_edges, 2)) ** 2 * n).astype(int)
    pairs = np.unique(np.sort(ends, axis=1), axis=0)
    pairs = pairs[(pairs[:, 0] != pairs[:, 1]) & (pairs != isolated).all(axis=1)]
    weights = None
    if weighted:
        weights = generator.random(len(pairs), dtype=np.float32)
        weights[::8] = 0
    return Graph.from_edges(pairs, weights, n_vertices=n, positions=generator.random((n, 2)))


@dataclass(frozen=True)
class GraphCase:
    """A graph, made when it is asked for, and whether it carries random weights."""

    make: Callable[[], AnyGraph]
    weighted: bool = False


def _checker_mask(shape: tuple[int, ...], seed: int) -> np.ndarray:
    mask = rng(seed).random(shape) < 0.8
    mask[: shape[0] // 4, : shape[1] // 3] = False
    return mask


def _twin(name: str) -> Callable[[], Graph]:
    def make() -> Graph:
        grid = graph(name)
        assert isinstance(grid, GridGraph)
        return grid.to_graph(weights(name))

    return make


GRAPHS: dict[str, GraphCase] = {
    # Sizes that are odd, larger than a work group and no multiple of a vector.
    "grid": GraphCase(lambda: GridGraph((37, 53), 1, "chebyshev"), weighted=True),
    "disk": GraphCase(lambda: GridGraph((23, 41), 2.9, "euclidean")),
    "spaced": GraphCase(lambda: GridGraph((19, 35), 2, "euclidean", spacing=(0.7, 1.3))),
    "masked": GraphCase(lambda: GridGraph((21, 43), 2, "cityblock", mask=_checker_mask((21, 43), 41))),
    "pixel": GraphCase(lambda: GridGraph((1, 1))),
    "narrow": GraphCase(lambda: GridGraph((61, 3), 4, "chebyshev")),
    "row": GraphCase(lambda: GridGraph(301, 3), weighted=True),
    "volume": GraphCase(lambda: GridGraph((7, 9, 19), 2, "cityblock"), weighted=True),
    # Wide enough for Warp's packs within a row, which two axes have above.
    "packs": GraphCase(lambda: GridGraph((3, 4, 75), 2, "cityblock"), weighted=True),
    "packs, unit weights": GraphCase(lambda: GridGraph((3, 4, 75), 2, "cityblock")),
    "four axes": GraphCase(lambda: GridGraph((3, 4, 5, 7), 1, "chebyshev")),
    "csr": GraphCase(lambda: irregular(613, 2400, isolated=311)),
    "csr, one vertex": GraphCase(lambda: Graph([0, 0], [])),
    "csr of grid": GraphCase(_twin("grid")),
    "csr of disk": GraphCase(_twin("disk")),
    "csr of row": GraphCase(_twin("row")),
    # Longer than the 4096 segments of a long sum: along a row, down the rows, and stored.
    "long row": GraphCase(lambda: GridGraph(70001), weighted=True),
    "tall": GraphCase(lambda: GridGraph((4099, 35), 1, "cityblock"), weighted=True),
    "csr of long row": GraphCase(_twin("long row")),
    # Fewer than 30 vertices: what the literal loops of tests/paper.py bear.
    "small grid": GraphCase(lambda: GridGraph((4, 7), 1, "chebyshev"), weighted=True),
    "small disk": GraphCase(lambda: GridGraph((5, 5), 1.5, "euclidean", spacing=(1.0, 0.75))),
    "small masked": GraphCase(lambda: GridGraph((4, 6), 2, "cityblock", mask=_checker_mask((4, 6), 43)), weighted=True),
    "small row": GraphCase(lambda: GridGraph(9, 3), weighted=True),
    "small volume": GraphCase(lambda: GridGraph((3, 2, 4), 2, "cityblock"), weighted=True),
    "small four axes": GraphCase(lambda: GridGraph((2, 3, 2, 2), 1, "chebyshev")),
    "small csr": GraphCase(lambda: irregular(19, 60, isolated=7)),
    "small csr, unweighted": GraphCase(lambda: irregular(17, 40, isolated=16, weighted=False)),
    "small csr of grid": GraphCase(_twin("small grid")),
    "small csr of masked": GraphCase(_twin("small masked")),
}

SMALL = (*(name for name in GRAPHS if name.startswith("small")), "pixel", "csr, one vertex")


@functools.cache
def graph(name: str) -> AnyGraph:
    """The graph of this name."""
    return GRAPHS[name].make()


@functools.cache
def weights(name: str) -> FloatArray | None:
    """The weights it is used with, as ``Backend.prepare`` takes them; None means the graph's own."""
    case = GRAPHS[name]
    made = graph(name)
    if not case.weighted:
        return None
    assert isinstance(made, GridGraph)  # a CSR graph carries its weights itself
    return half_weights(made)


@dataclass(frozen=True)
class Setup:
    """A graph, the channels of the function on it, and whether they share a gradient norm.

    `full` asks for every variant of every primitive, `wide` for float64 too; both cost compilations.
    """

    graph: str
    channels: int = 1
    coupled: bool = True
    full: bool = False
    wide: bool = False

    @property
    def id(self) -> str:
        """A name for pytest."""
        return f"{self.graph}, {self.channels}{'' if self.coupled else ' uncoupled'}"


SETUPS = (
    Setup("grid", full=True, wide=True),
    Setup("grid", 3),
    Setup("grid", 3, coupled=False, wide=True),
    Setup("disk"),
    Setup("spaced"),
    Setup("masked"),
    Setup("pixel"),
    Setup("narrow"),
    Setup("row"),
    Setup("volume", wide=True),
    Setup("four axes"),
    Setup("csr", full=True, wide=True),
    Setup("csr", 3, coupled=False, wide=True),
    Setup("csr, one vertex"),
    Setup("csr of grid"),
    Setup("csr of disk", 3),
    Setup("csr of row"),
)

# For the primitives that sum over segments of vertices.
LONG = (Setup("long row"), Setup("tall"), Setup("csr of long row"))
