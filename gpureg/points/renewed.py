"""Compute the normals of moved points again, on the side of the old ones: :func:`renewed_normals`."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from .normals import nearest, planes
from .report import PointDenoising

# Neighbours for planes, where the filter had no normals, and for the side.
_PLANE, _SIDE = 18, 8
# An old normal closer than this cosine to the tangent plane leaves the side to its neighbours.
_LEAST = 0.3


def renewed_normals(found: PointDenoising, old: FloatArray) -> FloatArray | None:
    """Compute unit normals of the denoised points, (n, d); None if they are too few for planes.

    The normals of points that did not move are the old ones, as for outliers, but for the filters of positions those
    of all points are new. They point to the side of the old normals, of which those of length 0 or that are not finite
    do not count. `old` is (n, d).
    """
    if not found.displacement.any():
        return old
    points, normals = found.points, found.normals
    n, d = points.shape
    if d not in (2, 3) or n <= d:
        return None
    if normals is None:
        normals = planes(points, nearest(points, _PLANE)).normals
    length = np.linalg.norm(old, axis=1, keepdims=True)
    known = np.isfinite(length) & (length > 0)
    unit = np.divide(old, length, out=np.zeros((n, d)), where=known)
    along = (unit * normals).sum(axis=1)
    weak = np.flatnonzero(np.abs(along) < _LEAST)
    if len(weak):
        around = unit[nearest(points, _SIDE)[weak]].sum(axis=1)
        along[weak] = (around * normals[weak]).sum(axis=1)
    new = np.where(along < 0, -1.0, 1.0)[:, None] * normals
    still = (normals == 0).all(axis=1) | (found.outliers & known[:, 0])
    return np.where(still[:, None], np.where(np.isfinite(old), old, 0.0), new)
