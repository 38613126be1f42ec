"""The neighbourhood of a pixel: :func:`window_of`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..graphs.edges import Metric
from ..graphs.grid import GridGraph


@dataclass(frozen=True)
class Window:
    """The neighbourhood of every pixel, as :class:`gpureg.GridGraph` takes it.

    Attributes
    ----------
    radius : float
        Radius of the window, in the units of `spacing`.
    metric : {"chebyshev", "euclidean", "cityblock"}
    spacing : tuple of float, one per axis, or None
        Size of a cell along each axis; None if `radius` is in cells.
    sides : tuple of int, one per axis
        Sides of the window in cells.
    """

    radius: float
    metric: Metric
    spacing: tuple[float, ...] | None
    sides: tuple[int, ...]


def cell_sizes(spacing: Sequence[float] | None) -> tuple[float, float]:
    """Return the smallest and the largest side of a cell; 1 for an invalid spacing, which the grid refuses later."""
    if spacing is None or np.ndim(spacing) != 1 or not len(spacing):
        return 1.0, 1.0
    return float(min(spacing)), float(max(spacing))


def window_of(
    shape: tuple[int, ...],
    *,
    radius: float | None,
    metric: Metric | None,
    spacing: Sequence[float] | None,
    local: bool,
    wide: float = 10.0,
) -> tuple[Window, str]:
    """Choose the window on a grid.

    Parameters
    ----------
    shape : tuple of int
        Shape of the grid.
    radius, metric, spacing
        Given values, which are not changed; None to choose them.
    local : bool
        Whether the weights do not depend on the data, so that a wide window would only blur: without a radius the
        window is that of the nearest neighbours.
    wide : float, default 10
        Default radius in a 2-D image, in the smallest cells; in a volume it is 2.

    Returns
    -------
    Window
    str
        The reason for its radius.

    Raises
    ------
    TypeError, ValueError
        As :class:`gpureg.GridGraph`.
    """
    if metric is None:
        metric = "cityblock" if local and radius is None else "chebyshev"
    # The given values are checked here, even if they are not used. A small image makes the window smaller.
    widest = 1.0 if spacing is None or np.ndim(spacing) != 1 else max(spacing, default=1.0)
    given = GridGraph(shape, widest if radius is None else radius, metric, spacing=spacing)
    steps: tuple[float, ...] | None
    if radius is not None:
        reach, steps, why = float(radius), given.spacing, "given"
    elif local:
        # The nearest neighbours at any spacing: constant weights do not depend on distances.
        reach, steps, why = 1.0, None, "rule: the nearest neighbours"
    else:
        # at least one cell along every axis
        finest, coarsest = cell_sizes(given.spacing)
        reach, steps = max((2.0 if len(shape) > 2 else wide) * finest, coarsest), given.spacing
        why = "rule: so many of the smallest cells"
    offsets = GridGraph(shape, reach, metric, spacing=steps).offsets
    sides = tuple((2 * np.abs(offsets).max(axis=0, initial=0) + 1).tolist())
    return Window(reach, metric, steps, sides), why
