"""Convert triangle meshes of other libraries to vertices and faces, and back: :class:`Surface`."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, all_finite, checked_faces, checked_points
from ..doors import outside
from ..graphs.of_shapes import face_edges, with_three_corners
from .carried import Carried
from .makers import Maker, of_open3d, of_pair, of_pyvista, of_trimesh
from .welding import same_points

# Height of a triangle over its longest edge from which on it has an area.
_FLAT = 1e-7

KINDS = "(vertices, faces), or a mesh of trimesh, PyVista or Open3D"


@dataclass(frozen=True, eq=False)
class Surface:
    """Vertices (n, 3), triangles (F, 3), a function that makes a mesh of the input's type, and notes in words."""

    vertices: FloatArray
    faces: IntArray
    make: Maker
    notes: tuple[str, ...] = ()

    def like(self, vertices: FloatArray, carried: Carried | None = None) -> Any:
        """Make a mesh of the input's type; a warning names what it lost.

        Parameters
        ----------
        vertices : (k, 3) float array
        carried : Carried, optional
            A mesh with fewer vertices, and where its data come from. None: the faces and data are those of the input,
            but normals are computed again.
        """
        mesh, lost = self.made(vertices, carried)
        if lost:
            warnings.warn(f"the new mesh lost {', '.join(lost)}", stacklevel=outside())
        return mesh

    def made(self, vertices: FloatArray, carried: Carried | None = None) -> tuple[Any, list[str]]:
        """Make a mesh as :meth:`like`; return it and what it lost, in words."""
        return self.make(vertices, self.faces if carried is None else carried.faces, carried)

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
        Another type; faces with vertices that are not finite points in space; faces that are not triangles.

    Warns
    -----
    UserWarning
        Vertices that are not finite, and belong to no face.
    """
    if isinstance(mesh, Surface) and faces is None:
        return mesh
    surface = taken_apart(mesh if faces is None else (mesh, faces))
    for note in surface.notes:
        warnings.warn(note, stacklevel=outside())
    return surface


def taken_apart(mesh: Any) -> Surface:
    """Convert a mesh to a surface as :func:`surface_of`, without a warning for its notes."""
    for known in (of_pair, of_trimesh, of_pyvista, of_open3d):
        found = known(mesh)
        if found is not None:
            vertices, triangles, make = found
            break
    else:
        raise TypeError(f"a mesh must be {KINDS}; got {type(mesh).__name__}")
    given = np.asarray(vertices)
    wrong = not_finite(given, triangles)
    points = checked_points(vertices if wrong is None else np.where(wrong[:, None], 0, given), "vertices")
    if points.shape[1] != 3:
        raise ValueError(f"the vertices of a mesh must have shape (n, 3), got {points.shape}")
    corners = checked_faces(triangles, len(points))
    if corners.shape[1] != 3:
        raise ValueError(f"faces must be triangles, (F, 3), got {corners.shape}: cut the faces into triangles first")
    if not len(corners):
        raise ValueError("the mesh has no face; for points without faces use gpureg.denoise_points")
    notes: tuple[str, ...] = ()
    if wrong is not None:
        # without a face they take part in nothing: they come back as they were
        points[wrong] = points[~wrong].mean(axis=0)
        make = _with_given(make, given, wrong)
        notes = (f"{wrong.sum()} vertices are not finite; they belong to no face, and are left out",)
    return Surface(points, corners, make, notes)


def not_finite(vertices: npt.NDArray[Any], faces: npt.ArrayLike) -> npt.NDArray[np.bool_] | None:
    """Find vertices that are not finite and belong to no face, (n,) bool; None if there are none.

    Raises
    ------
    ValueError
        A vertex that is not finite belongs to a face.
    """
    if vertices.ndim != 2 or vertices.dtype.kind != "f" or all_finite(vertices):
        return None
    wrong: npt.NDArray[np.bool_] = ~np.isfinite(vertices).all(axis=1)
    used = np.asarray(faces)
    inside = used[(used >= 0) & (used < len(wrong))] if used.dtype.kind in "iu" else np.zeros(0, int)
    count = np.bincount(inside.ravel(), minlength=len(wrong))
    if (wrong & (count > 0)).any():
        row = int(np.flatnonzero(wrong & (count > 0))[0])
        raise ValueError(
            f"vertices must be finite, row {row} is {vertices[row].tolist()} and belongs to {count[row]} faces: "
            "remove these faces, or give the vertex a position"
        )
    return wrong


def _with_given(make: Maker, given: npt.NDArray[Any], wrong: npt.NDArray[np.bool_]) -> Maker:
    """Put the given rows back where vertices are `wrong`, unless the mesh is simplified."""

    def make_them(vertices: FloatArray, faces: IntArray, carried: Carried | None) -> tuple[Any, list[str]]:
        whole = vertices if carried is not None else np.where(wrong[:, None], given, vertices)
        return make(whole, faces, carried)

    return make_them


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
