"""The common parts of pictures: figures and their files, sections of a volume, colours of pixels."""

from __future__ import annotations

import functools
import io
import os
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, unmasked
from ..checks import integer
from ..files.pictures import write_atomically
from ..graphs.edges import checked_spacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Path_ = str | os.PathLike[str]

# The colour of pixels without a finite value.
UNKNOWN = "#ff7f0e"
# Width of the widest panel and height of the highest column of panels, in inches.
_PANEL, _COLUMN = 4.6, 13.0
# Letters of the caption per inch.
_LETTERS = 12


def missing(name: str, package: str) -> ImportError:
    """Return the error for a library of the extra that is not installed."""
    return ImportError(f"this needs {package}: pip install 'gpureg[plot]'", name=name)


def check_path(path: Path_ | None) -> None:
    """Check the extension of a file before anything is computed.

    Raises
    ------
    ImportError
        Matplotlib is not installed.
    ValueError
        Matplotlib does not write this format.
    """
    try:
        from matplotlib.backend_bases import FigureCanvasBase
    except ImportError:
        raise missing("matplotlib", "matplotlib") from None
    kinds = FigureCanvasBase.get_supported_filetypes()
    if path is not None and Path(path).suffix.lower().removeprefix(".") not in kinds:
        raise ValueError(f"{path}: the extension must be one of {', '.join(f'.{kind}' for kind in sorted(kinds))}")


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = None) -> Figure:
    """Make an empty figure without a window or global state; sizes are in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure: Figure = _shown()(figsize=(width, height), dpi=110, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def _again() -> Any:
    """Make a figure without attributes, which pickle sets."""
    cls = _shown()
    return cls.__new__(cls)


@functools.cache
def _shown() -> Any:
    """Return a subclass of Matplotlib's figure that notebooks show without pyplot."""
    from matplotlib.figure import Figure

    class Shown(Figure):
        def _repr_png_(self) -> bytes:
            written = io.BytesIO()
            self.savefig(written, format="png")
            return written.getvalue()

        def __reduce__(self) -> Any:
            # pickle cannot find a local class by its name
            return _again, (), self.__getstate__()

    return Shown


def finish(figure: Figure, path: Path_ | None) -> Figure:
    """Write the figure to `path`, if given, and return it."""
    if path is not None:
        write_atomically(path, lambda temporary: figure.savefig(temporary))
    return figure


def as_picture(image: npt.ArrayLike, name: str, channel_axis: int | None) -> npt.NDArray[Any]:
    """Return a view of an image or a volume as (*shape, channels).

    Raises
    ------
    TypeError, ValueError
        The values are not real, the axis of the channels does not exist, or the other axes are not two or three.
    """
    array = unmasked(image, name)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{name} must hold real numbers, got {array.dtype}")
    if channel_axis is not None:
        axis = integer("channel_axis", channel_axis, low=-array.ndim, high=array.ndim - 1)
        array = np.moveaxis(array, axis, -1)
    else:
        array = array[..., None]
    if array.ndim not in (3, 4) or 0 in array.shape:
        raise ValueError(
            f"{name} must be an image of two axes or a volume of three, and an axis of channels (channel_axis), "
            f"got shape {np.shape(image)}"
        )
    return array


