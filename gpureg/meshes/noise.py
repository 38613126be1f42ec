"""Estimate the noise of a mesh from the median of differences: :func:`estimate_mesh_noise`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..doors import door
from ..graphs.csr import Graph
from ..graphs.of_shapes import adjacent_faces, mesh_graph
from ..noise.graphs import MEDIAN, averaging, second_differences
from ..shapes.surface import face_normals, surface_of, vertex_normals

# For noisy normals: the distance from the mean of three neighbours over that from one neighbour (measured on five
# meshes: 0.80 to 0.83), and a bound on the noise of a vertex in mean edges over the former (0.7 to 0.95 there).
_ACROSS, _TILT = 0.82, 1.2


def noise_along_normals(v: FloatArray, faces: IntArray, graph: Graph, turned: float) -> float:
    """Estimate the noise of a mesh, (n, 3) and (F, 3), from its graph and the noise of its normals, `turned`."""
    heights = ((v - averaging(graph) @ v) * vertex_normals(v, faces)).sum(axis=1)
    differences = np.abs(second_differences(v, graph, heights))
    if not differences.size:
        return 0.0
    u = graph.edge_rows()
    edge = float(np.linalg.norm(v[u] - v[graph.indices], axis=1).mean())
    return min(float(np.median(differences) / MEDIAN), _TILT * turned * edge)


def noise_of_normals(normals: FloatArray, u: IntArray, v: IntArray) -> float:
    """Compute the median distance of a unit normal (F, 3) from the mean of its neighbours; edge i joins u[i] and v[i].

    It is bounded by the median distance across an edge: on mechanical parts many faces touch a crease, but most edges
    are flat.
    """
    n = len(normals)
    count = np.bincount(u, minlength=n) + np.bincount(v, minlength=n)
    there = (count > 0) & normals.any(axis=1)
    if not there.any():
        return 0.0
    sums = [np.bincount(u, x[v], n) + np.bincount(v, x[u], n) for x in np.ascontiguousarray(normals.T)]
    apart = np.linalg.norm(normals - np.stack(sums, axis=1) / np.maximum(count, 1)[:, None], axis=1)
    across = np.linalg.norm(normals[u] - normals[v], axis=1)[there[u] & there[v]]
    return min(float(np.median(apart[there])), _ACROSS * float(np.median(across)) if across.size else 0.0)


@door
def estimate_mesh_noise(mesh: Any, faces: npt.ArrayLike | None = None) -> float:
    """Estimate the standard deviation of the noise of a mesh along its normals, in the units of its coordinates.

    Parameters
    ----------
    mesh : (vertices, faces), trimesh.Trimesh, pyvista.PolyData or open3d.geometry.TriangleMesh
    faces : (F, 3) int array, optional
        The faces, if `mesh` is only the vertices, (n, 3).

    Raises
    ------
    TypeError, ValueError
        Not a triangle mesh.

    Notes
    -----
    Let h(u) be the height of u above the mean of its neighbours, along the normal. The estimate is the median of
    |h(u) - mean of h around u| divided by its value for white noise of standard deviation 1 (about 1.36 / 0.674 with
    six neighbours). Constant curvature cancels; details as fine as the mesh count as noise. The estimate is at most 1.2
    mean edges times the noise of the normals, which is 0 where most edges are flat.

    Examples
    --------
    >>> import gpureg as gr
    >>> tetrahedron = [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]
    >>> round(gr.estimate_mesh_noise(tetrahedron), 9)
    0.0
    """
    surface, _ = surface_of(mesh, faces).welded()
    v = surface.vertices - surface.vertices.mean(axis=0)
    turned = noise_of_normals(face_normals(v, surface.faces), *adjacent_faces(surface.faces))
    return noise_along_normals(v, surface.faces, mesh_graph(v, surface.faces), turned)
