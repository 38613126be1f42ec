"""Find out whether polygonal curves are open or closed: :func:`ends_of`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..arrays import FloatArray
from ..checks import flag

Why = Literal["given", "source", "repeated", "near", "apart", "along", "few"]

# The first point is repeated at the end if the distance from first to last is at most this, in mean segments.
_SAME = 1e-6
# A curve is closed if the distance of its ends is at most this factor times this quantile of its segments' lengths.
_NEAR, _QUANTILE = 2.0, 0.95
# It is open if the ends are further apart in one coordinate than this factor times the largest step there: strong
# noise in another coordinate, such as the height or the value over time, makes all segments long.
_STEPS = 4.0


@dataclass(frozen=True)
class Ends:
    """Whether a polygonal curve is closed, and the reason.

    Attributes
    ----------
    closed : bool
        Whether the last vertex is joined to the first.
    repeated : bool
        Whether the input repeats the first vertex at the end; the copy does not count as a vertex.
    gap : float
        The distance from the last vertex to the first in the input.
    why : {"given", "source", "repeated", "near", "apart", "along", "few"}
        The reason: the caller's choice; the file; the first vertex repeated at the end; ends near each other; ends far
        apart; ends far apart in one coordinate; fewer vertices than a closed curve needs.
    """

    closed: bool
    repeated: bool
    gap: float
    why: Why

    def describe(self) -> str:
        """Describe in one line whether the curve is closed, and why."""
        kind = "closed" if self.closed else "open"
        apart = f"its ends are {self.gap:.3g} apart"
        rule = f"{_NEAR:g} times the {100 * _QUANTILE:g} % quantile of the segments' lengths"
        return {
            "given": f"{kind} as given; {apart}",
            "source": f"{kind} as the file says; {apart}",
            "repeated": f"{kind}: its first vertex is repeated at the end",
            "near": f"{kind}: {apart}, at most {rule}",
            "apart": f"{kind}: {apart}, more than {rule}",
            "along": f"{kind}: {apart}, in one coordinate more than {_STEPS:g} times the largest step there",
            "few": f"{kind}: it has fewer than three vertices; {apart}",
        }[self.why]


def ends_of(points: FloatArray, closed: bool | None = None) -> Ends:
    """Find out whether a curve is closed.

    Parameters
    ----------
    points : (n, d) float array
        The vertices in order, n >= 1.
    closed : bool, optional
        The caller's choice. None: closed if the first vertex is repeated at the end (to 1e-6 of the mean segment), or
        if the distance of the ends is at most twice the 95 % quantile of the segments' lengths, and in each coordinate
        at most four times the largest step; many outlines do not repeat the first vertex. A curve of fewer than three
        vertices is open.

    Raises
    ------
    TypeError
        `closed` is not True, False or None.
    """
    if closed is not None:
        closed = flag("closed", closed)
    # points that are not finite are refused elsewhere
    with np.errstate(invalid="ignore"):
        gap = float(np.linalg.norm(points[-1] - points[0]))
        segments = np.linalg.norm(np.diff(points, axis=0), axis=1)
    again = len(points) > 1 and gap <= _SAME * float(segments.mean())
    if closed is not None:
        return Ends(closed, closed and again, gap, "given")
    # without the repeated vertex
    n = len(points) - again
    if n < 3:
        return Ends(False, False, gap, "few")
    if again:
        return Ends(True, True, gap, "repeated")
    # repeated vertices say nothing of the distances
    proper = segments[segments > _SAME * segments.mean()]
    near = gap <= _NEAR * float(np.quantile(proper, _QUANTILE)) if len(proper) else True
    if not near:
        return Ends(False, False, gap, "apart")
    along = np.abs(points[-1] - points[0]) > _STEPS * np.abs(np.diff(points, axis=0)).max(axis=0)
    return Ends(False, False, gap, "along") if along.any() else Ends(True, False, gap, "near")
