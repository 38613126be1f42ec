"""Convert triangle meshes of any library to vertices and faces, and back: :class:`Surface`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, checked_faces, checked_points
from ..graphs.of_shapes import face_edges

# What makes a mesh of its kind of vertices, faces, and where the vertices come from: vertex i from number `kept[i]`.
Maker = Callable[[FloatArray, IntArray, IntArray], Any]

KINDS = "(vertices, faces), or a mesh of trimesh, PyVista or Open3D"


@dataclass(frozen=True, eq=False)
class Surface:
    """Vertices (n, 3) and triangles (F, 3), and how to make a mesh of the kind they came from."""

    vertices: FloatArray
    faces: IntArray
    make: Maker

    def like(self, vertices: FloatArray, faces: IntArray | None = None, kept: IntArray | None = None) -> Any:
        """Make a mesh of the kind that came in.

        Parameters
        ----------
        vertices : (k, 3) float array
        faces : (F, 3) int array, optional
            None: those that came in.
        kept : (k,) int array, optional
            For each vertex, the one that came in whose attributes (colours and the like) it gets; None: they are the
            same ones, in the same order.
        """
        same = np.arange(len(self.vertices))
        return self.make(vertices, self.faces if faces is None else faces, same if kept is None else kept)

    def welded(self) -> tuple[Surface, IntArray]:
        """Join vertices on the same point: return the surface, and which vertex each has become, (n,).

        Files such as STL repeat a vertex for each of its faces, others at the seams of textures: to a graph such
        copies would be borders, along which the surface tears.
        """
        # equal points have equal sums; the other way round it is seldom so, and then they are compared
        x, y, z = self.vertices.T
        sums = np.sort(x + np.sqrt(2) * y + np.sqrt(3) * z)
        if (sums[1:] != sums[:-1]).all():
            return self, np.arange(len(self.vertices))
        points, first, which = np.unique(self.vertices, axis=0, return_index=True, return_inverse=True)
        if len(points) == len(self.vertices):
            return self, np.arange(len(points))
        # in the order in which they came first, so that meshes with the same faces still have the same
        order = np.argsort(first)
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        which = place[which.ravel()]
        return replace(self, vertices=points[order], faces=which[self.faces]), which


def surface_of(mesh: Any, faces: npt.ArrayLike | None = None) -> Surface:
    """Make a surface of a mesh of any kind that is known, and check it; a :class:`Surface` comes back as it is.

    Parameters
    ----------
    mesh : (vertices, faces), trimesh.Trimesh, pyvista.PolyData or open3d.geometry.TriangleMesh
        Or the vertices alone, and the faces as the second argument.
    faces : (F, 3) int array, optional

    Raises
    ------
    TypeError, ValueError
        Another kind of thing, vertices that are not finite points of space, faces that are no triangles.
    """
    if isinstance(mesh, Surface) and faces is None:
        return mesh
    if faces is not None:
        mesh = (mesh, faces)
    for known in (_of_pair, _of_trimesh, _of_pyvista, _of_open3d):
        found = known(mesh)
        if found is not None:
            vertices, triangles, make = found
            break
    else:
        raise TypeError(f"a mesh must be {KINDS}; got {type(mesh).__name__}")
    points = checked_points(vertices, "vertices")
    if points.shape[1] != 3:
        raise ValueError(f"the vertices of a mesh must have shape (n, 3), got {points.shape}")
    corners = checked_faces(triangles, len(points))
    if corners.shape[1] != 3:
        raise ValueError(f"faces must be triangles, (F, 3), got {corners.shape}: cut others into triangles first")
    if not len(corners):
        raise ValueError("the mesh has no face; points alone are for gpureg.denoise_points")
    return Surface(points, corners, make)


_Found = tuple[npt.ArrayLike, npt.ArrayLike, Maker]


def _of_pair(mesh: Any) -> _Found | None:
    if not isinstance(mesh, tuple | list) or len(mesh) != 2:
        return None
    return mesh[0], mesh[1], _pair_like(np.asarray(mesh[0]).dtype)


def _pair_like(dtype: np.dtype[Any]) -> Maker:
    """Make pairs whose vertices keep their type, where it is one of floating point."""
    kind = dtype if dtype.kind == "f" else np.dtype(np.float64)

    def make(vertices: FloatArray, faces: IntArray, kept: IntArray) -> Any:
        return vertices.astype(kind), faces

    return make


def _of_trimesh(mesh: Any) -> _Found | None:
    # of the type: to ask the mesh for its normals would compute them
    if not hasattr(type(mesh), "face_normals") or not hasattr(mesh, "vertices"):
        return None

    def make(vertices: FloatArray, faces: IntArray, kept: IntArray) -> Any:
        if faces.shape == mesh.faces.shape and np.array_equal(faces, mesh.faces):
            copy = mesh.copy()
            copy.vertices = vertices
            return copy
        colours = mesh.visual.vertex_colors[kept] if getattr(mesh.visual, "kind", None) == "vertex" else None
        made = type(mesh)(vertices=vertices, faces=faces, vertex_colors=colours, process=False)
        made.vertex_attributes.update({name: np.asarray(x)[kept] for name, x in mesh.vertex_attributes.items()})
        return made

    return mesh.vertices, mesh.faces, make


def _of_pyvista(mesh: Any) -> _Found | None:
    if not hasattr(mesh, "regular_faces") or not hasattr(mesh, "points"):
        return None
    if not mesh.is_all_triangles:
        raise ValueError("the mesh has faces that are no triangles: call its triangulate() first")

    def make(vertices: FloatArray, faces: IntArray, kept: IntArray) -> Any:
        if faces.shape == mesh.regular_faces.shape and np.array_equal(faces, mesh.regular_faces):
            copy = mesh.copy()
            copy.points = vertices
            return copy
        made = type(mesh).from_regular_faces(vertices, faces)
        for name in mesh.point_data:
            made.point_data[name] = np.asarray(mesh.point_data[name])[kept]
        return made

    return mesh.points, mesh.regular_faces, make


def _of_open3d(mesh: Any) -> _Found | None:
    if not hasattr(mesh, "triangles") or not hasattr(mesh, "vertices"):
        return None

    def make(vertices: FloatArray, faces: IntArray, kept: IntArray) -> Any:
        copy = type(mesh)(mesh)
        copy.vertices = type(mesh.vertices)(vertices)
        copy.triangles = type(mesh.triangles)(faces.astype(np.int32))
        if mesh.has_vertex_colors():
            copy.vertex_colors = type(mesh.vertex_colors)(np.asarray(mesh.vertex_colors)[kept])
        # those of the surface as it was
        if mesh.has_vertex_normals():
            copy.compute_vertex_normals()
        if mesh.has_triangle_normals():
            copy.compute_triangle_normals()
        return copy

    return np.asarray(mesh.vertices), np.asarray(mesh.triangles), make


def face_vectors(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Compute the vector area of each triangle, (F, 3): along its normal, as long as its area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area: FloatArray = 0.5 * np.cross(b - a, c - a)
    return area


def face_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Compute unit normals of triangles, (F, 3); 0 where a triangle has no area."""
    vectors = face_vectors(vertices, faces)
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    normals: FloatArray = np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)
    return normals


def border_vertices(faces: IntArray, n_vertices: int) -> npt.NDArray[np.bool_]:
    """Find the vertices that lie on an edge of one face only, (n,) bool."""
    edges = np.sort(face_edges(faces), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    border = np.zeros(n_vertices, bool)
    border[unique[count == 1].ravel()] = True
    return border


def vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Compute unit normals at the vertices, (n, 3): means over their faces by area; 0 where there is none."""
    from scipy import sparse

    corners = faces.ravel()
    at = (corners, np.repeat(np.arange(len(faces)), 3))
    gather = sparse.csr_array((np.ones(len(corners)), at), shape=(len(vertices), len(faces)))
    sums: FloatArray = gather @ face_vectors(vertices, faces)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    normals: FloatArray = np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 0)
    return normals
