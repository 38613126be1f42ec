"""Measure meshes and curves, and their distances: :mod:`gpureg.metrics`.

Meshes are as for :func:`gpureg.denoise_mesh`: (vertices, faces), or meshes of trimesh, PyVista and Open3D.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, IntArray, checked_points
from .doors import door
from .graphs.of_shapes import face_edges
from .shapes.ends import ends_of
from .shapes.surface import Surface, face_normals, face_vectors, surface_of

# Number of pairs of a point and an element that are processed together.
_PAIRS = 1 << 20


@door
def area(mesh: Any) -> float:
    """Compute the area of all faces of a mesh."""
    surface = surface_of(mesh)
    return float(np.linalg.norm(face_vectors(surface.vertices, surface.faces), axis=1).sum())


@door
def volume(mesh: Any) -> float:
    """Compute the volume of a mesh, > 0 if its normals point outwards.

    An open mesh is closed by cones from the mean of the vertices to its borders.

    Examples
    --------
    >>> from gpureg import metrics
    >>> vertices, faces = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    >>> round(metrics.volume((vertices, faces)), 6)
    0.166667
    """
    surface = surface_of(mesh)
    a, b, c = (surface.vertices[surface.faces[:, k]] - surface.vertices.mean(axis=0) for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


@door
def is_watertight(mesh: Any) -> bool:
    """Return whether every edge belongs to exactly two faces, which have it in opposite directions.

    Vertices at the same point count as one, and faces with a repeated vertex are left out.
    """
    surface, _ = surface_of(mesh).welded()
    faces = surface.faces
    proper = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    edges = face_edges(proper)
    n = np.int64(len(surface.vertices))
    there, back = edges @ np.array([n, 1]), edges @ np.array([1, n])
    return len(proper) > 0 and len(np.unique(there)) == len(there) and np.array_equal(np.sort(there), np.sort(back))


@door
def normal_angle_error(mesh: Any, truth: Any) -> float:
    """Compute the mean angle between the normals of corresponding faces, in degrees.

    Parameters
    ----------
    mesh, truth : meshes
        Two meshes with the same faces. Faces without area in one of them are left out.

    Raises
    ------
    ValueError
        The faces differ, or no face has an area.
    """
    a, b = _alike(mesh, truth)
    normals, true = face_normals(a.vertices, a.faces), face_normals(b.vertices, b.faces)
    there = normals.any(axis=1) & true.any(axis=1)
    if not there.any():
        raise ValueError("no face has an area in both meshes")
    # arcsin of half the chord: arccos would lose half the digits near 0
    half = np.linalg.norm(normals[there] - true[there], axis=1) / 2
    return float(np.degrees(2 * np.arcsin(np.minimum(half, 1))).mean())


@door
def vertex_error(mesh: Any, truth: Any) -> float:
    """Compute the mean distance between corresponding vertices of faces, divided by the mean edge of the truth.

    Raises
    ------
    ValueError
        The faces differ.
    """
    a, b = _alike(mesh, truth)
    used = np.unique(b.faces)
    ends = b.vertices[np.unique(np.sort(face_edges(b.faces), axis=1), axis=0)]
    edge = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean()
    return float(np.linalg.norm(a.vertices[used] - b.vertices[used], axis=1).mean() / edge)


def _alike(mesh: Any, truth: Any) -> tuple[Surface, Surface]:
    a, b = surface_of(mesh), surface_of(truth)
    if a.vertices.shape != b.vertices.shape or not np.array_equal(a.faces, b.faces):
        raise ValueError(
            f"the meshes must have the same faces to be compared one by one, got {len(a.faces)} and {len(b.faces)}, "
            f"on {len(a.vertices)} and {len(b.vertices)} vertices; gpureg.metrics.hausdorff compares any two"
        )
    return a, b


@door
def distance_to_surface(points: npt.ArrayLike, mesh: Any) -> FloatArray:
    """Compute the exact distance (n,) of each point from the faces of a mesh.

    Parameters
    ----------
    points : (n, 3) float array
    mesh : mesh
        Faces without area are left out.

    Raises
    ------
    ValueError
        No face has an area, or the points are not (n, 3).
    """
    surface = surface_of(mesh)
    triangles = surface.vertices[surface.faces]
    solid = np.linalg.norm(face_vectors(surface.vertices, surface.faces), axis=1) > 0
    if not solid.any():
        raise ValueError("no face of the mesh has an area")
    x = checked_points(points)
    if x.shape[1] != 3:
        raise ValueError(f"points must have shape (n, 3), got {x.shape}")
    return _distances(x, triangles[solid], _to_triangles)


@door
def hausdorff(mesh: Any, other: Any) -> float:
    """Compute the two-sided Hausdorff distance between two meshes.

    It is the largest distance from the vertices and the midpoints of edges and faces of one mesh to the faces of the
    other, an approximation of the largest distance over all points.

    Raises
    ------
    ValueError
        A mesh has no face with an area.
    """
    a, b = surface_of(mesh), surface_of(other)
    return max(float(distance_to_surface(_samples(x), y).max()) for x, y in (
        (a, (b.vertices, b.faces)), (b, (a.vertices, a.faces)))
    )  # fmt: skip


def _samples(surface: Surface) -> FloatArray:
    v, faces = surface.vertices, surface.faces
    edges = np.unique(np.sort(face_edges(faces), axis=1), axis=0)
    return np.concatenate([v[np.unique(faces)], v[edges].mean(axis=1), v[faces].mean(axis=1)])


@door
def curve_length(points: npt.ArrayLike, closed: bool | None = None) -> float:
    """Compute the length of a polygonal curve.

    Parameters
    ----------
    points : (n, d) array
        The vertices in order.
    closed : bool, optional
        Whether the last vertex is joined to the first. The default is as in :func:`gpureg.denoise_curve`.

    Raises
    ------
    TypeError, ValueError
        Coordinates are not real and finite.
    """
    return float(np.linalg.norm(np.diff(_segments(checked_points(points), closed), axis=1)[:, 0], axis=1).sum())


@door
def curve_area(points: npt.ArrayLike) -> float:
    """Compute the area inside a closed curve (n, 2), > 0 if the curve is counterclockwise.

    Examples
    --------
    >>> from gpureg import metrics
    >>> metrics.curve_area([[0, 0], [2, 0], [2, 1], [0, 1]])
    2.0
    """
    x = checked_points(points)
    if x.shape[1] != 2:
        raise ValueError(f"the points of a curve with an area must have shape (n, 2), got {x.shape}")
    a = x - x.mean(axis=0)
    b = np.roll(a, -1, axis=0)
    return float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2)


@door
def curve_hausdorff(points: npt.ArrayLike, other: npt.ArrayLike, closed: bool | None = None) -> float:
    """Compute the two-sided Hausdorff distance between two polygonal curves, both closed or both open.

    It is the largest distance from the vertices and segment midpoints of one curve to the segments of the other.

    Parameters
    ----------
    points, other : (n, d) and (m, d) arrays
        The vertices in order.
    closed : bool, optional
        Whether the last vertex of each is joined to its first. The default is as in :func:`gpureg.denoise_curve` for
        the curve with more vertices.

    Raises
    ------
    TypeError, ValueError
        Coordinates are not real and finite, or the curves have different dimensions.
    """
    one, two = checked_points(points), checked_points(other)
    shut = ends_of(one if len(one) >= len(two) else two, closed).closed
    a, b = _segments(one, shut), _segments(two, shut)
    if a.shape[2] != b.shape[2]:
        raise ValueError(f"the curves must lie in the same space, got {a.shape[2]} and {b.shape[2]} dimensions")

    def one_way(x: FloatArray, y: FloatArray) -> float:
        samples = np.concatenate([x.reshape(-1, x.shape[2]), x.mean(axis=1)])
        return float(_distances(samples, y, _to_segments).max())

    return max(one_way(a, b), one_way(b, a))


def _segments(x: FloatArray, closed: bool | None) -> FloatArray:
    """Return the segments (s, 2, d) of a curve (n, d); one of length 0 for a single point."""
    ends = np.stack([x, np.roll(x, -1, axis=0)], axis=1)
    return ends if ends_of(x, closed).closed or len(x) == 1 else ends[:-1]


# Distances (k,) of points (k, d) from elements (k, corners, d), one by one.
_Distance = Callable[[FloatArray, FloatArray], FloatArray]


def _to_segments(x: FloatArray, ends: FloatArray) -> FloatArray:
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    square = (along**2).sum(axis=1)
    t = ((x - start) * along).sum(axis=1) / np.where(square > 0, square, 1)
    distance: FloatArray = np.linalg.norm(x - start - np.clip(t, 0, 1)[:, None] * along, axis=1)
    return distance


def _to_triangles(x: FloatArray, triangles: FloatArray) -> FloatArray:
    from trimesh import triangles as trimesh_triangles

    # relative to each point and the size of its triangle: trimesh takes products below 1e-12 for 0
    size = np.linalg.norm(triangles - triangles.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    around = (triangles - x[:, None]) / size[:, None, None]
    nearest: FloatArray = trimesh_triangles.closest_point(around, np.zeros_like(x))
    distance: FloatArray = np.linalg.norm(nearest, axis=1) * size
    return distance


def _distances(x: FloatArray, elements: FloatArray, distance: _Distance) -> FloatArray:
    """Compute the distance (n,) of each point (n, d) from the nearest of the elements (k, corners, d).

    The element with the nearest centre gives an upper bound. The centre of a nearer element is within this bound plus
    the radius of the element. Elements are searched in classes of similar radii (within a factor of 2), one tree each.
    """
    from scipy.spatial import cKDTree

    middles = elements.mean(axis=1)
    radii = np.linalg.norm(elements - middles[:, None], axis=2).max(axis=1)
    nearest = distance(x, elements[cKDTree(middles).query(x)[1]])
    sizes = np.frexp(radii)[1]
    for size in np.unique(sizes):
        members = np.flatnonzero(sizes == size)
        tree, reach = cKDTree(middles[members]), radii[members].max()
        step = max(1, _PAIRS // 32)
        for begin in range(0, len(x), step):
            part = slice(begin, begin + step)
            near = tree.query_ball_point(x[part], nearest[part] * (1 + 1e-9) + reach)
            counts: IntArray = np.fromiter(map(len, near), np.int64, len(near))
            at = np.repeat(np.arange(begin, begin + len(near)), counts)
            which = members[np.concatenate([np.asarray(n, np.int64) for n in near])] if len(at) else members[:0]
            for first in range(0, len(at), _PAIRS):
                u, v = at[first : first + _PAIRS], which[first : first + _PAIRS]
                np.minimum.at(nearest, u, distance(x[u], elements[v]))
    return nearest
