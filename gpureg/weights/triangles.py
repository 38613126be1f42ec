"""Weights from the shapes of triangles: :func:`cotangent`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, checked_faces
from ..doors import door
from ..graphs.csr import Graph
from ..graphs.grid import AnyGraph
from ..graphs.of_shapes import with_three_corners
from .base import EdgeWeights

# Largest cotangent, for an angle of 0.06 degrees, and twice the area over the square of the longest edge of a triangle
# without area, which has no weights.
_MOST, _FLAT = 1e3, 1e-7


@dataclass(frozen=True, eq=False)
class Cotangent(EdgeWeights):
    """See :func:`cotangent`."""

    reads_data = False
    faces: IntArray

    def between(self, graph: AnyGraph, f0: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
        """Compute the weights (cot a + cot b)/2, (k,), for the angles a and b opposite the edge; 0 for other pairs."""
        from scipy import sparse

        if not isinstance(graph, Graph) or graph.positions is None:
            raise ValueError("cotangent weights need a graph with positions, as gpureg.mesh_graph makes it")
        n = graph.n_vertices
        faces = checked_faces(self.faces, n)
        faces = faces[with_three_corners(faces)]
        at = [graph.positions[faces[:, k]] for k in range(3)]
        longest = np.max([((at[k] - at[k - 1]) ** 2).sum(axis=1) for k in range(3)], axis=0, initial=0)
        cotangents, rows, columns = [], [], []
        for k in range(3):
            # the angle at corner k is opposite the edge between the two others
            to, other = at[(k + 1) % 3] - at[k], at[(k + 2) % 3] - at[k]
            along = (to * other).sum(axis=1)
            # Lagrange's identity gives |to x other| in any dimension
            across = np.sqrt(np.maximum((to**2).sum(axis=1) * (other**2).sum(axis=1) - along**2, 0))
            cotangent = along / np.maximum(across, np.maximum(np.abs(along) / _MOST, np.finfo(float).tiny))
            cotangents.append(np.where(across > _FLAT * longest, cotangent, 0.0))
            rows.append(faces[:, (k + 1) % 3])
            columns.append(faces[:, (k + 2) % 3])
        i, j, half = np.concatenate(rows), np.concatenate(columns), np.concatenate(cotangents) / 2
        both = np.concatenate([i, j]), np.concatenate([j, i])
        table = sparse.csr_array((np.concatenate([half, half]), both), shape=(n, n))
        table.sum_duplicates()
        # one order of summation for both directions, so that the weights are symmetric
        found: FloatArray = np.maximum(np.asarray(table[np.minimum(u, v), np.maximum(u, v)]), 0.0)
        return found


@door
def cotangent(faces: npt.ArrayLike) -> Cotangent:
    """Return weights (cot a + cot b)/2 on a mesh, for the angles a and b opposite an edge (Pinkall and Polthier).

    They give the Laplacian of the surface for triangles of any shape, so that vertices do not slide along it. If the
    two angles sum to more than 180 degrees, the sum is negative and the weight is set to 0. Angles below 0.06 degrees
    are replaced by 0.06 degrees. Faces without area have no weights.

    Parameters
    ----------
    faces : (F, 3) int array
        Triangles of the mesh; the weights are used on its :func:`gpureg.mesh_graph`.

    Raises
    ------
    TypeError, ValueError
        Faces that are not triangles of integers; at use, a graph without positions, or without some of their vertices.

    Examples
    --------
    The diagonal of a square is opposite two right angles:

    >>> import gpureg as gr
    >>> vertices, faces = [[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1, 2], [0, 2, 3]]
    >>> graph = gr.mesh_graph(vertices, faces)
    >>> gr.weights.cotangent(faces).between(graph, None, [0, 0], [1, 2]).round(12)
    array([0.5, 0. ])
    """
    triangles = checked_faces(faces, np.iinfo(np.int64).max)
    if triangles.shape[1] != 3:
        raise ValueError(f"faces must be triangles, (F, 3), got {triangles.shape}")
    return Cotangent(triangles)
