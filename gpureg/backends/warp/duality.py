"""The primitives of the certified solvers in Warp."""

from __future__ import annotations

import math
from typing import Any

import warp as wp

from ...kernels.warp import combine, dot, dual_step, duality_gap, gradient, primal
from ..duality import prox_case
from ..types import Array, Conductance, Weighted
from .launching import WarpLaunches
from .layout import channels_of


def _of(over: float | Array) -> int:
    """Channels of what is divided by; 0 for a number."""
    return channels_of(over) if isinstance(over, wp.array) else 0


class WarpDuality(WarpLaunches):
    """What the certified solvers ask of a device."""

    def dot(self, weighted: Weighted, a: Array, b: Array, *, over: float | Array = 1.0) -> float:
        shape = weighted.topology.layout.shape
        options = (self.real, channels_of(a), _of(over))
        return float(self._partial(dot.make, shape, options, [a, b, over], wp.float64, math.prod(shape)).sum())

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
        M, shape = channels_of(x), weighted.topology.layout.shape
        out = self.empty(weighted.graph, M) if out is None else out
        options = (self.real, M, _of(over))
        self._launch(shape, combine.make, options, [a, x, b, y, over], out, work=math.prod(shape))
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
        M = channels_of(f)
        out = self.empty(weighted.graph, M) if out is None else out
        options, conductance = self._conductance(g, M)
        compiled_in = (M, *options, isinstance(lam, wp.array), f0 is not None)
        self._run(gradient.make, weighted, compiled_in, [f, f0, *conductance, lam], out)
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
        M = channels_of(f)
        options = (M, 1 if coupled else M, prox_case(p, eps), edge_norm)
        self._run(dual_step.make, weighted, options, [y, f, f_previous, beta, sigma, p, eps], previous)
        return previous

    def primal(self, weighted: Weighted, y: Array, f0: Array, lam: float | Array, *, out: Array | None = None) -> Array:
        M, bound = channels_of(f0), weighted.topology
        out = self.empty(weighted.graph, M) if out is None else out
        options = (bound.access, M, isinstance(lam, wp.array))
        self._launch_vertices(bound.layout, primal.make, options, [self._mirrored(weighted), y, f0, lam], out)
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
        bound, M = weighted.topology, channels_of(f)
        options = (bound.access, M, 1 if coupled else M, prox_case(p, eps), edge_norm, isinstance(lam, wp.array))
        inputs: list[Any] = [self._mirrored(weighted), f, y, f0, lam, p, eps]
        return float(
            self._partial(duality_gap.make, bound.layout.shape, options, inputs, wp.float64, bound.layout.work).sum()
        )
