"""The factors of an edge (u, v), under the same names for both forms of gamma; csr.py and grid.py read the edge.

By default gamma = sqrt(w), and an edge is its weight w. `directed`: one value per directed edge, and an edge is the
vector of own = gamma(u, v) and other = gamma(v, u).

  Edge               the type of an edge
  difference(a, b)   d of an edge with f(u) = a, f(v) = b, without the factor sqrt(w); d of the next three
  squared(e, d)      d_w(f)(u, v)^2 as a norm                                                     (eq. 4)
  derived(e, d)      d_w(f)(u, v)
  flow(e, d)         gamma(u, v) d_w(f)(u, v)
  hold, pull         gamma(u, v)^2 and gamma(u, v) gamma(v, u), for alpha and beta of eq. 25
  own                gamma(u, v)
  present            whether the edge exists; a sum over edges skips edges of weight 0
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from . import reals


@dataclass(frozen=True, eq=False)
class Gamma:
    """The names above, for functions of M channels with G gradient norms."""

    difference: Any
    squared: Any
    derived: Any
    flow: Any
    hold: Any
    pull: Any
    own: Any
    present: Any


@functools.cache
def edge(real, directed):
    """Return the type of an edge."""
    return reals.vector(real, 2) if directed else real


@functools.cache
def make(real, directed, M, G):
    """Make the names above for one form of gamma."""
    Edge = edge(real, directed)
    channels = reals.make(real, M, G)
    function, norm, square = channels.function, channels.norm, channels.squared

    if directed:

        @wp.func
        def difference(e: Edge, a: function, b: function) -> function:
            return e[1] * b - e[0] * a

        @wp.func
        def squared(e: Edge, d: function) -> norm:
            return square(d)

        @wp.func
        def derived(e: Edge, d: function) -> function:
            return d

        @wp.func
        def flow(e: Edge, d: function) -> function:
            return e[0] * d

        @wp.func
        def hold(e: Edge) -> real:
            return e[0] * e[0]

        @wp.func
        def pull(e: Edge) -> real:
            return e[0] * e[1]

        @wp.func
        def own(e: Edge) -> real:
            return e[0]

        @wp.func
        def present(e: Edge) -> bool:
            return e[0] > real(0.0) or e[1] > real(0.0)

    else:

        @wp.func
        def difference(e: real, a: function, b: function) -> function:
            return b - a

        @wp.func
        def squared(e: real, d: function) -> norm:
            return e * square(d)

        @wp.func
        def derived(e: real, d: function) -> function:
            return wp.sqrt(e) * d

        @wp.func
        def flow(e: real, d: function) -> function:
            return e * d

        @wp.func
        def hold(e: real) -> real:
            return e

        @wp.func
        def pull(e: real) -> real:
            return e

        @wp.func
        def own(e: real) -> real:
            return wp.sqrt(e)

        @wp.func
        def present(e: real) -> bool:
            return e > real(0.0)

    return Gamma(difference, squared, derived, flow, hold, pull, own, present)
