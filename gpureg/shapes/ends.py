"""Tell open from closed polygonal curves: :func:`ends_of`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..arrays import FloatArray
from ..checks import flag

Why = Literal["given", "source", "repeated", "near", "apart", "few"]

# The first point is repeated at the end if the last is no further from it than this, in mean segments.
_SAME = 1e-6
# A curve is closed if its ends are no further apart than so many times this quantile of its segments' lengths.
_NEAR, _QUANTILE = 2.0, 0.95


@dataclass(frozen=True)
class Ends:
    """Whether a polygonal curve is closed, and how that is known.

    Attributes
    ----------
    closed : bool
        Whether the last vertex is joined to the first.
    repeated : bool
        Whether the curve came with its first vertex repeated at the end, which is no vertex of its own.
    gap : float
        The distance of the last vertex from the first, as they came.
    why : {"given", "source", "repeated", "near", "apart", "few"}
        What says so: the caller; the file's format; the first vertex repeated at the end; ends that are near each
        other; ends that are apart; fewer vertices than a closed curve has.
    """

    closed: bool
    repeated: bool
    gap: float
    why: Why

    def describe(self) -> str:
        """Say whether the curve is closed and why, in a line."""
        kind = "closed" if self.closed else "open"
        apart = f"its ends are {self.gap:.3g} apart"
        rule = f"{_NEAR:g} times the {100 * _QUANTILE:g} % quantile of the segments' lengths"
        return {
            "given": f"{kind} as given; {apart}",
            "source": f"{kind} as the file says; {apart}",
            "repeated": f"{kind}: its first vertex is repeated at the end",
            "near": f"{kind}: {apart}, at most {rule}",
            "apart": f"{kind}: {apart}, more than {rule}",
            "few": f"{kind}: it has fewer than three vertices; {apart}",
        }[self.why]


def ends_of(points: FloatArray, closed: bool | None = None) -> Ends:
    """Find out whether a curve is closed.

    Parameters
    ----------
    points : (n, d) float array
        The vertices in order, n >= 1.
    closed : bool, optional
        What the caller says. None: closed if the first vertex is repeated at the end (to 1e-6 of the mean segment), or
        if the distance of the ends is at most twice the 95 % quantile of the segments' lengths. Outlines seldom repeat
        their first vertex. A curve of fewer than three vertices is open.

    Raises
    ------
    TypeError
        A `closed` that is neither True, False nor None.
    """
    if closed is not None:
        closed = flag("closed", closed)
    # what is not finite is refused elsewhere
    with np.errstate(invalid="ignore"):
        gap = float(np.linalg.norm(points[-1] - points[0]))
        segments = np.linalg.norm(np.diff(points, axis=0), axis=1)
    again = len(points) > 1 and gap <= _SAME * float(segments.mean())
    if closed is not None:
        return Ends(closed, closed and again, gap, "given")
    # without the repeated one
    n = len(points) - again
    if n < 3:
        return Ends(False, False, gap, "few")
    if again:
        return Ends(True, True, gap, "repeated")
    near = gap <= _NEAR * float(np.quantile(segments, _QUANTILE))
    return Ends(near, False, gap, "near" if near else "apart")
