"""Find points that lie alone, or off the surface or curve of their neighbours: :func:`outliers`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from .quadrics import frames, in_pieces, solved, terms

# Nearest other points that a point is compared with, and those whose mean distance tells how dense they lie.
_AROUND, _DENSE = 18, 8
# A point is alone if that mean distance is larger than this many times the median among its neighbours, on a curve and
# on a surface: on a curve, random points have wider gaps.
_ALONE = {2: 5.0, 3: 3.0}
# A point is off the surface if its height over it is larger than this many deviations of the heights around it, and
# than this part of the mean distance, on a curve and on a surface: a corner of a curve is off its parabola.
_DEVIATIONS, _PART = 6.0, {2: 1.0, 3: 0.5}
# Rounds of the robust fit: weights 1/(1 + (r/2s)^2) of residuals r with deviation s.
_ROBUST = 3
# The standard deviation of a normal distribution over its median absolute deviation.
_MAD = 1.4826


def outliers(points: FloatArray, *, surface: bool = True) -> npt.NDArray[np.bool_]:
    """Find the outliers of points without repetitions, (n,): in a second round those of the first take no part.

    Parameters
    ----------
    points : (n, d) float array
        In the plane or in space.
    surface : bool, default True
        Whether points off the curve or surface of their neighbours are outliers, or only those that lie alone.
    """
    from scipy.spatial import cKDTree

    n = len(points)
    bad = np.zeros(n, bool)
    if n < _AROUND + 2:
        return bad
    near, distance = _others(cKDTree(points), points, np.arange(n), np.arange(n))
    gap, part = _ALONE[points.shape[1]], _PART[points.shape[1]]
    dense, height = distance[:, :_DENSE].mean(axis=1), np.zeros(n)
    if surface:
        height = np.abs(_heights(points, np.arange(n), near))
    for last in (False, True):
        alone = dense > gap * np.median(dense[near], axis=1)
        deviation = _MAD * np.median(height[near], axis=1)
        # 18 heights alone would raise false alarms
        deviation = np.maximum(deviation, np.median(deviation[near], axis=1))
        off = (height > _DEVIATIONS * deviation) & (height > part * np.median(dense[near], axis=1))
        bad = alone | off
        good = np.flatnonzero(~bad)
        if last or not bad.any() or len(good) < _AROUND + 2:
            break
        again = np.flatnonzero(bad | bad[near].any(axis=1))
        near[again], distance = _others(cKDTree(points[good]), points, again, good)
        dense[again] = distance[:, :_DENSE].mean(axis=1)
        if surface:
            height[again] = np.abs(_heights(points, again, near[again]))
    return bad


def _others(tree: object, points: FloatArray, rows: IntArray, among: IntArray) -> tuple[IntArray, FloatArray]:
    """Find the nearest other points of the rows, by their numbers (q, 18), and the distances; `tree` holds `among`."""
    distance, near = tree.query(points[rows], _AROUND + 1, workers=-1)  # type: ignore[attr-defined]
    near = among[near]
    # the point itself, if it is there, goes last
    order = np.argsort(near == rows[:, None], axis=1, kind="stable")[:, :_AROUND]
    return np.take_along_axis(near, order, axis=1), np.take_along_axis(distance, order, axis=1)


def _heights(points: FloatArray, rows: IntArray, near: IntArray) -> FloatArray:
    """Compute the heights (q,) of the rows over robust quadrics through their neighbours `near`, (q, k)."""
    d = points.shape[1]

    def work(part: slice) -> FloatArray:
        u = rows[part]
        away = points[near[part]] - points[u][:, None]
        unit = np.sqrt((away**2).sum(axis=2).max(axis=1))
        local = np.divide(away, unit[:, None, None], out=np.zeros_like(away), where=unit[:, None, None] > 0)
        w = np.ones(local.shape[:2])
        found = np.zeros(len(u))
        for _ in range(_ROBUST):
            middle, axes = frames(local, w)
            turned = (local - middle[:, None]) @ axes
            own = -(middle[:, None] @ axes)[:, 0]
            scale = np.sqrt((turned[:, :, 1:] ** 2).mean(axis=(1, 2)))
            scale[scale == 0] = 1
            A = terms(turned[:, :, 1:] / scale[:, None, None], turned[:, :, 0])
            fit = solved(A, w, np.full(A.shape[1] - 1, 1e-3))
            left = A[:, -1] - (fit[:, None] @ A[:, :-1])[:, 0]
            # a point far from its neighbours is compared with the edge of their quadric
            place = np.clip(own[:, 1:] / scale[:, None], -1.5, 1.5)
            found = own[:, 0] - (terms(place[:, None], own[:, :1])[:, :-1, 0] * fit).sum(axis=1)
            deviation = _MAD * np.median(np.abs(left), axis=1) + np.finfo(float).tiny
            w = 1 / (1 + (left / (2 * deviation[:, None])) ** 2)
        over: FloatArray = found * unit
        return over

    return in_pieces(work, len(rows), near.shape[1] * (d + 8))
