"""The primitives of Newton's method, in numpy."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ...graphs.grid import AnyGraph
from ..curvature import Bend, Curvature, least_square
from ..types import Array, Smoothness, Weighted
from .duality import NumpyDuality


class NumpyCurvature(NumpyDuality, Curvature):
    """The primitives of Newton's method."""

    def _gradient_product(self, weighted: Weighted, f: Array, h: Array, by: Array, y: Array | None, out: Array) -> None:
        df, dh = self.difference(weighted, f), self.difference(weighted, h)
        products = [df * dh] if y is None else [df * dh, y * dh]
        sums = [self._around(weighted.graph, x.sum(axis=-1, keepdims=True)) for x in products]
        out[...] = by * np.concatenate(sums, axis=1)

    def _hessian(self, weighted: Weighted, h: Array, bend: Bend, lam: float | Array, out: Array) -> None:
        graph, model = weighted.graph, bend.model
        df, dh = self.difference(weighted, bend.f), self.difference(weighted, h)
        across: FloatArray | None = None
        if model.edge:
            g, factor = _of_edges(df, bend)
            along: FloatArray = factor * (df * dh).sum(axis=-1, keepdims=True)
            if bend.y is not None:
                across = factor * (bend.y * dh).sum(axis=-1, keepdims=True)
        else:
            g, products = self._of_vertices(graph, bend)
            along = products[..., :1]
            across = products[..., 1:] if bend.y is not None else None
        bent: FloatArray = df * along
        if across is not None:
            assert bend.y is not None
            bent = (bend.y * along + df * across) / 2
        column = self._column(lam, len(h))
        pinned = np.isinf(column)
        total = np.where(pinned, 0, column) * h + self.adjoint(weighted, (g * dh - bent).astype(self.dtype))
        out[...] = np.where(pinned, 0, total)

    def _of_vertices(self, graph: AnyGraph, bend: Bend) -> tuple[FloatArray, FloatArray]:
        """Return g and the products at the edges that start at each vertex."""
        assert bend.g is not None and bend.products is not None
        return self._at_edges(graph, bend.g), self._at_edges(graph, bend.products)

    def shorten(self, weighted: Weighted, y: Array, f: Array, model: Smoothness, most: Array | None) -> Array:
        square = (y**2).sum(axis=-1, keepdims=True)
        if model.edge:
            length = np.sqrt(square)
            q = (self.difference(weighted, f) ** 2).sum(axis=-1, keepdims=True) + self.real(model.eps) ** 2
            longest = 0.5 * q ** ((model.p - 1) / 2)
        else:
            graph = weighted.graph
            length = np.sqrt(self._at_edges(graph, self._around(graph, square)))
            assert most is not None
            longest = self._at_edges(graph, most)
        y *= np.where(length > longest, longest / np.where(length > 0, length, 1), 1)
        return y

    def dual_newton(self, weighted: Weighted, h: Array, bend: Bend) -> Array:
        graph = weighted.graph
        df, dh = self.difference(weighted, bend.f), self.difference(weighted, h)
        if bend.model.edge:
            g, factor = _of_edges(df, bend)
            along = factor * (df * dh).sum(axis=-1, keepdims=True)
        else:
            g, products = self._of_vertices(graph, bend)
            along = products[..., :1]
        assert bend.y is not None
        bend.y[...] = g * (df + dh) - along * bend.y
        return bend.y


def _of_edges(df: FloatArray, bend: Bend) -> tuple[FloatArray, FloatArray]:
    """Return share q^((p-2)/2) and the factor of the inner products, at each edge."""
    p, tiny = bend.model.p, least_square(df.dtype)
    q = np.maximum((df**2).sum(axis=-1, keepdims=True) + df.dtype.type(bend.model.eps) ** 2, tiny)
    g = np.maximum(q ** ((p - 2) / 2), bend.floor)
    if bend.y is not None:
        return g / 2, (2 - p) / q
    return g / 2, (2 - p) / 2 * q ** ((p - 4) / 2)
