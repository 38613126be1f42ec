"""Convert point clouds of other libraries to an array of points, and back: :class:`Cloud`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import FloatArray, checked_points

KINDS = "an array (n, d), or a cloud of trimesh, PyVista or Open3D"


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points (n, d), and a function that makes a cloud of the input's type from other points in the same order."""

    points: FloatArray
    like: Callable[[FloatArray], Any]


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
        return Cloud(checked_points(points.points), lambda moved: _copied(points, "points", moved))
    if hasattr(points, "vertices") and hasattr(points, "copy"):  # trimesh
        return Cloud(checked_points(points.vertices), lambda moved: _copied(points, "vertices", moved))
    if hasattr(points, "has_points") and hasattr(points, "points"):  # Open3D
        return Cloud(checked_points(np.asarray(points.points)), lambda moved: _open3d(points, moved))
    if not isinstance(points, list | tuple) and not hasattr(points, "__array__"):
        raise TypeError(f"points must be {KINDS}; got {type(points).__name__}")
    found = checked_points(points)
    dtype = np.asarray(points).dtype
    kind = dtype if dtype.kind == "f" else np.dtype(np.float64)
    return Cloud(found, lambda moved: moved.astype(kind))


def _copied(cloud: Any, name: str, moved: FloatArray) -> Any:
    copy = cloud.copy()
    setattr(copy, name, moved)
    return copy


def _open3d(cloud: Any, moved: FloatArray) -> Any:
    copy = type(cloud)(cloud)
    # Open3D makes its vectors from arrays
    copy.points = type(cloud.points)(moved)
    return copy
