"""Draw an image, its partition, and the values of its regions side by side (Fig. 4 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..doors import door
from .canvas import Path_, as_picture, as_spacing, check_path, colours, finish, panels, sections, show, span, unknown_in

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@door
def simplification(
    image: npt.ArrayLike,
    partition: npt.ArrayLike,
    fine: npt.ArrayLike,
    value: npt.ArrayLike,
    *,
    path: Path_ | None = None,
    spacing: Sequence[float] | None = None,
    caption: str = "",
    channel_axis: int | None = None,
) -> Figure:
    """Draw an image | its partition | the values of the fine partition | the regularized values.

    Parameters
    ----------
    image, fine, value : array
        Arrays of one shape: two or three axes, and an axis of channels if any. Three planes through the middle of a
        volume are drawn.
    partition : uint8 array
        Colours of the regions, (..., 3), from :meth:`gpureg.Regions.random_colours`.
    path : path, optional
        File to write, in a format of matplotlib: .png, .pdf, .svg.
    spacing : sequence of float, optional
        Distance between pixels along each axis. The default is 1.
    caption : str, optional
        Text below the figure.
    channel_axis : int, optional
        Axis of the channels; None for grey.

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
        The shapes differ, values are not real, or matplotlib does not write the format.
    """
    check_path(path)
    given = {"image": image, "fine": fine, "value": value}
    pictures = [as_picture(array, name, channel_axis) for name, array in given.items()]
    painted = as_picture(partition, "partition", -1)
    for name, picture in zip(("fine", "value", "partition"), (*pictures[1:], painted), strict=True):
        if picture.shape[:-1] != pictures[0].shape[:-1]:
            where = pictures[0].shape[:-1]
            raise ValueError(f"{name} must have the image's shape {where}, got {picture.shape[:-1]}")
    black, white = span(pictures[0])
    if pictures[0].dtype == np.uint8:
        black, white = 0.0, 255.0
    ends = [(black, white), (0.0, 255.0), (black, white), (black, white)]
    drawn = [pictures[0], painted, *pictures[1:]]
    steps = as_spacing(spacing, painted.ndim - 1)
    cuts = sections([size // 2 for size in painted.shape[:-1]])
    rows = [[colours(cut.of(x), *range_) for x, range_ in zip(drawn, ends, strict=True)] for cut in cuts]
    below = [*caption.splitlines(), *unknown_in([picture for row in rows for picture in row])]
    titles = ["image", "partition", "fine", "regularized"]
    figure, axes, _ = panels(cuts, painted.shape, steps, titles, below, bar=False)
    for row, cut, planes in zip(axes, cuts, rows, strict=True):
        for panel, plane in zip(row, planes, strict=True):
            show(panel, plane, cut, steps)
    return finish(figure, path)
