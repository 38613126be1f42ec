"""The primitives of the certified solvers in OpenCL."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...graphs.grid import AnyGraph
from ..duality import ProxCase, momenta, prox_case
from ..sums import Ratio, ratios
from ..types import Array, Box, Conductance, Smoothness, Weighted
from .buffers import Function
from .launching import OpenCLLaunches

# PROX of ``prox.cl``
_PROX: dict[ProxCase, int] = {"newton": 0, "ball": 1, "square": 2, "power": 3}


def norm_options(channels: int, model: Smoothness) -> tuple[str, ...]:
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

    def _combine(
        self,
        graph: AnyGraph,
        a: float | Ratio,
        x: Array,
        b: float | Ratio,
        y: Array,
        over: float | Array,
        out: Array,
    ) -> None:
        overs, options = self._over(over)
        numbers, factors, places = ratios(a, b)
        options = (f"-DM={x.channels}", *options, *(() if numbers is None else ("-DRATIOS",)))
        values = self._nothing if numbers is None else numbers.values
        args = [self.real(factors[0]), x.buffer, self.real(factors[1]), y.buffer, *overs]
        self._run("combine", self._bare(graph), [*args, values, *map(np.int32, places), out.buffer], options)

    def _gradient(
        self, weighted: Weighted, f: Array, f0: Array | None, g: Conductance, lam: float | Array, out: Array
    ) -> None:
        conductance, g_options = self._g(g, f.channels)
        lams, lam_options = self._lam(lam)
        data, options = (self._nothing, ()) if f0 is None else (f0.buffer, ("-DF0",))
        args = [f.buffer, data, *conductance, *lams, out.buffer]
        options = (f"-DM={f.channels}", *g_options, *lam_options, *options)
        self._run("gradient", weighted, args, options, sums=f.channels)

    def dual_step(
        self,
        weighted: Weighted,
        y: Array,
        previous: Array,
        f: Array,
        f_previous: Array,
        model: Smoothness,
        *,
        beta: float | tuple[float, float],
        sigma: float | Array,
    ) -> Array:
        each = model.edge or prox_case(model.p, model.eps) == "square"  # no norm over the edges of a vertex
        betas = [self._real(x) for x in momenta(beta)]
        sigmas, sigma_options = self._number(sigma, "-DSIGMA_ARRAY")
        numbers = [*betas, *sigmas, self.real(model.p), self.real(model.eps)]
        args = [y.buffer, f.buffer, f_previous.buffer, *numbers, previous.buffer]
        options = (*norm_options(f.channels, model), *sigma_options)
        self._run("dual_step", weighted, args, options, sums=0 if each else f.channels, for_edges=True)
        return previous

    def _box(self, box: Box | None) -> tuple[list[Any], tuple[str, ...]]:
        """Return the kernel arguments for a box, or for none, and the build options."""
        if box is None:
            return [self._nothing, self._nothing], ()
        return [box.low.buffer, box.high.buffer], ("-DBOX",)

    def _proximal(
        self,
        weighted: Weighted,
        f: Array,
        y: Array,
        f0: Array,
        lam: float | Array,
        tau: float | Array,
        box: Box | None,
        out: Array,
    ) -> None:
        (lams, lam_options), (taus, tau_options) = self._lam(lam), self._number(tau, "-DTAU_ARRAY")
        ends, box_options = self._box(box)
        args = [f.buffer, y.buffer, f0.buffer, *lams, *taus, *ends, out.buffer]
        options = (f"-DM={f.channels}", *lam_options, *tau_options, *box_options)
        self._run("proximal", weighted, args, options, sums=f.channels)

    def _primal(self, weighted: Weighted, y: Array, f0: Array, lam: float | Array, out: Array) -> None:
        lams, options = self._lam(lam)
        args, options = [y.buffer, f0.buffer, *lams, out.buffer], (f"-DM={f0.channels}", *options)
        self._run("primal", weighted, args, options, sums=f0.channels)
