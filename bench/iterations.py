"""Iterations of p = 1: on grids, on the same graphs stored as CSR, on a wide window, on irregular graphs."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np

import gpureg as gr
from gpureg import backends
from gpureg.backends import Smoothness

from .model import (
    DEVICE,
    HOST,
    NEEDS_DATA,
    SEED,
    TOLERANCE,
    Bar,
    Case,
    Entry,
    Image,
    Setup,
    apart,
    data,
    shared,
    skipped,
    traffic,
)

NUMPY64 = "numpy float64"
PRODUCT = "scipy CSR product"
STREAMED = "its weights streamed twice"


class Sweeps:
    """So many iterations on one device; nothing is put there before the first is asked for.

    Parameters
    ----------
    device : str
    graph : Graph or GridGraph
    weights : Weights, array or None
        As ``Backend.prepare`` takes them, or an object that prepares them.
    f0 : (n, m) array
    dtype : dtype, default float32
    p, lam, eps : float
    steps : int, default 1
        Iterations of one call.
    """

    def __init__(
        self,
        device: str,
        graph: Any,
        weights: Any,
        f0: Image,
        dtype: Any = np.float32,
        *,
        p: float = 1.0,
        lam: float = 1.0,
        eps: float = 1e-3,
        steps: int = 1,
    ) -> None:
        self.graph, self.weights, self.host, self.steps = graph, weights, f0, steps
        self.p, self.lam, self.eps = p, lam, eps
        self.backend = backends.get(device, dtype)

    @cached_property
    def weighted(self) -> Any:
        """The graph with its weights on the device."""
        if isinstance(self.weights, gr.weights.Weights):
            return self.weights.prepare(self.backend, self.graph, self.host)
        return self.backend.prepare(self.graph, self.weights)

    @cached_property
    def f0(self) -> Any:
        """The data on the device."""
        return self.backend.put(self.graph, self.host)

    @cached_property
    def pair(self) -> list[Any]:
        """Two iterates, the current one first."""
        return [self.backend.put(self.graph, self.host), self.backend.empty(self.graph, self.host.shape[1])]

    @cached_property
    def g(self) -> Any:
        """Scratch for the conductances."""
        return None if self.p == 2 else self.backend.empty(self.graph, 1)

    def _sweep(self, f: Any, f0: Any, out: Any, backend: Any = None) -> None:
        """One sweep, by a backend that may record it."""
        backend, model = backend or self.backend, Smoothness(self.p, self.eps)
        backend.sweep(self.weighted, f, f0, self.lam, model, theta=1.0, g=self.g, out=out)

    @cached_property
    def turns(self) -> list[Any]:
        """The next iteration, recorded as a solver does, and the one after it."""
        return list(
            backends.in_turns(
                self.backend, lambda backend, f, out: self._sweep(f, self.f0, out, backend), self.pair[0], self.pair[1]
            )
        )

    def __call__(self) -> None:
        """The iterations, from array to array that stay on the device."""
        for _ in range(self.steps):
            self.turns[0]()
            self.turns.reverse()
            self.pair.reverse()

    def host_to_host(self) -> Image:
        """The data onto the device, one iteration, the result back; the weights are there."""
        f0 = self.backend.put(self.graph, self.host)
        self._sweep(f0, f0, self.pair[1])
        return self.backend.get(self.graph, self.pair[1])

    def value(self) -> Image:
        """The current iterate, on the host."""
        return self.backend.get(self.graph, self.pair[0])

    def entries(self, reference: Image, moved: float, operations: float) -> list[Entry]:
        """The device part, and host to host."""
        device = self.backend.device.id

        def agrees() -> tuple[bool, str]:
            self()
            return apart(self.value(), reference, TOLERANCE["float32"], NUMPY64)

        def transferred_agrees() -> tuple[bool, str]:
            return apart(self.host_to_host(), reference, TOLERANCE["float32"], NUMPY64)

        return [
            Entry(device, self, self.backend.finish, agrees, DEVICE, moved, operations),
            Entry(device, self.host_to_host, lambda: None, transferred_agrees, HOST, moved, operations),
        ]


def first_iteration(graph: Any, weights: Any, f0: Image) -> Image:
    """What the first iteration must give: numpy in float64."""
    exact = Sweeps("numpy", graph, weights, f0, np.float64)
    exact()
    return exact.value()


def operations(vertices: int, edges: int) -> float:
    """Operations of one p = 1 iteration: 4 + 5 per directed edge, 12 per vertex; README.md lists them."""
    return 9.0 * edges + 12.0 * vertices


def scipy_product(graph: gr.Graph, f0: Image) -> Entry:
    """The peer: one sparse product, 32-bit indices, float32 as we compute."""
    matrix = graph.to_scipy().astype(np.float32)
    matrix.indices, matrix.indptr = matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)
    vector = np.ascontiguousarray(f0[:, 0], np.float32)
    moved = matrix.data.nbytes + matrix.indices.nbytes + matrix.indptr.nbytes + 2 * vector.nbytes
    return Entry(
        PRODUCT, lambda: matrix @ vector, bytes=moved, operations=2 * matrix.nnz, is_peer=True, note="one thread"
    )


def unit_picture(setup: Setup, side: int) -> tuple[Image, str]:
    """The noisy picture of 0..1 as a function (n, 1), and its name."""
    _, f0, name = setup.noisy(side)
    return (f0 / 255).reshape(-1, 1), f"picture: {name}, noise of standard deviation 20 of 255"


def iteration(setup: Setup) -> Iterator[Case]:
    """One p = 1 iteration, on a grid and on the same graph as CSR, beside one sparse product of scipy."""
    side = setup.pick(1024, 128, 37)
    f0, name = unit_picture(setup, side)
    grid = gr.GridGraph((side, side), 1)
    w1 = gr.weights.bilateral(2.0, 0.2)
    oracle = backends.get("numpy", np.float32)
    half = oracle.get_weights(w1.prepare(oracle, grid, f0))
    graph = grid.to_graph(half)
    reference = first_iteration(grid, half, f0)
    count = operations(grid.n_vertices, graph.n_edges)
    bars = {
        "grid": [Bar(PRODUCT, 0.45, transfers=DEVICE)],
        "CSR": [
            Bar(PRODUCT, 1.5, "opencl", DEVICE),
            Bar(PRODUCT, 5, "warp:cpu", DEVICE),
        ],
    }
    for kind, layout, weights, moved in (
        ("grid", grid, w1, traffic("sweep", grid)),
        ("CSR", graph, None, traffic("sweep", graph)),
    ):
        product = scipy_product(graph, f0)
        entries = [product]
        for device in setup.devices:
            entries += Sweeps(device, layout, weights, f0).entries(reference, moved, count)
        assert product.bytes is not None
        yield Case(
            f"iteration-{kind.lower()}",
            f"one p = 1 iteration, {side}x{side}, 8 neighbours, bilateral weights, as {kind}",
            entries,
            [
                f"{name}; weights made and on the device before, in all rows",
                f"bytes per vertex: {moved / grid.n_vertices:.0f} in the two passes, "
                f"{product.bytes / grid.n_vertices:.0f} in scipy's product",
            ],
            bars[kind],
            f"{side}x{side}",
            grid.n_vertices,
        )


def window(setup: Setup) -> Iterator[Case]:
    """One p = 1 iteration on a 17x17 window with weights w1 and w2, as in Fig. 1 of the paper."""
    side, radius = setup.pick((512, 8), (64, 8), (23, 3))
    f0, name = unit_picture(setup, side)
    grid = gr.GridGraph((side, side), radius)
    width = 2 * radius + 1
    weights = {
        "w1": gr.weights.bilateral(radius / 2, 0.2),
        # patches of 7x7, h^2 = 49 times the square of 20/255
        "w2": gr.weights.patch(3, 7 * 20 / 255),
    }
    edges = grid.n_vertices * 2 * grid.half_window
    stored = 4.0 * grid.n_vertices * grid.half_window
    for kind, function in weights.items():
        reference = first_iteration(grid, function, f0)
        entries = []
        for device in setup.devices:
            sweeps = Sweeps(device, grid, function, f0)
            entries += sweeps.entries(reference, traffic("sweep", grid), operations(grid.n_vertices, edges))
        yield Case(
            f"window-{kind}",
            f"one p = 1 iteration, {side}x{side}, {width}x{width} window, weights {kind} (an iteration of Fig. 1)",
            entries,
            [
                f"{name}; weights made and on the device before, in all rows",
                f"stored weights: once per pair in float32, {stored / 1e6:.0f} MB; the time to stream them twice is "
                "taken at the measured bandwidth of the device",
            ],
            [Bar(STREAMED, 1.5, transfers=DEVICE, over_bytes=2 * stored)],
            f"{side}x{side}",
            grid.n_vertices,
        )


def scale_free(n: int, hub: int) -> gr.Graph:
    """A seeded graph whose degrees d fall like d^-3, and a vertex of `hub` neighbours besides."""
    graph = shared.irregular(n, 4 * n, isolated=n // 2, seed=SEED)
    rows = graph.edge_rows()
    keep = rows < graph.indices
    generator = shared.rng(SEED + 2)
    # of all but the vertex itself, the last one
    spokes = np.column_stack([generator.choice(n - 1, hub, replace=False), np.full(hub, n - 1)])
    edges = np.concatenate([np.column_stack([rows[keep], graph.indices[keep]]), spokes])
    weights = np.concatenate([graph.weights[keep], 0.5 + generator.random(hub, dtype=np.float32) / 2])
    return gr.Graph.from_edges(edges, weights.astype(np.float32), n_vertices=n, symmetrize="max")


def shuffled(graph: gr.Graph) -> gr.Graph:
    """The same graph with its vertices in another order."""
    order = shared.rng(SEED + 4).permutation(graph.n_vertices)
    return gr.Graph.from_scipy(graph.to_scipy()[order][:, order])


def _with_weights(graph: gr.Graph) -> gr.Graph:
    """Random weights, which scipy's product reads in any case."""
    rows = graph.edge_rows()
    keep = rows < graph.indices
    weights = shared.rng(SEED).random(int(keep.sum()), dtype=np.float32)
    return gr.Graph.from_edges(np.column_stack([rows[keep], graph.indices[keep]]), weights, n_vertices=graph.n_vertices)


