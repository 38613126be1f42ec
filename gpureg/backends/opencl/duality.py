"""The primitives of the certified solvers in OpenCL."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...graphs.grid import AnyGraph
from ..duality import ProxCase, prox_case
from ..types import Array, Conductance, Smoothness, Weighted
from .buffers import Function
from .launching import OpenCLLaunches

# PROX of ``prox.cl``
_PROX: dict[ProxCase, int] = {"newton": 0, "ball": 1, "square": 2, "power": 3}


def _norms(channels: int, model: Smoothness) -> tuple[str, ...]:
    """Return the build options of a kernel that computes norms."""
    prox = _PROX[prox_case(model.p, model.eps)]
    options = (f"-DM={channels}", f"-DG={model.norms(channels)}", f"-DPROX={prox}")
    return (*options, "-DEDGE_NORM") if model.edge else options


class OpenCLDuality(OpenCLLaunches):
    """The primitives of the certified solvers."""

    def _bare(self, graph: AnyGraph) -> Weighted:
        """Return the graph without weights, for a kernel that does not read them."""
        return Weighted(graph, self._topology(graph), None)

    def _over(self, over: float | Array) -> tuple[list[Any], tuple[str, ...]]:
        """Return the kernel arguments OVER_ARGS, and the build options."""
        return self._number(over, f"-DOVER={over.channels}" if isinstance(over, Function) else "")

    def max_change(self, graph: AnyGraph, a: Array, b: Array) -> float:
        args, options = [a.buffer, b.buffer], (f"-DM={a.channels}",)
        return float(self._partial("max_change", self._bare(graph), args, options, self.dtype).max(initial=0))

    def dot(self, graph: AnyGraph, a: Array, b: Array, *, over: float | Array = 1.0) -> float:
        overs, over_options = self._over(over)
        args, options = [a.buffer, b.buffer, *overs], (f"-DM={a.channels}", *over_options)
        sums = self._partial("dot", self._bare(graph), args, options, self._sum_type)
        return float(sums.astype(np.float64).sum())

    def _combine(
        self, graph: AnyGraph, a: float, x: Array, b: float, y: Array, over: float | Array, out: Array
    ) -> None:
        overs, options = self._over(over)
        args = [self.real(a), x.buffer, self.real(b), y.buffer, *overs, out.buffer]
        self._run("combine", self._bare(graph), args, (f"-DM={x.channels}", *options))

    def _gradient(
        self, weighted: Weighted, f: Array, f0: Array | None, g: Conductance, lam: float | Array, out: Array
    ) -> None:
        conductance, g_options = self._g(g, f.channels)
        lams, lam_options = self._lam(lam)
        data, options = (self._nothing, ()) if f0 is None else (f0.buffer, ("-DF0",))
        args = [f.buffer, data, *conductance, *lams, out.buffer]
        self._run("gradient", weighted, args, (f"-DM={f.channels}", *g_options, *lam_options, *options))

    def dual_step(
        self,
        weighted: Weighted,
        y: Array,
        previous: Array,
        f: Array,
        f_previous: Array,
        model: Smoothness,
        *,
        beta: float,
        sigma: float,
    ) -> Array:
        numbers = [self.real(x) for x in (sigma, model.p, model.eps)]
        args = [y.buffer, f.buffer, f_previous.buffer, self._real(beta), *numbers, previous.buffer]
        self._run("dual_step", weighted, args, _norms(f.channels, model))
        return previous

    def _primal(self, weighted: Weighted, y: Array, f0: Array, lam: float | Array, out: Array) -> None:
        lams, options = self._lam(lam)
        self._run("primal", weighted, [y.buffer, f0.buffer, *lams, out.buffer], (f"-DM={f0.channels}", *options))

    def duality_gap(
        self, weighted: Weighted, f: Array, y: Array, f0: Array, lam: float | Array, model: Smoothness
    ) -> float:
        lams, lam_options = self._lam(lam)
        args = [f.buffer, y.buffer, f0.buffer, *lams, self.real(model.p), self.real(model.eps)]
        options = (*_norms(f.channels, model), *lam_options)
        return float(self._partial("duality_gap", weighted, args, options, self._sum_type).astype(np.float64).sum())
