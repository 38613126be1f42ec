"""Weights by the shapes of triangles: :func:`cotangent`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, checked_faces
from ..doors import door
from ..graphs.csr import Graph
from ..graphs.grid import AnyGraph
from .base import EdgeWeights

# The cotangent of the smallest angle that counts, 0.06 degrees: a triangle without area would make it infinite.
_MOST = 1e3


@dataclass(frozen=True, eq=False)
class Cotangent(EdgeWeights):
    """See :func:`cotangent`."""

    reads_data = False
    faces: IntArray

    def between(self, graph: AnyGraph, f0: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
        """Weights (cot a + cot b)/2, a and b the angles that face the edge; 0 off the triangles' edges."""
        from scipy import sparse

        if not isinstance(graph, Graph) or graph.positions is None:
            raise ValueError("cotangent weights need a graph that knows its positions: gpureg.mesh_graph")
        n = graph.n_vertices
        faces = checked_faces(self.faces, n)
        at = [graph.positions[faces[:, k]] for k in range(3)]
        cotangents, rows, columns = [], [], []
        for k in range(3):
            # the angle at corner k faces the edge between the two others
            to, other = at[(k + 1) % 3] - at[k], at[(k + 2) % 3] - at[k]
            along = (to * other).sum(axis=1)
            # Lagrange's identity gives |to x other| in any dimension
            across = np.sqrt(np.maximum((to**2).sum(axis=1) * (other**2).sum(axis=1) - along**2, 0))
            cotangents.append(along / np.maximum(across, np.maximum(np.abs(along) / _MOST, np.finfo(float).tiny)))
            rows.append(faces[:, (k + 1) % 3])
            columns.append(faces[:, (k + 2) % 3])
        i, j, half = np.concatenate(rows), np.concatenate(columns), np.concatenate(cotangents) / 2
        both = np.concatenate([i, j]), np.concatenate([j, i])
        table = sparse.csr_array((np.concatenate([half, half]), both), shape=(n, n))
        table.sum_duplicates()
        # a symmetric sum is the same both ways only once it is taken in one order
        found: FloatArray = np.maximum(np.asarray(table[np.minimum(u, v), np.maximum(u, v)]), 0.0)
        return found


@door
def cotangent(faces: npt.ArrayLike) -> Cotangent:
    """Weights (cot a + cot b)/2 on the edges of a mesh, a and b the angles facing the edge: Pinkall and Polthier's.

    With them the Laplacian is that of the surface, whatever the shapes of its triangles, so that vertices do not slide
    along it. Where an edge's two angles sum to more than 180 degrees the sum is negative, and the weight, which may not
    be, 0; angles under 0.06 degrees count as that.

    Parameters
    ----------
    faces : (F, 3) int array
        Triangles of the mesh whose :func:`gpureg.mesh_graph` the weights are for.

    Raises
    ------
    TypeError, ValueError
        Faces that are no triangles of integers; at use, a graph without positions, or without some of their vertices.

    Examples
    --------
    The diagonal of a square faces two right angles:

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