def irregular(setup: Setup) -> Iterator[Case]:
    """One p = 1 iteration on graphs of uneven degrees, beside one sparse product of scipy each."""
    n, hub = setup.pick((200_000, 100_000), (20_000, 10_000), (400, 200))
    hubs = scale_free(n, hub)
    graphs: dict[str, tuple[str, gr.Graph | None]] = {
        "scale-free": (f"{n} vertices, one of {hub} neighbours", hubs),
        "shuffled": (f"the scale-free graph of {n} vertices in another order", shuffled(hubs)),
    }
    for name, file in (("minnesota", "minnesota_road.mtx"), ("luxembourg", "luxembourg_osm.mtx.gz")):
        path = data("graphs", file)
        graphs[name] = (f"roads, {file}", None if path is None else gr.read_graph(path, symmetrize="max"))
    for name, (what, graph) in graphs.items():
        if graph is None:
            yield Case(f"irregular-{name}", f"one p = 1 iteration, {what}", [skipped("all", NEEDS_DATA)])
            continue
        if name in ("minnesota", "luxembourg"):
            graph = _with_weights(graph)
        f0 = shared.function(graph).astype(np.float32)
        reference = first_iteration(graph, None, f0)
        count = operations(graph.n_vertices, graph.n_edges)
        entries = [scipy_product(graph, f0)]
        for device in setup.devices:
            entries += Sweeps(device, graph, None, f0).entries(reference, traffic("sweep", graph), count)
        degree = np.diff(graph.indptr)
        yield Case(
            f"irregular-{name}",
            f"one p = 1 iteration, {what}",
            entries,
            [
                f"{graph.n_vertices} vertices, {graph.n_edges // 2} edges, degrees {degree.min()} to {degree.max()}, "
                "weights stored"
            ],
            label=name,
            vertices=graph.n_vertices,
        )
