"""Draw point clouds side by side with one camera, without a screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, unmasked
from ..checks import number
from ..doors import door
from ..shapes.cloud import cloud_of
from .camera import PANEL, Axis, camera_of, panels_of
from .canvas import Path_, check_path, finish

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Number of different colours for classes.
_CLASSES = 20


@door
def points(
    points: Mapping[str, Any] | Sequence[Any],
    *,
    values: Sequence[npt.ArrayLike] | None = None,
    view: tuple[float, float] | Literal["auto"] = "auto",
    up: Axis | None = None,
    size: float | None = None,
    caption: str = "",
    path: Path_ | None = None,
) -> Figure:
    """Draw point clouds side by side, in parallel projection, from one direction and at one scale.

    Parameters
    ----------
    points : sequence or mapping of clouds
        Each as for :func:`gpureg.denoise_points`, (n, 2) or (n, 3); the keys of a mapping are titles.
    values : sequence of arrays, optional
        Values for the colours of each cloud: integers (n,) are classes, floats (n,) are drawn with a colour bar, (n, 3)
        are red, green and blue from 0 to 1. The default is colours by depth.
    view, up
        As in :func:`gpureg.plot.meshes`; without effect on points (n, 2).
    size : float, optional
        Diameter of a point, in 1/72 inch. The default depends on the number of points.
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
        A cloud is not (n, 2) or (n, 3), values have another length, or matplotlib does not write the format.
    """
    check_path(path)
    if size is not None:
        number("size", size, above=0)
    titles, clouds = _listed(points)
    seen = [_flat(cloud) for cloud in clouds]
    if clouds[0].shape[1] == 3:
        camera = camera_of(clouds[0], view, up, np.zeros(3))
        seen = [camera.seen(cloud) for cloud in clouds]
    colours, bar = _colours(values, seen)
    together = np.concatenate(seen)[:, :2]
    # without outliers, which would make the other points small
    low, high = np.percentile(together, 0.1, axis=0), np.percentile(together, 99.9, axis=0)
    extent = np.maximum(high - low, 1e-12 + 0.02 * (high - low).max())
    figure, panels = panels_of(extent, titles, caption, bar=bar is not None)
    for axes, title, cloud, colour in zip(panels, titles, seen, colours, strict=True):
        order = np.argsort(cloud[:, 2], kind="stable")
        dot = float(np.clip(220 / np.sqrt(len(cloud)), 0.8, 5)) if size is None else size
        axes.scatter(cloud[order, 0], cloud[order, 1], s=dot**2, c=colour[order], linewidths=0, rasterized=True)
        middle = (low + high) / 2
        axes.set_xlim(middle[0] - 0.54 * extent[0], middle[0] + 0.54 * extent[0])
        axes.set_ylim(middle[1] - 0.54 * extent[1], middle[1] + 0.54 * extent[1])
        axes.set_aspect("equal")
        axes.set_axis_off()
        axes.set_title(title, fontsize=11)
    if bar is not None:
        width, height = figure.get_size_inches()
        long = min(0.8 * height, PANEL)
        figure.colorbar(
            bar, cax=figure.add_axes((1 - 1.0 / width, 0.5 - long / height / 2, 0.18 / width, long / height))
        )
    return finish(figure, path)


def _listed(points: Any) -> tuple[list[str], list[FloatArray]]:
    if isinstance(points, Mapping):
        titles, given = [str(title) for title in points], list(points.values())
    elif isinstance(points, list | tuple):
        titles, given = [""] * len(points), list(points)
    else:
        raise TypeError(f"points must be a sequence of clouds, or a mapping from titles to clouds, got {type(points)}")
    if not given:
        raise ValueError("there is no cloud of points to draw")
    clouds = [cloud_of(cloud).points for cloud in given]
    if len({cloud.shape[1] for cloud in clouds}) > 1 or clouds[0].shape[1] not in (2, 3):
        shapes = ", ".join(str(cloud.shape) for cloud in clouds)
        raise ValueError(f"all clouds must have shape (n, 2), or all (n, 3), got {shapes}")
    return titles, clouds


def _flat(cloud: FloatArray) -> FloatArray:
    return np.concatenate([cloud, np.zeros((len(cloud), 1))], axis=1)[:, :3]


def _colours(values: Sequence[npt.ArrayLike] | None, seen: Sequence[FloatArray]) -> tuple[list[FloatArray], Any]:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    if values is None:
        depths = np.concatenate([cloud[:, 2] for cloud in seen])
        low, high = float(depths.min()), float(depths.max())
        shade = colormaps["viridis_r"]
        return [shade(0.15 + 0.8 * (cloud[:, 2] - low) / ((high - low) or 1))[:, :3] for cloud in seen], None
    if len(values) != len(seen):
        raise ValueError(f"values must hold an array for each of the {len(seen)} clouds, got {len(values)}")
    arrays = []
    for k, (given, cloud) in enumerate(zip(values, seen, strict=True)):
        array = unmasked(given, "values")
        if array.shape not in ((len(cloud),), (len(cloud), 3)) or array.dtype.kind not in "biuf":
            raise ValueError(
                f"values[{k}] must have a number, or three, for each of {len(cloud)} points, got {array.shape}"
            )
        if not np.isfinite(array).all():
            raise ValueError(f"values[{k}] must be finite")
        arrays.append(array)
    numbers = [array for array in arrays if array.ndim == 1 and array.dtype.kind == "f"]
    bar = None
    if numbers:
        low, high = min(array.min() for array in numbers), max(array.max() for array in numbers)
        bar = ScalarMappable(Normalize(low, high if high > low else low + 1), colormaps["viridis"])
    painted: list[FloatArray] = []
    for array in arrays:
        if array.ndim == 2:
            painted.append(np.clip(array.astype(np.float64), 0, 1))
        elif array.dtype.kind == "f":
            assert bar is not None
            painted.append(bar.to_rgba(array)[:, :3])
        else:
            classes = np.unique(array, return_inverse=True)[1].ravel()
            painted.append(colormaps["tab20"]((classes % _CLASSES + 0.5) / _CLASSES)[:, :3])
    return painted, bar
