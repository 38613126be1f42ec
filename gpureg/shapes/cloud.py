"""Convert point clouds of other libraries to an array of points, and back: :class:`Cloud`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import FloatArray, checked_points

KINDS = "an array (n, d), or a cloud of trimesh, PyVista or Open3D"

# Names of normals among the data of PyVista's points.
_NORMALS = ("normals", "normal", "point_normals")

# Makes a cloud from points (n, d) and, if the input has normals, their new ones.
Like = Callable[[FloatArray, FloatArray | None], Any]


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points, and a function that makes a cloud of the input's type from other points in the same order.

    Attributes
    ----------
    points : (n, d) float array
    like : callable
        ``like(points, normals)`` copies the input with other points; if it has normals, with other normals, or without
        if they are None.
    normals : (n, d) float array or None
        The normals of the input, if it has some.
    lost : tuple of str
        What the copy with other points has not, as it would be wrong, in words.
    """

    points: FloatArray
    like: Like
    normals: FloatArray | None = None
    lost: tuple[str, ...] = ()


def cloud_of(points: Any) -> Cloud:
    """Convert points of a supported type to a cloud, and check it; a :class:`Cloud` is returned unchanged.

    Parameters
    ----------
    points : (n, d) array, trimesh.PointCloud, pyvista.PolyData or open3d.geometry.PointCloud

    Raises
    ------
    TypeError, ValueError
        Another type; points that are not finite; a mesh with faces.
    """
    if isinstance(points, Cloud):
        return points
    pyvista = hasattr(points, "point_data") and hasattr(points, "points")
    # asked of the type, because a mesh would compute its normals
    faces = len(getattr(points, "faces", ())) > 0 if pyvista else hasattr(type(points), "face_normals")
    if faces or len(getattr(points, "triangles", ())):
        raise TypeError("this is a mesh with faces: use gpureg.denoise_mesh, or give only its vertices")
    if pyvista:
        return _of_pyvista(points)
    if hasattr(points, "vertices") and hasattr(points, "copy"):  # trimesh, whose clouds have no normals
        return Cloud(checked_points(points.vertices), lambda moved, normals: _copied(points, "vertices", moved))
    if hasattr(points, "has_points") and hasattr(points, "points"):
        return _of_open3d(points)
    if not isinstance(points, list | tuple) and not hasattr(points, "__array__"):
        raise TypeError(f"points must be {KINDS}; got {type(points).__name__}")
    found = checked_points(points)
    dtype = np.asarray(points).dtype
    kind = dtype if dtype.kind == "f" else np.dtype(np.float64)
    return Cloud(found, lambda moved, normals: moved.astype(kind))


def _copied(cloud: Any, name: str, moved: FloatArray) -> Any:
    copy = cloud.copy()
    setattr(copy, name, moved)
    return copy


def _of_pyvista(cloud: Any) -> Cloud:
    x = checked_points(cloud.points)
    names = [name for name in cloud.point_data if str(name).lower() in _NORMALS]
    arrays = {name: np.asarray(cloud.point_data[name]) for name in names}
    arrays = {name: array for name, array in arrays.items() if array.shape == x.shape and array.dtype.kind == "f"}

    def like(moved: FloatArray, normals: FloatArray | None) -> Any:
        copy = _copied(cloud, "points", moved)
        for name, array in arrays.items():
            if normals is None:
                del copy.point_data[name]
            else:
                copy.point_data[name] = normals.astype(array.dtype)
        return copy

    return Cloud(x, like, next((array.astype(np.float64) for array in arrays.values()), None))


def _of_open3d(cloud: Any) -> Cloud:
    x = checked_points(np.asarray(cloud.points))
    given = np.asarray(cloud.normals, np.float64) if cloud.has_normals() else None
    # of the points around each one
    covariances = hasattr(cloud, "has_covariances") and bool(cloud.has_covariances())

    def like(moved: FloatArray, normals: FloatArray | None) -> Any:
        copy = type(cloud)(cloud)
        # Open3D makes its vectors from arrays
        copy.points = type(cloud.points)(moved)
        if given is not None:
            copy.normals = type(cloud.normals)(np.zeros((0, 3)) if normals is None else normals)
        if covariances:
            copy.covariances = type(cloud.covariances)()
        return copy

    return Cloud(x, like, given, ("the covariances of the points",) if covariances else ())
