"""Compute the normals of moved vertices again, with the creases and the side of the old ones."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray

# Old normals at one point that differ by less are of one smooth surface; files round them to about this.
_SAME = 1e-3


def summed_areas(vertices: FloatArray, faces: IntArray, items: IntArray, count: int) -> FloatArray:
    """Sum the vector areas of the triangles (F, 3) at each of `count` items, (count, 3); `items` (F, 3) at corners."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    sums = [np.bincount(items.ravel(), weights=np.repeat(x, 3), minlength=count) for x in area.T]
    found: FloatArray = np.stack(sums, axis=1)
    return found


def unit(vectors: FloatArray) -> FloatArray:
    """Divide vectors (m, 3) by their lengths; 0 stays 0."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    found: FloatArray = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
    return found


def side_of(old: npt.NDArray[np.floating], computed: FloatArray) -> float:
    """Return -1 if most old normals, (m, 3), point against the computed ones, otherwise 1."""
    along = (np.asarray(old, float) * computed).sum(axis=1)
    return -1.0 if (along < 0).sum() > (along > 0).sum() else 1.0


def renewed_vertex_normals(
    vertices: FloatArray, faces: IntArray, before: FloatArray, before_faces: IntArray, old: npt.NDArray[np.floating]
) -> npt.NDArray[np.floating]:
    """Compute unit normals at vertices (n, 3): means over their faces weighted by area, 0 without a face.

    Parameters
    ----------
    vertices, faces : (n, 3) arrays
        The mesh now.
    before, before_faces : (m, 3) arrays
        The mesh that the old normals belong to.
    old : (m, 3) float array
        Its normals. If they point inwards, the new ones do. If the vertices are the same and have moved, those that
        were at one point with the same normal get the same normal again.
    """
    computed = unit(summed_areas(before, before_faces, before_faces, len(before)))
    item = np.arange(len(vertices))
    if len(before) == len(vertices):
        rows = np.concatenate([before, np.rint(np.asarray(old, float) / _SAME)], axis=1)
        item = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    sums = summed_areas(vertices, faces, item[faces], len(vertices))
    found: npt.NDArray[np.floating] = (side_of(old, computed) * unit(sums))[item].astype(old.dtype)
    return found


def renewed_face_normals(
    vertices: FloatArray, faces: IntArray, before: FloatArray, before_faces: IntArray, old: npt.NDArray[np.floating]
) -> npt.NDArray[np.floating]:
    """Compute unit normals of triangles (F, 3); the parameters are those of :func:`renewed_vertex_normals`."""

    def of(v: FloatArray, f: IntArray) -> FloatArray:
        return unit(np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]]))

    found: npt.NDArray[np.floating] = (side_of(old, of(before, before_faces)) * of(vertices, faces)).astype(old.dtype)
    return found


def renewed_cell_normals(
    now: tuple[FloatArray, IntArray],
    before: tuple[FloatArray, IntArray],
    old: npt.NDArray[np.floating],
    cell: IntArray,
    values: npt.NDArray[np.floating],
) -> npt.NDArray[np.floating]:
    """Compute unit normals of cells (c, 3) that are cut into triangles.

    Parameters
    ----------
    now, before : vertices (n, 3) and triangles (F, 3), or (G, 3) before
    old : (G, 3) float array
        The old normal of the cell of each triangle.
    cell : (F,) int array
        The cell of each triangle now.
    values : (c, 3) float array
        Changed in place, where a cell has triangles, and returned.
    """

    def areas(v: FloatArray, f: IntArray) -> FloatArray:
        found: FloatArray = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
        return found

    columns = [np.bincount(cell, weights=x, minlength=len(values)) for x in areas(*now).T]
    sums: FloatArray = np.stack(columns, axis=1).astype(np.float64)
    rows = np.unique(cell)
    values[rows] = side_of(old, unit(areas(*before))) * unit(sums)[rows]
    return values
