"""The primitives of the certified solvers in Warp."""

from __future__ import annotations

import math

import warp as wp

from ...graphs.grid import AnyGraph
from ...kernels.warp import combine, dual_step, gradient, primal, proximal
from ..duality import momenta, prox_case
from ..sums import Ratio, ratios
from ..types import Array, Box, Conductance, Smoothness, Weighted
from .launching import WarpLaunches
from .layout import channels_of


def over_channels(over: float | Array) -> int:
    """Return the channels of the divisor; 0 for a number."""
    return channels_of(over) if isinstance(over, wp.array) else 0


class WarpDuality(WarpLaunches):
    """The primitives of the certified solvers."""

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
        shape = self._layout(graph).shape
        numbers, factors, places = ratios(a, b)
        options = (self.real, channels_of(x), over_channels(over), numbers is not None)
        values = None if numbers is None else numbers.values
        inputs = [factors[0], x, factors[1], y, over, values, wp.vec4i(*places)]
        self._launch(shape, combine.make, options, inputs, out, work=math.prod(shape))

    def _gradient(
        self, weighted: Weighted, f: Array, f0: Array | None, g: Conductance, lam: float | Array, out: Array
    ) -> None:
        M = channels_of(f)
        options, conductance = self._conductance(g, M)
        compiled_in = (M, *options, isinstance(lam, wp.array), f0 is not None)
        self._run(gradient.make, weighted, compiled_in, [f, f0, *conductance, lam], out)

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
        M = channels_of(f)
        options = (M, model.norms(M), prox_case(model.p, model.eps), model.edge, isinstance(sigma, wp.array))
        inputs = [y, f, f_previous, *momenta(beta), sigma, model.p, model.eps]
        self._run(dual_step.make, weighted, options, inputs, previous)
        return previous

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
        bound = weighted.topology
        arrays = (isinstance(lam, wp.array), isinstance(tau, wp.array), box is not None)
        low, high = (None, None) if box is None else (box.low, box.high)
        inputs = [self._mirrored(weighted), f, y, f0, lam, tau, low, high]
        self._launch_vertices(bound.layout, proximal.make, (bound.access, channels_of(f0), *arrays), inputs, out)

    def _primal(self, weighted: Weighted, y: Array, f0: Array, lam: float | Array, out: Array) -> None:
        bound = weighted.topology
        options = (bound.access, channels_of(f0), isinstance(lam, wp.array))
        self._launch_vertices(bound.layout, primal.make, options, [self._mirrored(weighted), y, f0, lam], out)
