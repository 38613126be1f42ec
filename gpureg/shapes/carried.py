"""Carry the data of a triangle mesh to a mesh with fewer vertices: :class:`Carried`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Carried:
    """Where the vertices and faces of a simplified mesh come from.

    Attributes
    ----------
    before : (n, 3) float array
        Vertices of the input mesh.
    corners : (F, 3) int array
        Its triangles.
    which : (n,) int array
        The same number for input vertices at the same point.
    labels : (n,) int array
        The new vertex that each input vertex was merged into; -1 for none.
    origin : (G,) int array
        The input triangle that each new triangle is the rest of; their corners are in the same order.
    vertices : (k, 3) float array
    faces : (G, 3) int array
        The new mesh.
    """

    before: FloatArray
    corners: IntArray
    which: IntArray
    labels: IntArray
    origin: IntArray
    vertices: FloatArray
    faces: IntArray

    def of_faces(self, values: npt.ArrayLike) -> npt.NDArray[Any]:
        """Return the values (G, ...) of the new triangles, from those of the input triangles, (F, ...)."""
        return np.asarray(values)[self.origin]

    def of_corners(self, values: npt.ArrayLike) -> npt.NDArray[Any]:
        """Return the values (G, 3, ...) at the corners of the new triangles, from those of the input, (F, 3, ...).

        They are interpolated as at vertices, on each side of a seam by itself.
        """
        array = np.asarray(values)
        flat = array.reshape(self.corners.size, -1)
        at = self.corners.ravel()
        rows = np.column_stack([self.which[at], np.unique(flat, axis=0, return_inverse=True)[1].ravel()])
        _, first, item = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        at = at[first]
        corners = item.reshape(-1, 3)
        whole = replace(self, before=self.before[at], corners=corners, which=self.which[at], labels=self.labels[at])
        given = array.reshape(-1, *array.shape[2:])[first]
        split = whole.split([given])
        found: npt.NDArray[Any] = split.of_vertices(given)[split.faces]
        return found

    def sides(self, items: IntArray, place: IntArray, same: IntArray | None = None) -> IntArray:
        """Number the sides of seams, (m,), where m items, such as places in a texture, lie at the corners of triangles.

        Items that an edge joins whose ends were merged are on one side.

        Parameters
        ----------
        items : (F, 3) int array
            The item at each corner of the input triangles.
        place : (m,) int array
            The new vertex at each item; -1 for none.
        same : (m,) int array, optional
            The same number for items that are on one side from the beginning.
        """
        from scipy import sparse
        from scipy.sparse import csgraph

        pairs = np.concatenate([items[:, [0, 1]], items[:, [1, 2]], items[:, [2, 0]]])
        pairs = pairs[(place[pairs[:, 0]] == place[pairs[:, 1]]) & (place[pairs[:, 0]] >= 0)]
        if same is not None:
            order = np.argsort(same, kind="stable")
            again = same[order][1:] == same[order][:-1]
            pairs = np.concatenate([pairs, np.stack([order[1:][again], order[:-1][again]], axis=1)])
        shape = (len(place), len(place))
        joined = sparse.coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=shape)
        return np.asarray(csgraph.connected_components(joined, directed=False)[1], np.int64)

    def split(self, arrays: Sequence[npt.NDArray[Any]]) -> Split:
        """Return the new mesh for data at its vertices, which may differ between input vertices at the same point.

        Where they differ, as at the seam of a texture, the new vertex is repeated, once for each side of the seam.

        Parameters
        ----------
        arrays : sequence of arrays (n, ...)
            The data at the vertices of the input mesh.
        """
        n = len(self.before)
        item = _items(self.which, arrays)
        if item is None:
            return Split(self, self.vertices, self.faces, np.arange(len(self.vertices)), self.labels)
        side = self.sides(self.corners, self.labels, item)
        used = self.corners[self.origin].ravel()
        # a side is at one new vertex
        keys = np.stack([self.faces.ravel(), side[used]], axis=1)
        found, number = np.unique(keys, axis=0, return_inverse=True)
        new = np.full(n, -1)
        new[found[:, 1]] = np.arange(len(found))
        return Split(self, self.vertices[found[:, 0]], number.reshape(-1, 3), found[:, 0], new[side])


def _items(which: IntArray, arrays: Iterable[npt.NDArray[Any]]) -> IntArray | None:
    """Number vertices at the same point, (n,), equally where their data are equal; None if all of them are."""
    several = np.bincount(which)[which] > 1
    at = np.flatnonzero(several)
    item = which[at]
    for array in arrays:
        rows = np.unique(array[at].reshape(len(at), -1), axis=0, return_inverse=True)[1].ravel() if len(at) else item
        item = np.unique(np.stack([item, rows], axis=1), axis=0, return_inverse=True)[1].ravel()
    if len(np.unique(item)) == len(np.unique(which[at])):
        return None
    # the other vertices have numbers of their own
    whole = which + len(at)
    whole[at] = item
    return whole


@dataclass(frozen=True, eq=False)
class Split:
    """A simplified mesh whose vertices are repeated at seams, and the data at its vertices.

    Attributes
    ----------
    carried : Carried
    vertices : (k, 3) float array
    faces : (G, 3) int array
    copies : (k,) int array
        The vertex of ``carried.vertices`` that each vertex is a copy of.
    labels : (n,) int array
        The vertex that each input vertex was merged into, on its side of the seam; -1 for none.
    """

    carried: Carried
    vertices: FloatArray
    faces: IntArray
    copies: IntArray
    labels: IntArray

    @cached_property
    def _nearest(self) -> tuple[IntArray, FloatArray]:
        """Input vertices (k, 3), the corners of the nearest triangle around the merged ones, and their shares."""
        corners = self.carried.corners
        new = self.labels[corners].ravel()
        face = np.repeat(np.arange(len(corners)), 3)[new >= 0]
        new = new[new >= 0]
        share, distance = nearest_in_triangles(self.vertices[new], self.carried.before[corners[face]])
        order = np.lexsort((face, distance, new))
        first = order[np.searchsorted(new[order], np.arange(len(self.vertices)))]
        return corners[face[first]], share[first]

    def of_vertices(self, values: npt.ArrayLike) -> npt.NDArray[Any]:
        """Return the values (k, ...) at the new vertices, from those at the input vertices, (n, ...).

        Numbers with a fraction and colours are interpolated, in the nearest of the input triangles whose vertices were
        merged into this one; whole numbers, flags and words, which may be labels, are those of its nearest corner.
        """
        array = np.asarray(values)
        corners, share = self._nearest
        coloured = array.dtype.kind == "u" and array.ndim == 2 and array.shape[1] in (3, 4)
        if array.dtype.kind not in "fc" and not coloured:
            best: npt.NDArray[Any] = array[corners[np.arange(len(corners)), share.argmax(axis=1)]]
            return best
        part = share.reshape(*share.shape, *[1] * (array.ndim - 1))
        # a corner without a share may be NaN
        mean = np.where(part > 0, part * array[corners], 0).sum(axis=1)
        found: npt.NDArray[Any] = (np.rint(mean) if coloured else mean).astype(array.dtype)
        return found


def nearest_in_triangles(points: FloatArray, triangles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the nearest point of each of m triangles, (m, 3, 3), to its point, (m, 3).

    Return it as the shares of the corners, (m, 3), which are >= 0 with the sum 1, and the squared distance, (m,).
    """
    a, b, c = (triangles[:, k] for k in range(3))
    share, best = np.zeros(points.shape), np.full(len(points), np.inf)

    def consider(shares: FloatArray, allowed: npt.NDArray[np.bool_] | bool = True) -> None:
        distance = ((np.einsum("mk,mkd->md", shares, triangles) - points) ** 2).sum(axis=1)
        nearer = (distance < best) & allowed
        share[nearer], best[nearer] = shares[nearer], distance[nearer]

    for k, (start, end) in enumerate(((a, b), (b, c), (c, a))):
        along = end - start
        length = (along**2).sum(axis=1)
        t = ((points - start) * along).sum(axis=1)
        t = np.clip(np.divide(t, length, out=np.zeros_like(t), where=length > 0), 0, 1)
        shares = np.zeros(points.shape)
        shares[:, k], shares[:, (k + 1) % 3] = 1 - t, t
        consider(shares)
    normal = np.cross(b - a, c - a)
    area = (normal**2).sum(axis=1)
    shares = np.stack([(np.cross(y - x, points - x) * normal).sum(axis=1) for x, y in ((b, c), (c, a), (a, b))], axis=1)
    shares = np.divide(shares, area[:, None], out=np.zeros_like(shares), where=area[:, None] > 0)
    consider(shares, (area > 0) & (shares >= 0).all(axis=1))
    return share, best
