"""Draw triangle meshes side by side with one camera and one light, without a screen (figures 5 to 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, unmasked
from ..checks import choice, flag
from ..doors import door
from ..metrics import is_watertight, volume
from ..shapes.surface import Surface, face_normals, face_vectors, surface_of, vertex_normals
from .camera import PANEL, Axis, camera_of, panels_of
from .canvas import Path_, check_path, finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Shading = Literal["flat", "smooth"]

_CLAY = (0.80, 0.79, 0.76)
# Directions to two lights in the camera's frame (right, up, to the viewer), with their strengths as lengths, and the
# strength of the ambient light.
_LIGHTS, _AMBIENT = np.array([[-0.36, 0.44, 0.56], [0.26, -0.05, 0.15]]), 0.24


@door
def meshes(
    meshes: Mapping[str, Any] | Sequence[Any],
    *,
    view: tuple[float, float] | Literal["auto"] = "auto",
    up: Axis | None = None,
    values: Sequence[npt.ArrayLike] | None = None,
    shading: Shading = "flat",
    edges: bool = False,
    caption: str = "",
    path: Path_ | None = None,
) -> Figure:
    """Draw meshes side by side, in parallel projection, from one direction and at one scale.

    Parameters
    ----------
    meshes : sequence or mapping of meshes
        Each as for :func:`gpureg.denoise_mesh`; the keys of a mapping are titles.
    view : (azimuth, elevation) or "auto", default "auto"
        Direction of the viewer, in degrees: the elevation above the horizon, and the azimuth around the axis `up`, 0 at
        the next axis (x after z, y after x, z after y). "auto" looks along the direction of least variance of the
        first mesh, slightly from above and from the side.
    up : {"x", "y", "z"}, optional
        The axis that points up. The default is y, as in most files, or z if y points at the viewer.
    values : sequence of arrays, optional
        Values for the colours of each mesh, for its n vertices or faces: (n,), drawn with a colour bar, or (n, 3), red,
        green and blue from 0 to 1. The default is one colour.
    shading : {"flat", "smooth"}, default "flat"
        "flat" shades each face separately, so that all faces are visible; "smooth" interpolates between the vertices.
    edges : bool, default False
        Whether to draw the edges.
    caption : str, optional
        Text below the figure.
    path : path, optional
        File to write, in a format of matplotlib: .png, .pdf, .svg.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ImportError
        matplotlib is not installed.
    OSError
        The file cannot be written; no partial file is left.
    TypeError, ValueError
        A mesh is wrong, values have another length, or matplotlib does not write the format.

    Notes
    -----
    Faces are drawn from the farthest to the nearest by the depth of their centres. Faces that look away are left out of
    closed meshes, and shaded like the others in open meshes.
    """
    check_path(path)
    choice("shading", shading, get_args(Shading))
    edges = flag("edges", edges)
    titles, surfaces = _listed(meshes)
    painted = _colours(values, surfaces)
    first = surfaces[0]
    vectors = face_vectors(first.vertices, first.faces)
    outward = vectors.sum(axis=0) / max(float(np.linalg.norm(vectors, axis=1).sum()), np.finfo(float).tiny)
    camera = camera_of(first.vertices[np.unique(first.faces)], view, up, outward)
    seen = [camera.seen(surface.vertices) for surface in surfaces]
    used = [points[np.unique(surface.faces)] for points, surface in zip(seen, surfaces, strict=True)]
    low, high = (end(np.concatenate(used)[:, :2], axis=0) for end in (np.min, np.max))
    size = np.maximum(high - low, 1e-12 + 0.02 * (high - low).max())
    figure, panels = panels_of(size, titles, caption, bar=painted.bar is not None)
    for axes, title, surface, points, colours in zip(panels, titles, surfaces, seen, painted.colours, strict=True):
        _draw(axes, surface, points, colours, shading, edges)
        middle = (low + high) / 2
        axes.set_xlim(middle[0] - 0.51 * size[0], middle[0] + 0.51 * size[0])
        axes.set_ylim(middle[1] - 0.51 * size[1], middle[1] + 0.51 * size[1])
        axes.set_aspect("equal")
        axes.set_axis_off()
        axes.set_title(title, fontsize=11)
    if painted.bar is not None:
        width, height = figure.get_size_inches()
        long = min(0.8 * height, PANEL)
        figure.colorbar(
            painted.bar, cax=figure.add_axes((1 - 1.0 / width, 0.5 - long / height / 2, 0.18 / width, long / height))
        )
    return finish(figure, path)


def _listed(meshes: Mapping[str, Any] | Sequence[Any]) -> tuple[list[str], list[Surface]]:
    if isinstance(meshes, Mapping):
        titles, given = [str(title) for title in meshes], list(meshes.values())
    elif isinstance(meshes, Sequence):
        titles, given = [""] * len(meshes), list(meshes)
    else:
        raise TypeError(f"meshes must be a sequence of meshes, or a mapping from titles to meshes, got {type(meshes)}")
    if not given:
        raise ValueError("there is no mesh to draw")
    try:
        return titles, [surface_of(mesh) for mesh in given]
    except TypeError as error:
        raise TypeError(f"{error}; give a single mesh in a list") from None


@dataclass(frozen=True, eq=False)
class _Painted:
    """Colours of each mesh, (k, 3), by vertex or by face, and the scale of the colour bar."""

    colours: list[FloatArray]
    bar: Any = None


def _colours(values: Sequence[npt.ArrayLike] | None, surfaces: Sequence[Surface]) -> _Painted:
    if values is None:
        return _Painted([np.broadcast_to(_CLAY, (len(surface.faces), 3)) for surface in surfaces])
    if len(values) != len(surfaces):
        raise ValueError(f"values must hold an array for each of the {len(surfaces)} meshes, got {len(values)}")
    arrays = []
    for k, (given, surface) in enumerate(zip(values, surfaces, strict=True)):
        array = unmasked(given, "values").astype(np.float64)
        counts = (len(surface.vertices), len(surface.faces))
        if array.ndim not in (1, 2) or len(array) not in counts or array.shape[1:] not in ((), (3,)):
            raise ValueError(
                f"values[{k}] must have a number, or three, for each of {counts[0]} vertices or {counts[1]} faces, "
                f"got shape {array.shape}"
            )
        if not np.isfinite(array).all():
            raise ValueError(f"values[{k}] must be finite")
        arrays.append(array)
    numbers = [array for array in arrays if array.ndim == 1]
    if not numbers:
        return _Painted([np.clip(array, 0, 1) for array in arrays])
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    low, high = min(array.min() for array in numbers), max(array.max() for array in numbers)
    bar = ScalarMappable(Normalize(low, high if high > low else low + 1), colormaps["viridis"])
    return _Painted([bar.to_rgba(array)[:, :3] if array.ndim == 1 else np.clip(array, 0, 1) for array in arrays], bar)


def _draw(axes: Axes, surface: Surface, seen: FloatArray, colours: FloatArray, shading: Shading, edges: bool) -> None:
    """Draw faces from far to near, as one collection."""
    from matplotlib.collections import PolyCollection, TriMesh
    from matplotlib.tri import Triangulation

    faces = surface.faces
    normals = face_normals(seen, faces)
    # a closed surface hides its inside; both sides of an open surface are visible, and lit
    outside = np.sign(volume((seen, faces))) if is_watertight((seen, faces)) else 0.0
    faces_us = outside * normals[:, 2] > 0 if outside else normals.any(axis=1)
    order = np.flatnonzero(faces_us)
    if not len(order):
        return
    order = order[np.argsort(seen[faces[order], 2].mean(axis=1), kind="stable")]
    corners = faces[order]
    by_vertex = len(colours) == len(seen) and len(colours) != len(faces)
    outlines: Any = seen[corners, :2]
    line: dict[str, Any] = {"edgecolors": (0.15, 0.15, 0.2, 0.6), "linewidths": 0.25, "rasterized": True}
    # rasterized, or the faces would take megabytes in a .pdf or .svg
    if shading == "smooth":
        whole, which = Surface(seen, faces, surface.make).welded()
        light = _light(vertex_normals(whole.vertices, whole.faces), outside)[which]
        base = colours if by_vertex else _at_vertices(colours, faces, len(seen))
        drawn = TriMesh(Triangulation(seen[:, 0], seen[:, 1], corners), rasterized=True)
        drawn.set_facecolor(np.clip(base * light[:, None], 0, 1))
        axes.add_collection(drawn)
        if edges:
            axes.add_collection(PolyCollection(outlines, facecolors="none", **line))
        return
    base = colours[corners].mean(axis=1) if by_vertex else colours[order]
    shown = np.clip(base * _light(normals[order], outside)[:, None], 0, 1)
    if not edges:
        # lines in the face's colour close the gaps between antialiased neighbours
        line |= {"edgecolors": "face", "linewidths": 0.3}
    axes.add_collection(PolyCollection(outlines, facecolors=shown, **line))


def _light(normals: FloatArray, outside: float) -> FloatArray:
    """Return Lambert's brightness (n,) for unit normals (n, 3), on the side `outside`, or on the visible side if 0."""
    lit = normals * (outside or np.where(normals[:, 2:] < 0, -1, 1))
    bright: FloatArray = _AMBIENT + np.maximum(lit @ _LIGHTS.T, 0).sum(axis=1)
    return bright


def _at_vertices(colours: FloatArray, faces: npt.NDArray[Any], n: int) -> FloatArray:
    """Return the mean colour (n, 3) of the faces around each vertex."""
    count = np.maximum(np.bincount(faces.ravel(), minlength=n), 1)
    sums = [np.bincount(faces.ravel(), weights=np.repeat(c, 3), minlength=n) for c in colours.T]
    return np.stack(sums, axis=1) / count[:, None]
