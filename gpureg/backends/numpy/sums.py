"""The long sums in numpy."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...arrays import FloatArray
from ...graphs.grid import AnyGraph
from ..sums import Number, Numbers
from ..types import Array, Box, Smoothness, Weighted
from .duality import NumpyDuality, conjugate
from .edges import raised


def in_box(f: FloatArray, outflow: FloatArray, f0: FloatArray, lam: FloatArray, box: Box) -> FloatArray:
    """Compute the last term of the duality gap with a box, (n, m) in float64, for s = d*y (`outflow`)."""
    s, data, here = (x.astype(np.float64) for x in (outflow, f0, f))
    low, high = (np.asarray(end, np.float64) for end in (box.low, box.high))
    known = (lam > 0) & np.isfinite(lam)
    pull = np.where(known, lam, 1).astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        free = data - s / pull
        nearest = np.clip(free, low, high)
        inside = (pull * (here - data) + s) ** 2 / (2 * pull)
        apart = here - nearest
        at_end = apart * (pull / 2 * apart + s + pull * (nearest - data))
        nothing = np.where(s > 0, s * (here - low), 0) + np.where(s < 0, s * (here - high), 0)
    found: FloatArray = np.where(known, np.where(free == nearest, inside, at_end), np.where(lam == 0, nothing, 0))
    return found


class NumpySums(NumpyDuality):
    """The long sums, and the largest difference."""

    def numbers(self, count: int) -> Numbers:
        return Numbers(np.zeros(count), count)

    def read(self, numbers: Numbers) -> FloatArray:
        values: FloatArray = numbers.values.copy()
        return values

    def max_change_into(self, out: Number, graph: AnyGraph, a: Array, b: Array) -> None:
        change = float(np.abs(a - b).max(initial=0))
        out.numbers.values[out.at] = change if np.isfinite(change) else float("inf")

    def dot_into(self, out: Number, graph: AnyGraph, a: Array, b: Array, *, over: float | Array = 1.0) -> None:
        products = a.astype(np.float64) * b
        out.numbers.values[out.at] = (products / np.asarray(over, np.float64)).sum()

    def energy_into(
        self, out: Number, weighted: Weighted, f: Array, f0: Array, lam: float | Array, model: Smoothness
    ) -> None:
        p, eps, coupled = model.p, model.eps, model.coupled
        if model.edge:
            sums = self._squared_gradient(weighted, f, coupled, self.real(eps) ** 2, p / 2)
            smoothness = sums.astype(np.float64).sum() / (2 * p)
        else:
            square = self._squared_gradient(weighted, f, coupled, 0).astype(np.float64)
            smoothness = raised(square + float(eps) ** 2, p / 2).sum() / p
        lam = np.broadcast_to(np.asarray(lam, np.float64).reshape(-1, 1), (len(f), 1))
        fidelity = (np.where(np.isinf(lam), 0, lam) * (f - f0).astype(np.float64) ** 2).sum() / 2
        out.numbers.values[out.at] = smoothness + fidelity

    def duality_gap_into(
        self,
        out: Number,
        weighted: Weighted,
        f: Array,
        y: Array,
        f0: Array,
        lam: float | Array,
        model: Smoothness,
        *,
        box: Box | None = None,
    ) -> None:
        p, eps, coupled, edge_norm = model.p, model.eps, model.coupled, model.edge
        graph, share = weighted.graph, 0.5 if edge_norm else 1.0
        d = self.difference(weighted, f)

        def norms(H: FloatArray) -> Any:
            square = (H**2).sum(axis=-1, keepdims=True) if coupled else H**2
            return square if edge_norm else self._around(graph, square)

        products = (d * y).sum(axis=-1, keepdims=True) if coupled else d * y
        if not edge_norm:
            products = self._around(graph, products)
        primal = share * raised(norms(d) + self.real(eps) ** 2, p / 2) / p
        duality = primal + conjugate(np.sqrt(norms(y)), share, p, eps) - products
        lam = self._column(lam, len(f))
        outflow = self.adjoint(weighted, y)
        if box is None:
            pinned = np.isinf(lam)
            residual = np.where(pinned, 0, lam) * (f - f0) + outflow
            unmet = np.where(pinned, 0, residual.astype(np.float64) ** 2 / (2 * np.where(pinned, 1, lam)))
        else:
            unmet = in_box(f, outflow, f0, lam, box)
        out.numbers.values[out.at] = duality.astype(np.float64).sum() + unmet.sum()
