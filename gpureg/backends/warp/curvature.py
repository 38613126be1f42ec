"""The primitives of Newton's method in Warp."""

from __future__ import annotations

import warp as wp

from ...kernels.warp import dual_newton, gradient_product, hessian, shorten
from ..curvature import Bend, Curvature
from ..types import Array, Smoothness, Weighted
from .duality import WarpDuality
from .layout import channels_of


class WarpCurvature(WarpDuality, Curvature):
    """The primitives of Newton's method."""

    def _gradient_product(self, weighted: Weighted, f: Array, h: Array, by: Array, y: Array | None, out: Array) -> None:
        self._run(gradient_product.make, weighted, (channels_of(f), y is not None), [f, h, by, y], out)

    def _hessian(self, weighted: Weighted, h: Array, bend: Bend, lam: float | Array, out: Array) -> None:
        bound, model, dual = weighted.topology, bend.model, bend.y is not None
        options = (bound.access, channels_of(h), model.edge, dual, isinstance(lam, wp.array))
        graph = self._mirrored(weighted) if dual and not model.edge else bound.argument
        inputs = [graph, h, bend.f, bend.y, bend.g, bend.products, lam, model.p, model.eps, bend.floor]
        self._launch_vertices(bound.layout, hessian.make, options, inputs, out)

    def shorten(self, weighted: Weighted, y: Array, f: Array, model: Smoothness, most: Array | None) -> Array:
        self._run(shorten.make, weighted, (channels_of(y), model.edge), [f, most, model.p, model.eps], y)
        return y

    def dual_newton(self, weighted: Weighted, h: Array, bend: Bend) -> Array:
        model = bend.model
        inputs = [bend.f, h, bend.g, bend.products, model.p, model.eps, bend.floor]
        self._run(dual_newton.make, weighted, (channels_of(h), model.edge), inputs, bend.y)
        return bend.y
