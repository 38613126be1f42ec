"""What the pictures share: a figure and its file, sections of a volume, pixels as colours."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from ..graph import FloatArray, unmasked
from ..io import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Path_ = str | os.PathLike[str]

# The colour of pixels that have no value.
UNKNOWN = "#ff7f0e"
# Inches of the widest panel, and of the longest column of them.
_PANEL, _COLUMN = 4.6, 13.0


def missing(name: str, package: str) -> ImportError:
    """What to raise where a library of the extra is not installed."""
    return ImportError(f"this needs {package}: pip install 'gpureg[plot]'", name=name)


def check_path(path: Path_ | None) -> None:
    """Refuse a file whose extension is none of a picture, before anything is computed.

    Raises
    ------
    ImportError
        Matplotlib is not installed.
    ValueError
        The extension.
    """
    try:
        from matplotlib.backend_bases import FigureCanvasBase
    except ImportError:
        raise missing("matplotlib", "matplotlib") from None
    kinds = FigureCanvasBase.get_supported_filetypes()
    if path is not None and Path(path).suffix.lower().removeprefix(".") not in kinds:
        raise ValueError(f"{path}: the extension must be one of {', '.join(f'.{kind}' for kind in sorted(kinds))}")


def new_figure(width: float, height: float, layout: Literal["constrained", "compressed"] = "constrained") -> Figure:
    """An empty figure that no window and no global state knows, sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=110, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def finish(figure: Figure, path: Path_ | None) -> Figure:
    """The figure, once it is written to `path` where there is one."""
    if path is not None:
        write_atomically(path, lambda temporary: figure.savefig(temporary))
    return figure


def as_picture(image: npt.ArrayLike, name: str, channel_axis: int | None) -> npt.NDArray[Any]:
    """An image or a volume as (*shape, channels), a view.

    Raises
    ------
    TypeError, ValueError
        Values that are not real, an axis of channels that is not there, other than two or three axes beside it.
    """
    array = unmasked(image, name)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{name} must hold real numbers, got {array.dtype}")
    if channel_axis is not None:
        if not -array.ndim <= channel_axis < array.ndim:
            raise ValueError(f"channel_axis = {channel_axis} is no axis of {name}, which has shape {array.shape}")
        array = np.moveaxis(array, channel_axis, -1)
    else:
        array = array[..., None]
    if array.ndim not in (3, 4) or 0 in array.shape:
        raise ValueError(
            f"{name} must be an image of two axes or a volume of three, channels apart (channel_axis), "
            f"got shape {np.shape(image)}"
        )
    return array


@dataclass(frozen=True)
class Section:
    """A plane of an image or a volume: all of the former, or the latter at a place of one axis."""

    rows: int
    columns: int
    fixed: int | None = None
    at: int = 0

    def of(self, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The plane of an array on the grid, further axes kept."""
        return array if self.fixed is None else array.take(self.at, axis=self.fixed)

    def size(self, shape: Sequence[float], spacing: Sequence[float]) -> tuple[float, float]:
        """Height and width in the units of the spacing."""
        return shape[self.rows] * spacing[self.rows], shape[self.columns] * spacing[self.columns]

    def __str__(self) -> str:
        return "" if self.fixed is None else f"axis {self.fixed} at {self.at}"


def sections(at: Sequence[int]) -> list[Section]:
    """The planes through a pixel that are parallel to the axes: one of an image, three of a volume."""
    if len(at) == 2:
        return [Section(0, 1)]
    return [Section(1, 2, 0, at[0]), Section(0, 2, 1, at[1]), Section(0, 1, 2, at[2])]


def as_spacing(spacing: Sequence[float] | None, ndim: int) -> tuple[float, ...]:
    """The distances between pixels, checked; 1 where none are given."""
    steps = (1.0,) * ndim if spacing is None else tuple(float(step) for step in spacing)
    if len(steps) != ndim or not all(np.isfinite(step) and step > 0 for step in steps):
        raise ValueError(f"spacing must hold {ndim} finite numbers > 0, one per axis, got {spacing}")
    return steps


def colours(plane: npt.NDArray[Any], black: float, white: float) -> FloatArray:
    """Pixels (H, W, m) as colours (H, W, 3): three channels as they are, the mean of any other number as grey.

    What is not finite gets a colour of its own.
    """
    from matplotlib.colors import to_rgb

    values = plane.astype(np.float64)
    if values.shape[-1] != 3:
        values = values.mean(axis=-1, keepdims=True)
    known = np.isfinite(values).all(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        levels = np.clip((values - black) / (white - black), 0, 1)
    return np.where(known, levels, to_rgb(UNKNOWN))


def panels(cuts: Sequence[Section], shape: Sequence[int], steps: Sequence[float], columns: int, above: float) -> Any:
    """A figure and its axes (sections, columns), all at one scale, `above` inches left for what stands around them."""
    sizes = [cut.size(shape, steps) for cut in cuts]
    widest = max(width for _, width in sizes)
    unit = min(_PANEL / widest, _COLUMN / sum(height for height, _ in sizes))
    # not so flat or so narrow that the titles find no room
    heights = [max(unit * height, 0.4) for height, _ in sizes]
    figure = new_figure(columns * max(unit * widest, 2.6) + 1.2, sum(heights) + above, "compressed")
    axes = figure.subplots(len(cuts), columns, squeeze=False, gridspec_kw={"height_ratios": heights})
    return figure, axes


def show(axes: Axes, picture: FloatArray, cut: Section, steps: Sequence[float]) -> None:
    """Draw colours into a panel, without ticks, its pixels as high and wide as the spacing says."""
    axes.imshow(picture, aspect=steps[cut.rows] / steps[cut.columns])
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def add_bar(figure: Figure, mappable: Any, axes: Any, **settings: Any) -> None:
    """A colour bar at the right of a column of panels."""
    figure.colorbar(mappable, ax=list(axes), fraction=0.05, pad=0.02, panchor=False, **settings)


def unknown_in(pictures: Sequence[FloatArray]) -> list[str]:
    """A line for the caption where pixels without a value are drawn, else none."""
    from matplotlib.colors import to_rgb

    drawn = any((picture == to_rgb(UNKNOWN)).all(axis=-1).any() for picture in pictures)
    return ["orange: no finite value"] if drawn else []
