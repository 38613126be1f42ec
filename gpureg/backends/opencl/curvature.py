"""The primitives of Newton's method in OpenCL."""

from __future__ import annotations

from typing import Any

from ..curvature import Bend, Curvature
from ..types import Array, Smoothness, Weighted
from .duality import OpenCLDuality


class OpenCLCurvature(OpenCLDuality, Curvature):
    """The primitives of Newton's method."""

    def _gradient_product(self, weighted: Weighted, f: Array, h: Array, by: Array, y: Array | None, out: Array) -> None:
        values, options = (self._nothing, ()) if y is None else (y.buffer, ("-DY",))
        args = [f.buffer, h.buffer, by.buffer, values, out.buffer]
        self._run("gradient_product", weighted, args, (f"-DM={f.channels}", *options), sums=2)

    def _bent(self, bend: Bend) -> tuple[list[Any], list[Any], tuple[str, ...]]:
        """Return the buffers of g and the products, the numbers p, eps and floor, and the build options."""
        options: tuple[str, ...] = (f"-DM={bend.f.channels}",)
        options = (*options, "-DEDGE_NORM") if bend.model.edge else options
        buffers = [self._nothing if x is None else x.buffer for x in (bend.g, bend.products)]
        return buffers, [self.real(x) for x in (bend.model.p, bend.model.eps, bend.floor)], options

    def _hessian(self, weighted: Weighted, h: Array, bend: Bend, lam: float | Array, out: Array) -> None:
        buffers, numbers, options = self._bent(bend)
        lams, lam_options = self._lam(lam)
        y = self._nothing if bend.y is None else bend.y.buffer
        options = (*options, *lam_options, *(() if bend.y is None else ("-DY",)))
        args = [h.buffer, bend.f.buffer, y, *buffers, *lams, *numbers, out.buffer]
        self._run("hessian", weighted, args, options, sums=h.channels)

    def shorten(self, weighted: Weighted, y: Array, f: Array, model: Smoothness, most: Array | None) -> Array:
        options = (f"-DM={y.channels}", "-DEDGE_NORM") if model.edge else (f"-DM={y.channels}",)
        numbers = [self.real(x) for x in (model.p, model.eps)]
        args = [f.buffer, self._nothing if most is None else most.buffer, *numbers, y.buffer]
        self._run("shorten", weighted, args, options, sums=0 if model.edge else 1, for_edges=True)
        return y

    def dual_newton(self, weighted: Weighted, h: Array, bend: Bend) -> Array:
        assert bend.y is not None
        buffers, numbers, options = self._bent(bend)
        args = [bend.f.buffer, h.buffer, *buffers, *numbers, bend.y.buffer]
        self._run("dual_newton", weighted, args, options, sums=0, for_edges=True)
        return bend.y
