"""Convert triangle meshes of other libraries to vertices and faces, and back: :class:`Surface`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, checked_faces, checked_points
from ..graphs.of_shapes import face_edges, with_three_corners
from .welding import same_points

# A function that makes a mesh of the input's type from vertices, faces and `kept`: vertex i has the attributes of the
# input vertex kept[i].
Maker = Callable[[FloatArray, IntArray, IntArray], Any]

# Height of a triangle over its longest edge from which on it has an area.
_FLAT = 1e-7

KINDS = "(vertices, faces), or a mesh of trimesh, PyVista or Open3D"


@dataclass(frozen=True, eq=False)
class Surface:
    """Vertices (n, 3), triangles (F, 3), and a function that makes a mesh of the input's type."""

    vertices: FloatArray
    faces: IntArray
    make: Maker

    def like(self, vertices: FloatArray, faces: IntArray | None = None, kept: IntArray | None = None) -> Any:
        """Make a mesh of the input's type.

        Parameters
        ----------
        vertices : (k, 3) float array
        faces : (F, 3) int array, optional
            None: the faces of the input.
        kept : (k,) int array, optional
            The input vertex whose attributes (such as colours) each vertex gets. None: vertex i those of vertex i.
        """
        same = np.arange(len(self.vertices))
        return self.make(vertices, self.faces if faces is None else faces, same if kept is None else kept)

    def welded(self) -> tuple[Surface, IntArray]:
        """Merge vertices at the same point; return the surface and the new index of each vertex, (n,).

        STL files repeat a vertex for each of its faces, other files at the seams of textures: in a graph the copies
        would be borders, along which the surface tears. Vertices closer than 1e-5 edges are at the same point, which
        gets the position of the first one.
        """
        which = same_points(self.vertices, self.faces)
        if which is None:
            return self, np.arange(len(self.vertices))
        first = np.unique(which, return_index=True)[1]
        return replace(self, vertices=self.vertices[first], faces=which[self.faces]), which


def surface_of(mesh: Any, faces: npt.ArrayLike | None = None) -> Surface:
    """Convert a mesh of a supported type to a surface, and check it; a :class:`Surface` is returned unchanged.

    Parameters
    ----------
    mesh : (vertices, faces), trimesh.Trimesh, pyvista.PolyData or open3d.geometry.TriangleMesh
        A mesh, or only its vertices, (n, 3), with `faces` as the second argument.
    faces : (F, 3) int array, optional

    Raises
    ------
    TypeError, ValueError
        Another type; vertices that are not finite points in space; faces that are not triangles.
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
        raise ValueError(f"faces must be triangles, (F, 3), got {corners.shape}: cut the faces into triangles first")
    if not len(corners):
        raise ValueError("the mesh has no face; for points without faces use gpureg.denoise_points")
    return Surface(points, corners, make)


_Found = tuple[npt.ArrayLike, npt.ArrayLike, Maker]


def _of_pair(mesh: Any) -> _Found | None:
    if not isinstance(mesh, tuple | list) or len(mesh) != 2:
        return None
    return mesh[0], mesh[1], _pair_like(np.asarray(mesh[0]).dtype)


def _pair_like(dtype: np.dtype[Any]) -> Maker:
    """Make pairs whose vertices have the given type if it is a floating-point type, otherwise float64."""
    kind = dtype if dtype.kind == "f" else np.dtype(np.float64)

    def make(vertices: FloatArray, faces: IntArray, kept: IntArray) -> Any:
        return vertices.astype(kind), faces

    return make


def _of_trimesh(mesh: Any) -> _Found | None:
    # asked of the type, because a mesh would compute its normals
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
        raise ValueError("the mesh has faces that are not triangles: call its triangulate() first")

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
        # the copy has the normals of the input
        if mesh.has_vertex_normals():
            copy.compute_vertex_normals()
        if mesh.has_triangle_normals():
            copy.compute_triangle_normals()
        return copy

    return np.asarray(mesh.vertices), np.asarray(mesh.triangles), make


def face_vectors(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Compute the vector area of each triangle, (F, 3): along its normal, with its area as length."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area: FloatArray = 0.5 * np.cross(b - a, c - a)
    return area


def face_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Compute unit normals of triangles, (F, 3); 0 where a triangle has no area."""
    vectors = face_vectors(vertices, faces)
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    normals: FloatArray = np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)
    return normals


def proper_faces(vertices: FloatArray, faces: IntArray) -> npt.NDArray[np.bool_]:
    """Find the triangles with an area, (F,) bool: three corners, and a height above 1e-7 of the longest edge."""
    corners = [vertices[faces[:, k]] for k in range(3)]
    longest = np.max([((corners[k] - corners[k - 1]) ** 2).sum(axis=1) for k in range(3)], axis=0)
    area = np.linalg.norm(face_vectors(vertices, faces), axis=1)
    # a repeated corner makes two edges equal, whose product is rounding
    proper: npt.NDArray[np.bool_] = with_three_corners(faces) & (2 * area > _FLAT * longest)
    return proper


def border_vertices(faces: IntArray, n_vertices: int) -> npt.NDArray[np.bool_]:
    """Find the vertices on an edge with only one face, (n,) bool."""
    edges = np.sort(face_edges(faces), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    border = np.zeros(n_vertices, bool)
    border[unique[count == 1].ravel()] = True
    return border


def incidence(faces: IntArray, n_vertices: int) -> Any:
    """Return the CSR matrix (n, F) that sums a function of the faces (F, 3) over the faces around each vertex."""
    from scipy import sparse

    at = (faces.ravel(), np.repeat(np.arange(len(faces)), faces.shape[1]))
    return sparse.csr_array((np.ones(faces.size), at), shape=(n_vertices, len(faces)))


def vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Compute unit normals at the vertices, (n, 3): means over their faces weighted by area; 0 without a face."""
    sums: FloatArray = incidence(faces, len(vertices)) @ face_vectors(vertices, faces)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    normals: FloatArray = np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 0)
    return normals
