"""The primitives of the certified solvers in OpenCL."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..duality import ProxCase, prox_case
from ..types import Array, Conductance, Weighted
from .buffers import Function
from .launching import OpenCLLaunches

# PROX of ``prox.cl``
_PROX: dict[ProxCase, int] = {"newton": 0, "ball": 1, "square": 2, "power": 3}


def _norms(channels: int, p: float, eps: float, coupled: bool, edge_norm: bool) -> tuple[str, ...]:
    """Build options of a kernel that takes norms."""
    G = 1 if coupled else channels
    return (
        f"-DM={channels}",
        f"-DG={G}",
        f"-DPROX={_PROX[prox_case(p, eps)]}",
        *(("-DEDGE_NORM",) if edge_norm else ()),
    )


class OpenCLDuality(OpenCLLaunches):
    """What the certified solvers ask of a device."""

    def _over(self, over: float | Array) -> tuple[list[Any], tuple[str, ...]]:
        """The arguments OVER_ARGS."""
        return self._number(over, f"-DOVER={over.channels}" if isinstance(over, Function) else "")

    def dot(self, weighted: Weighted, a: Array, b: Array, *, over: float | Array = 1.0) -> float:
        overs, options = self._over(over)
        bare = Weighted(weighted.graph, weighted.topology, None)
        args = [a.buffer, b.buffer, *overs]
        sums = self._partial("dot", bare, args, (f"-DM={a.channels}", *options), self._sum_type)
        return float(sums.astype(np.float64).sum())

    def combine(
        self,
        weighted: Weighted,
        a: float,
        x: Array,
        b: float,
        y: Array,
        *,
        over: float | Array = 1.0,
        out: Array | None = None,
    ) -> Array:
        out = self.empty(weighted.graph, x.channels) if out is None else out
        overs, options = self._over(over)
        bare = Weighted(weighted.graph, weighted.topology, None)
        args = [self.real(a), x.buffer, self.real(b), y.buffer, *overs, out.buffer]
        self._run("combine", bare, args, (f"-DM={x.channels}", *options))
        return out

    def gradient(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array | None,
        g: Conductance,
        lam: float | Array,
        *,
        out: Array | None = None,
    ) -> Array:
        out = self.empty(weighted.graph, f.channels) if out is None else out
        conductance, g_options = self._g(g, f.channels)
        lams, lam_options = self._lam(lam)
        data, options = (self._nothing, ()) if f0 is None else (f0.buffer, ("-DF0",))
        args = [f.buffer, data, *conductance, *lams, out.buffer]
        self._run("gradient", weighted, args, (f"-DM={f.channels}", *g_options, *lam_options, *options))
        return out

    def dual_step(
        self,
        weighted: Weighted,
        y: Array,
        previous: Array,
        f: Array,
        f_previous: Array,
        *,
        beta: float,
        sigma: float,
        p: float,
        eps: float,
        coupled: bool,
        edge_norm: bool = False,
    ) -> Array:
        numbers = [self.real(beta), self.real(sigma), self.real(p), self.real(eps)]
        args = [y.buffer, f.buffer, f_previous.buffer, *numbers, previous.buffer]
        self._run("dual_step", weighted, args, _norms(f.channels, p, eps, coupled, edge_norm))
        return previous

    def primal(self, weighted: Weighted, y: Array, f0: Array, lam: float | Array, *, out: Array | None = None) -> Array:
        out = self.empty(weighted.graph, f0.channels) if out is None else out
        lams, options = self._lam(lam)
        self._run("primal", weighted, [y.buffer, f0.buffer, *lams, out.buffer], (f"-DM={f0.channels}", *options))
        return out

    def duality_gap(
        self,
        weighted: Weighted,
        f: Array,
        y: Array,
        f0: Array,
        lam: float | Array,
        *,
        p: float,
        eps: float,
        coupled: bool,
        edge_norm: bool = False,
    ) -> float:
        lams, lam_options = self._lam(lam)
        args = [f.buffer, y.buffer, f0.buffer, *lams, self.real(p), self.real(eps)]
        options = (*_norms(f.channels, p, eps, coupled, edge_norm), *lam_options)
        return float(self._partial("duality_gap", weighted, args, options, self._sum_type).astype(np.float64).sum())
