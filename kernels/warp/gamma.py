"""What gamma makes of an edge (u, v), under the same names for its two forms. csr.py and grid.py give the edge itself.

gamma = sqrt(w), symmetric: an edge is its weight w. Directed: one value per directed edge, and an edge is the vector of
own = gamma(u, v) and other = gamma(v, u).

  Edge               the type of an edge
  difference(a, b)   d of an edge with f(u) = a, f(v) = b, up to the factor sqrt(w) that the next three bring in
  squared(e, d)      d_w(f)(u, v)^2 as a norm                                                     (eq. 4)
  derived(e, d)      d_w(f)(u, v)
  flow(e, d)         gamma(u, v) d_w(f)(u, v)
  hold, pull         gamma(u, v)^2, gamma(u, v) gamma(v, u): what alpha and beta of eq. 25 begin with
  own                gamma(u, v)
  present            whether there is an edge at all: an edge without weight has no term in a sum over edges
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
    """The type of an edge."""
    return reals.vector(real, 2) if directed else real


@functools.cache
def make(real, directed, M, G):
    """The names above for one form of gamma."""
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
