"""Draw polygonal curves and skeletons (figures 5, 7 and 9), without a screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, checked_points
from ..checks import flag
from ..curves.skeletons import Skeleton
from ..doors import door
from .camera import panels_of
from .canvas import Path_, check_path, finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Vertices are marked in panels with at most this number of them.
_MARKED = 1500


@door
def curves(
    curves: Mapping[str, Any] | Sequence[Any],
    *,
    closed: bool | Sequence[bool] = True,
    vertices: bool | None = None,
    upright: bool = True,
    caption: str = "",
    path: Path_ | None = None,
) -> Figure:
    """Draw curves side by side at one scale, their vertices marked.

    Parameters
    ----------
    curves : sequence or mapping of curves
        One panel each: an (n, 2) array, or a list of such arrays; the keys of a mapping are titles.
    closed : bool or sequence of bool, default True
        Whether the last vertex is joined to the first: for all curves, or for each curve of a panel.
    vertices : bool, optional
        Whether to mark the vertices. The default is to mark them in panels with at most 1500.
    upright : bool, default True
        Whether y points up; if False, it points down, as the rows of images.
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
        A curve is not (n, 2), or matplotlib does not write the format.
    """
    check_path(path)
    upright = flag("upright", upright)
    vertices = None if vertices is None else flag("vertices", vertices)
    titles, given = _listed(curves)
    panels_of_curves = [_several(panel) for panel in given]
    together = np.concatenate([x for panel in panels_of_curves for x in panel])
    figure, panels = _panels(together, titles, caption, upright)
    for axes, panel in zip(panels, panels_of_curves, strict=True):
        shut = [flag("closed", each) for each in ([closed] * len(panel) if np.ndim(closed) == 0 else closed)]  # type: ignore[union-attr]
        if len(shut) != len(panel):
            raise ValueError(f"closed must be one bool, or one for each of {len(panel)} curves")
        marked = sum(map(len, panel)) <= _MARKED if vertices is None else vertices
        for x, is_closed in zip(panel, shut, strict=True):
            line = np.concatenate([x, x[:1]]) if is_closed else x
            axes.plot(line[:, 0], line[:, 1], color="#1f4e79", linewidth=1.0, solid_joinstyle="round")
            if marked:
                axes.plot(x[:, 0], x[:, 1], ".", color="#c0392b", markersize=3.5)
    return finish(figure, path)


@door
def skeleton(
    skeletons: Any,
    *,
    upright: bool = True,
    caption: str = "",
    path: Path_ | None = None,
) -> Figure:
    """Draw polygons with their skeletons, one colour for each branch.

    Parameters
    ----------
    skeletons : Skeleton, or sequence or mapping of Skeleton
        A mapping has one panel for each item, with the key as title; a sequence has one panel.
    upright, caption, path
        As in :func:`gpureg.plot.curves`.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ImportError, OSError, TypeError, ValueError
        As :func:`gpureg.plot.curves`.
    """
    check_path(path)
    upright = flag("upright", upright)
    given = skeletons if isinstance(skeletons, Mapping) else {"": skeletons}
    shown = {title: [each] if isinstance(each, Skeleton) else list(each) for title, each in given.items()}
    if (
        not shown
        or not all(shown.values())
        or not all(isinstance(s, Skeleton) for each in shown.values() for s in each)
    ):
        raise TypeError(
            "skeletons must be results of gpureg.curves.skeletons: one, a sequence, or a mapping from titles to them"
        )
    together = np.concatenate([s.points for each in shown.values() for s in each])
    figure, panels = _panels(together, [str(title) for title in shown], caption, upright)
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection

    for axes, each in zip(panels, shown.values(), strict=True):
        k = 0
        for one in each:
            axes.fill(one.points[:, 0], one.points[:, 1], facecolor="#dde6ee", edgecolor="#8aa0b4", linewidth=0.7)
            lines = [one.positions[chain] for chain in one.branches()]
            colours = colormaps["tab10"]((np.arange(k, k + len(lines)) % 10 + 0.5) / 10)
            axes.add_collection(LineCollection(lines, colors=list(colours), linewidths=1.6, capstyle="round"))
            k += len(lines)
    return finish(figure, path)


def _panels(
    together: npt.NDArray[Any], titles: Sequence[str], caption: str, upright: bool
) -> tuple[Figure, list[Axes]]:
    low, high = together.min(axis=0), together.max(axis=0)
    size = np.maximum(high - low, 1e-12 + 0.02 * (high - low).max())
    figure, panels = panels_of(size, titles, caption, bar=False)
    middle = (low + high) / 2
    for axes, title in zip(panels, titles, strict=True):
        axes.set_xlim(middle[0] - 0.53 * size[0], middle[0] + 0.53 * size[0])
        ends = (middle[1] - 0.53 * size[1], middle[1] + 0.53 * size[1])
        axes.set_ylim(*(ends if upright else ends[::-1]))
        axes.set_aspect("equal")
        axes.set_axis_off()
        axes.set_title(title, fontsize=11)
    return figure, panels


def _listed(curves: Any) -> tuple[list[str], list[Any]]:
    if isinstance(curves, Mapping):
        titles, given = [str(title) for title in curves], list(curves.values())
    elif isinstance(curves, list | tuple):
        titles, given = [""] * len(curves), list(curves)
    else:
        raise TypeError(f"curves must be a sequence of curves, or a mapping from titles to curves, got {type(curves)}")
    if not given:
        raise ValueError("there is no curve to draw")
    return titles, given


def _several(panel: Any) -> list[FloatArray]:
    many = isinstance(panel, list | tuple) and all(np.ndim(x) == 2 for x in panel)
    parts = [checked_points(x, "curves") for x in (panel if many else [panel])]
    if not parts or any(x.shape[1] != 2 for x in parts):
        raise ValueError("curves must have shape (n, 2)")
    return parts
