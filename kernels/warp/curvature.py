"""What kernels of Newton's method share: the numbers of a group with the edge norm.

q = |df|^2 + eps^2 over the channels of an edge, at least `tiny`, so that no quotient overflows.
  g(q, p, floor)   share q^((p - 2)/2), at least share floor
  factor(q, p)     of the inner products: share (2 - p) q^((p - 4)/2); with `dual` (2 - p)/q
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from . import reals


@dataclass(frozen=True, eq=False)
class Numbers:
    """The functions above, and the least q."""

    g: Any
    factor: Any
    tiny: Any


@functools.cache
def make(real, dual):
    """Make the functions for one type, with or without a dual variable."""
    raise_ = reals.raising(real)
    tiny = reals.smallest(real)

    @wp.func
    def g(q: real, p: real, floor: real) -> real:
        return real(0.5) * wp.max(raise_(q, (p - real(2)) / real(2)), floor)

    if dual:

        @wp.func
        def factor(q: real, p: real) -> real:
            return (real(2) - p) / q

    else:

        @wp.func
        def factor(q: real, p: real) -> real:
            return real(0.5) * (real(2) - p) * raise_(q, (p - real(4)) / real(2))

    return Numbers(g, factor, tiny)
