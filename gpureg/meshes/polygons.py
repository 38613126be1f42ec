"""Cut polygons into triangles: :func:`triangulated`."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IntArray


def triangulated(vertices: FloatArray, sizes: IntArray, corners: IntArray) -> IntArray:
    """Cut polygons into triangles without new vertices, in the order of the polygons.

    Parameters
    ----------
    vertices : (n, 3) float array
    sizes : (P,) int array
        Number of corners of each polygon, at least 3.
    corners : (c,) int array
        Their vertices, one polygon after the other.

    Returns
    -------
    (F, 3) int array
        Indices into `corners`. A polygon becomes a fan around its first corner, unless triangles of the fan turn over.
    """
    starts = np.cumsum(sizes) - sizes
    polygon = np.repeat(np.arange(len(sizes)), sizes - 2)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    at = starts[polygon, None] + np.stack([0 * step, step + 1, step + 2], axis=1)
    if (sizes == 3).all():
        return at
    a, b, c = (vertices[corners[at[:, k]]] for k in range(3))
    area = np.cross(b - a, c - a)
    normal = np.stack([np.bincount(polygon, weights=x, minlength=len(sizes)) for x in area.T], axis=1)
    turned = ((area * normal[polygon]).sum(axis=1) < 0) & np.isfinite(area).all(axis=1)
    for k in np.unique(polygon[turned]).tolist():
        begin, size = int(starts[k]), int(sizes[k])
        at[polygon == k] = begin + _ears(vertices[corners[begin : begin + size]], normal[k])
    return at


def _ears(points: FloatArray, normal: FloatArray) -> IntArray:
    """Cut one polygon (s, 3) into s - 2 triangles by ears: corners whose triangle holds no other corner."""
    # in the plane, seen from the side of the normal
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    flat = np.stack([points @ across, points @ np.cross(normal, across)], axis=1)

    def turn(i: int, j: int, k: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = flat[i], flat[j], flat[k]
        return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))

    left, ears = list(range(len(points))), []
    while len(left) > 3:
        for k in range(len(left)):
            i, j, m = left[k - 1], left[k], left[(k + 1) % len(left)]
            inside = any(
                turn(i, j, o) >= 0 and turn(j, m, o) >= 0 and turn(m, i, o) >= 0 for o in left if o not in (i, j, m)
            )
            if turn(i, j, m) > 0 and not inside:
                break
        else:
            k = 1  # it crosses itself: no cut is right
        ears.append([left[k - 1], left[k], left[(k + 1) % len(left)]])
        del left[k]
    return np.array([*ears, left])
