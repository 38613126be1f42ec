"""Estimate how noisy a mesh is, by robust deviations of differences: :func:`estimate_mesh_noise`."""

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

# What noise makes of normals: distances from the mean of three neighbours over those from one of them (measured on five
# meshes: 0.80 to 0.83), and the most of a vertex's deviation in edges over the former (0.7 to 0.95 there).
_ACROSS, _TILT = 0.82, 1.2


def noise_along_normals(v: FloatArray, faces: IntArray, graph: Graph, turned: float) -> float:
    """Estimate the noise of a mesh as :func:`estimate_mesh_noise`, its graph and the noise of its normals known."""
    heights = ((v - averaging(graph) @ v) * vertex_normals(v, faces)).sum(axis=1)
    differences = np.abs(second_differences(v, graph, heights))
    if not differences.size:
        return 0.0
    u = graph.edge_rows()
    edge = float(np.linalg.norm(v[u] - v[graph.indices], axis=1).mean())
    return min(float(np.median(differences) / MEDIAN), _TILT * turned * edge)


def noise_of_normals(normals: FloatArray, u: IntArray, v: IntArray) -> float:
    """Compute the median distance of a unit normal from the mean of those across edges, which faces u and v share.

    At most what the median distance across an edge says: of a part made for a machine many a face lies at a crease,
    and yet most edges are flat.
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
    """Estimate the deviation of noise on a mesh's vertices, along the normals, in the units of its coordinates.

    Parameters
    ----------
    mesh : (vertices, faces), trimesh.Trimesh, pyvista.PolyData or open3d.geometry.TriangleMesh
    faces : (F, 3) int array, optional
        The faces, where `mesh` holds the vertices alone.

    Raises
    ------
    TypeError, ValueError
        What is no mesh of triangles.

    Notes
    -----
    With h(u) the height of u over the mean of its neighbours, along the normal, it is the median of
    |h(u) - mean of h around u| over what this makes of white noise of deviation 1 (about 1.36 / 0.674 where six
    neighbours meet). Constant curvature drops out; detail as fine as the mesh counts as noise. It is at most 1.2 edges
    times the noise of the normals, which is 0 where most edges are flat.

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
