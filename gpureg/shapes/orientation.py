"""Choose the faces of a mesh that count, and turn them the same way: :func:`used_faces`."""

from __future__ import annotations

import warnings

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..doors import outside
from ..graphs.of_shapes import face_edges
from .surface import proper_faces


def used_faces(vertices: FloatArray, faces: IntArray, then: str = "") -> IntArray:
    """Return the triangles with an area, (F, 3), each once, turned like their neighbours.

    Parameters
    ----------
    vertices : (n, 3) float array
    faces : (F, 3) int array
    then : str, optional
        What a warning says of the faces that are turned against their neighbours, after their number.

    Warns
    -----
    UserWarning
        Faces are turned against their neighbours; no face has an area.
    """
    used = faces[proper_faces(vertices, faces)]
    if not len(used):
        warnings.warn("no face has an area: nothing is known of the noise, and nothing moves", stacklevel=outside())
        return used
    used = used[first_of_each(used)]
    against = turned(used)
    if not against.any():
        return used
    count = f"{against.sum()} faces are" if against.sum() > 1 else "1 face is"
    warnings.warn(f"{count} turned against their neighbours{then}", stacklevel=outside())
    return np.where(against[:, None], used[:, ::-1], used)


def first_of_each(faces: IntArray) -> npt.NDArray[np.bool_]:
    """Find the faces (F, 3) whose three vertices are not those of an earlier face, (F,) bool."""
    a, b, c = np.sort(faces, axis=1).T
    key = a * (int(faces.max(initial=0)) + 1) + b
    order = np.lexsort((c, key))
    new = np.ones(len(faces), bool)
    new[order[1:]] = (np.diff(key[order]) != 0) | (np.diff(c[order]) != 0)
    return new


def turned(faces: IntArray) -> npt.NDArray[np.bool_]:
    """Find the faces that must be turned so that neighbours have the same orientation, (F,) bool.

    Neighbours share an edge that has no third face. In each component the fewer faces are turned; none where it is
    impossible, as on a Moebius strip.
    """
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    n = len(faces)
    ends = face_edges(faces)
    low, high = ends.min(axis=1), ends.max(axis=1)
    key = low * (int(faces.max(initial=0)) + 1) + high
    order = np.argsort(key, kind="stable")
    bounds = np.flatnonzero(np.diff(key[order], prepend=-1, append=-1))
    pairs = bounds[:-1][np.diff(bounds) == 2]
    one, two = order[pairs], order[pairs + 1]
    forward = ends[:, 0] == low
    against = forward[one] == forward[two]
    if not against.any():
        return np.zeros(n, bool)
    # two copies of each face, as it is and turned; neighbours join the copies that fit
    u, v = one // 3, two // 3
    rows = np.concatenate([u, u + n])
    columns = np.concatenate([np.where(against, v + n, v), np.where(against, v, v + n)])
    joined = sparse.coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * n, 2 * n))
    count, side = connected_components(joined, directed=False)
    kept = np.bincount(side[:n], minlength=count)
    # one of both sides of a component is that with more faces as they are, and of equal ones that of the first face
    mine, other = side[:n], side[n:]
    found: npt.NDArray[np.bool_] = (kept[mine] < kept[other]) | ((kept[mine] == kept[other]) & (mine > other))
    return found
