"""The primitives of multigrid: against numpy within counted bounds, and a level's two launches against their parts."""

from __future__ import annotations

import dataclasses
from typing import Any

import cases
import numpy as np
import pytest
from checking import on
from guards import guarded
from primitives import assert_within
from problems import Kind, Problem, oracle

from gpureg.backends.multilevel import Multilevel, Smoother
from gpureg.graphs.csr import Graph

PROBLEMS = [
    Kind(cases.Setup("masked", 3)),
    Kind(cases.Setup("csr", 3), "float64"),
    Kind(cases.Setup("csr"), directed=True),
    Kind(cases.Setup("volume"), "float64", directed=True),
    Kind(cases.Setup("csr, one vertex")),
]
MARKS = [() if at < 2 else pytest.mark.one_driver for at in range(len(PROBLEMS))]


@dataclasses.dataclass(frozen=True, eq=False)
class Level:
    """A problem as a level of multigrid: aggregates of up to 3 vertices; some vertices, and pinned ones, in none."""

    one: Problem

    @property
    def of(self) -> Any:
        at = np.arange(self.one.graph.n_vertices)
        alone = (at % 11 == 5) | np.isinf(self.one.lam[:, 0])
        return np.where(alone, -1, (at * 7) % (3 * len(at) // 8 + 1))

    @property
    def coarse(self) -> Graph:
        """A graph with a vertex per aggregate; only its size matters."""
        n = int(self.of.max(initial=0)) + 2
        return Graph(np.zeros(n + 1, np.int64), np.zeros(0, np.int64))

    @property
    def e(self) -> Any:
        """A function on the next level."""
        n = self.coarse.n_vertices
        return cases.rng(7).random((n, self.one.channels), dtype=np.float32).astype(np.float64)

    def diagonal(self) -> Any:
        """That of lam + 2 sum gamma^2, infinite at pinned vertices."""
        return self.one.lam + 2 * self.one.around(self.one.own**2)

    def smoother(self, backend: Any) -> Smoother:
        """Steps that both types hold exactly, 0 at pinned vertices."""
        with np.errstate(divide="ignore"):
            step = np.where(self.diagonal() > 0, 2.0 ** np.floor(-np.log2(self.diagonal())), 0)
            over = np.where(step > 0, 1 / step, np.inf)
        return Smoother(backend.put(self.one.graph, step), backend.put(self.one.graph, over))

    def residual_bound(self, x: Any, r: Any, step: Any) -> Any:
        """What step (r - A x) may be off: of the flow a difference, a product and a sum per neighbour, twice."""
        one = self.one
        lam = np.where(np.isinf(one.lam), 0, one.lam)
        _, off = one.dual.difference(x)
        flow = 2 * one.around(one.own * off)
        sizes = one.other * np.abs(x[one.columns]) + one.own * np.abs(x[one.rows])
        total = np.abs(r) + lam * np.abs(x) + 2 * one.around(one.own * sizes)
        return step * (flow + one.dual.gamma(one.dual.neighbours + 12) * total) + one.dual.gamma(3) * np.abs(x)


def summed(level: Level, x: Any) -> Any:
    """Sums over the aggregates, by the definition."""
    found = np.zeros((level.coarse.n_vertices, x.shape[1]))
    for u, a in enumerate(level.of):
        if a >= 0:
            found[a] += x[u]
    return found


def hold(backend: Any, kind: Kind) -> None:
    """From outputs full of NaN, between guards; the same bits on a second run."""
    level = Level(kind.make())
    one, graph, of, coarse = level.one, level.one.graph, level.of, level.coarse
    u = one.dual.gamma
    with backend.framing():
        at, aggregates = one.on(backend), backend.aggregates(graph, coarse, of)
        x, r, lam = (backend.put(graph, values) for values in (one.f, one.f0, one.lam))
        e, smoother = backend.put(coarse, level.e), level.smoother(backend)

        def nan(on: Any) -> Any:
            return backend.put(on, np.full((on.n_vertices, one.channels), np.nan))

        def held(name: str, on: Any, run: Any, expected: Any, bound: Any) -> None:
            first, again = (backend.get(on, run()) for _ in range(2))
            assert_within(first, expected, bound, name)
            assert first.tobytes() == again.tobytes(), f"{name}: other bits on the second run"

        restricted = summed(level, one.f - one.f0)
        sizes = summed(level, np.abs(one.f) + np.abs(one.f0))
        run = lambda: backend.restrict(aggregates, x, r, out=nan(coarse))  # noqa: E731
        held("restrict", coarse, run, restricted, u(len(of)) * sizes)
        added = one.f + np.where((of >= 0)[:, None], level.e[np.maximum(of, 0)], 0)
        run = lambda: backend.prolong(aggregates, e, backend.put(graph, one.f))  # noqa: E731
        held("prolong", graph, run, added, u(1) * np.abs(added))
        exact, step = level.smoother(oracle()), backend.get(graph, smoother.step)
        relaxed = oracle().relax(one.on_oracle, one.f, one.f0, one.lam, exact.step)
        bound = level.residual_bound(one.f, one.f0, step)
        held("relax", graph, lambda: backend.relax(at, x, r, lam, smoother.step, out=nan(graph)), relaxed, bound)

        # the parts, with the numbers that the fused kernels have on the way
        start = step * one.f0
        product = oracle().gradient(one.on_oracle, start, None, None, one.lam)
        unrelaxed = level.residual_bound(start, one.f0, np.ones_like(step))
        scratch = backend.empty(graph, one.channels), backend.empty(graph, one.channels)

        def descend() -> Any:
            return backend.descend(aggregates, at, r, lam, smoother, scratch=scratch, out=nan(coarse))

        left = summed(level, one.f0 - product)
        held("descend", coarse, descend, left, summed(level, unrelaxed) + u(len(of)) * summed(level, np.abs(one.f0)))
        corrected = start + added - one.f
        after = oracle().relax(one.on_oracle, corrected, one.f0, one.lam, exact.step)

        def ascend() -> Any:
            backend.descend(aggregates, at, r, lam, smoother, scratch=scratch, out=nan(coarse))
            return backend.ascend(aggregates, at, e, r, lam, smoother, scratch=scratch, out=nan(graph))

        # the correction is off by a rounding, which the sweep takes on
        moved = u(2) * (np.abs(start) + np.abs(corrected))
        spread = moved + step * (np.where(np.isinf(one.lam), 0, one.lam) * moved + 2 * one.around(one.own * (
            one.other * moved[one.columns] + one.own * moved[one.rows])))  # fmt: skip
        held("ascend", graph, ascend, after, level.residual_bound(corrected, one.f0, step) + spread)
    backend.check_guards()


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=m, id=kind.id) for kind, m in zip(PROBLEMS, MARKS, strict=True)]
)
def test_primitives(device, kind):
    hold(guarded(on(device, kind.dtype)), kind)


def test_a_stored_level_takes_one_launch_each_way(device):
    """In OpenCL on a CPU; the other backends compose the primitives."""
    backend = on(device)
    fused = type(backend).descend is not Multilevel.descend
    assert fused == (type(backend).ascend is not Multilevel.ascend) == (backend.name == "opencl")