def finite(picture: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the finite values (n,)."""
    values: npt.NDArray[Any] = picture[np.isfinite(picture)]
    return values


def span(picture: npt.NDArray[Any]) -> tuple[float, float]:
    """Return the smallest and the largest finite value, changed to be different if they are equal."""
    values = finite(picture)
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    return (low, high) if high > low else (low, low + (abs(low) or 1.0))


@dataclass(frozen=True)
class Section:
    """A plane: a whole image, or a volume at the index `at` of the axis `fixed`."""

    rows: int
    columns: int
    fixed: int | None = None
    at: int = 0

    def of(self, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the plane of an array (*shape, ...)."""
        return array if self.fixed is None else array.take(self.at, axis=self.fixed)

    def size(self, shape: Sequence[float], spacing: Sequence[float]) -> tuple[float, float]:
        """Return height and width in the units of the spacing."""
        return shape[self.rows] * spacing[self.rows], shape[self.columns] * spacing[self.columns]

    def __str__(self) -> str:
        return "" if self.fixed is None else f"axis {self.fixed} at {self.at}"


def sections(at: Sequence[int]) -> list[Section]:
    """Return the planes through a pixel: one for an image, three for a volume."""
    if len(at) == 2:
        return [Section(0, 1)]
    return [Section(1, 2, 0, at[0]), Section(0, 2, 1, at[1]), Section(0, 1, 2, at[2])]


def as_spacing(spacing: Sequence[float] | None, ndim: int) -> tuple[float, ...]:
    """Check the distances between pixels; the default is 1."""
    return checked_spacing(spacing, ndim) or (1.0,) * ndim


def colours(plane: npt.NDArray[Any], black: float, white: float) -> FloatArray:
    """Convert pixels (H, W, m) to colours (H, W, 3): three channels are red, green and blue, others a mean grey.

    Pixels without a finite value get the colour `UNKNOWN`.
    """
    from matplotlib.colors import to_rgb

    values = plane.astype(np.float64)
    if values.shape[-1] != 3:
        values = values.mean(axis=-1, keepdims=True)
    known = np.isfinite(values).all(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        levels = np.clip((values - black) / (white - black), 0, 1)
    return np.where(known, levels, to_rgb(UNKNOWN))


def panels(
    cuts: Sequence[Section],
    shape: Sequence[int],
    steps: Sequence[float],
    titles: Sequence[str],
    caption: Sequence[str],
    *,
    bar: bool = True,
) -> tuple[Figure, Any, Axes | None]:
    """Make a figure, its axes (sections, titles) for pictures at one scale, and the axes of a colour bar if any.

    Matplotlib's layouts would shrink panels with sections of different shapes, or overlap titles.
    """
    sizes = [cut.size(shape, steps) for cut in cuts]
    widest = max(width for _, width in sizes)
    unit = min(_PANEL / widest, _COLUMN / sum(height for height, _ in sizes))
    # large enough for titles and ticks
    heights = [max(unit * height, 0.8) for height, _ in sizes]
    width, gap = max(unit * widest, 2.6), 0.12
    left, right = 0.12 if len(cuts) == 1 else 0.4, 1.1 if bar else 0.0
    above = 0.15 + 0.2 * max(title.count("\n") + 1 for title in titles)
    across = left + len(titles) * (width + gap) + right
    lines = [part for line in caption for part in textwrap.wrap(line, int(across * _LETTERS))]
    below = 0.12 + 0.2 * len(lines)
    total = (across, above + sum(heights) + gap * (len(cuts) - 1) + below)
    figure = new_figure(*total)

    def place(x: float, y: float, w: float, h: float) -> Axes:
        return figure.add_axes((x / total[0], y / total[1], w / total[0], h / total[1]))

    axes = np.empty((len(cuts), len(titles)), object)
    top = total[1] - above
    for row, cut, height in zip(axes, cuts, heights, strict=True):
        top -= height
        for k in range(len(titles)):
            row[k] = place(left + k * (width + gap), top, width, height)
            row[k].set_anchor("N")
        row[0].set_ylabel(str(cut))
        top -= gap
    for panel, title in zip(axes[0], titles, strict=True):
        panel.set_title(title, fontsize=11)
    if lines:
        figure.text(0.5, 0.08 / total[1], "\n".join(lines), ha="center", va="bottom", fontsize=10)
    if not bar:
        return figure, axes, None
    long = min(total[1] - above - below, _PANEL)
    return figure, axes, place(total[0] - right, total[1] - above - long, 0.18, long)


def show(axes: Axes, picture: FloatArray, cut: Section, steps: Sequence[float]) -> None:
    """Draw a picture (H, W, 3) in a panel, without ticks, with the aspect of the spacing."""
    axes.imshow(picture, aspect=steps[cut.rows] / steps[cut.columns])
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def unknown_in(pictures: Sequence[FloatArray]) -> list[str]:
    """Return a line for the caption if pixels without a finite value are drawn."""
    from matplotlib.colors import to_rgb

    drawn = any((picture == to_rgb(UNKNOWN)).all(axis=-1).any() for picture in pictures)
    return ["orange: no finite value"] if drawn else []
