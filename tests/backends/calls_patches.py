"""How the primitives that compare patches and those of partitions are called, and how far a device may be off."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import cases
import numpy as np
from primitives import Call, assert_within
from problems import PatchProblem, Problem, oracle

from gpureg.graphs.csr import Graph
from gpureg.graphs.grid import GridGraph

if TYPE_CHECKING:
    from checking import On


def patch_distance(one: PatchProblem) -> Iterator[Call]:
    graph, form = one.graph, one.form

    def bound(exact):
        if not form.cut:
            return one.off
        # next to the cut either side is right
        uncut = one.weights_of(cut=0.0)
        near = np.divide(uncut, one.spatial, out=np.zeros_like(uncut), where=one.spatial > 0)
        assert ((near < form.cut) & (near > 0)).any()
        return np.where(np.abs(uncut - form.cut * one.spatial) <= 2 * one.off, uncut + one.off, one.off)

    def in_place(device: On, found: Any, there: Any) -> None:
        """The weights are where the other primitives look for them, and 0, not just small, where no edge is."""
        w = found.astype(np.float64)
        csr = graph.to_graph(w) if isinstance(graph, GridGraph) else Graph(graph.indptr, graph.indices, w)
        if isinstance(graph, GridGraph):
            assert not found[graph.edges.unit_half() == 0].any()
        largest = np.bincount(csr.edge_rows(), minlength=graph.n_vertices).max(initial=0)
        degree = device.backend.get(graph, device.backend.degree(there))[:, 0]
        allowed = float(one.bounds.gamma(largest)) * csr.degree().max(initial=0)
        assert_within(degree, csr.degree(), allowed, "degree of weights from patches")

    yield Call("", {"f": one.f, "form": form}, bound, also=in_place)


def similarity_step(one: PatchProblem) -> Iterator[Call]:
    """A weight is off by dw (bounds.patch_distance), which moves the quotient q by at most
    sum_v 2 dw (|f(v)| + |q|) / (denominator - sum_v 2 dw); what is then computed from it obeys bounds.jacobi_step.
    """
    graph, f, limit = one.graph, one.f, one.bounds

    def bound(exact):
        off = graph.to_graph(2 * one.off).weights
        pinned = np.isinf(np.broadcast_to(one.lam, (graph.n_vertices, 1)))

        def around(terms):
            return np.stack([np.bincount(limit.rows, t, graph.n_vertices) for t in terms.T], axis=-1)

        moved = around(off[:, None] * (np.abs(f[limit.columns]) + np.abs(exact[limit.rows])))
        left = np.where(pinned, 0, one.lam) + around(2 * limit.w[:, None]) - around(off[:, None])
        moved = np.where(pinned | (left <= 0), 0, moved / np.where(left > 0, left, 1)) * (1 + 8 * limit.u)
        return limit.jacobi_step(f, one.f0, None, one.lam, 1.0) + moved

    yield Call("", {"f": f, "form": one.form, "f0": one.f0, "lam": one.lam, "guide": one.guide}, bound)


# radius of the averaged patches, where a graph has not the second
RADII = {"grid": 2, "disk": 3, "narrow": 4, "row": 7, "pixel": 2}


def aggregate(one: Problem) -> Iterator[Call]:
    """Sums of positive products with a signed F: P cells and D neighbours added, four roundings a term."""
    grid, radius = one.graph, 1 if one.dtype == "float64" else RADII.get(one.setup.graph, 1)
    share, centre = cases.rng(53).random((2, grid.n_vertices, 1), dtype=np.float32).astype(np.float64)
    terms = (2 * radius + 1) ** grid.ndim + len(grid.offsets) + 5
    sizes = oracle().aggregate(one.on_oracle, np.abs(one.f), share, centre, radius)
    yield Call(
        f"radius {radius}",
        {"f": one.f, "share": share, "centre": centre, "radius": radius},
        lambda exact: one.bounds.slack * one.bounds.gamma(terms) * sizes,
    )


# Zones: whole numbers, no device rounds


def lengths_of(one: Problem, highest: int) -> Any:
    """Random lengths of the edges, the same both ways."""
    random = cases.rng(71)
    if isinstance(one.graph, GridGraph):
        half = random.integers(0, highest, (one.graph.half_window, *one.graph.shape))
        there = np.where(one.graph.edges.unit_half() > 0, half, -1)
        return np.ascontiguousarray(there.reshape(one.graph.half_window, one.graph.n_vertices).T).astype(np.int32)
    lengths = random.integers(0, highest, len(one.rows))
    return np.where(one.rows < one.columns, lengths, lengths[one.opposite]).astype(np.int32)


def influence_zones(one: Problem) -> Iterator[Call]:
    """Few lengths, so that paths tie: the fewest edges, then the smallest label."""
    n = one.graph.n_vertices
    sources = np.where(cases.rng(73).random(n) < 0.05, cases.rng(79).permutation(n), -1).astype(np.int32)
    for highest in (1, 4, 1000):
        args = {"lengths": lengths_of(one, highest), "sources": sources}
        yield Call(f"lengths below {highest}", args, lambda exact: 0.0)


def flat_zones(one: Problem) -> Iterator[Call]:
    yield Call("", {"lengths": lengths_of(one, 3)}, lambda exact: 0.0)
