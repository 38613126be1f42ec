"""The common parts of the figures: captions, numbers, and a sheet of pictures."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..files.pictures import write_files
from ..plot.canvas import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Letters of a caption per inch.
_LETTERS = 13


@dataclass(frozen=True, eq=False)
class Drawn:
    """A figure with its caption and numbers.

    Attributes
    ----------
    title : str
        Number and subject of the figure.
    settings : str
        Graph, weights, p, lam and iterations, and which of them the paper gives.
    see : str
        Description of the result, with numbers.
    numbers : dict
        All numbers, for JSON.
    figure : matplotlib.figure.Figure
    """

    title: str
    settings: str
    see: str
    numbers: dict[str, Any]
    figure: Figure

    def write(self, path: Path) -> None:
        """Write the picture, and the caption and numbers as JSON with the same name; both or none."""
        words = {"title": self.title, "settings": self.settings, "see": self.see}
        text = json.dumps(_finite(words | self.numbers), indent=1, allow_nan=False) + "\n"
        write_files(
            {
                path: lambda temporary: self.figure.savefig(temporary),
                path.with_suffix(".json"): lambda temporary: temporary.write_text(text, "utf-8"),
            }
        )


def _finite(value: Any) -> Any:
    """Replace NaN and infinity, which JSON does not have, by None."""
    if isinstance(value, dict):
        return {key: _finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def caption(title: str, settings: str, see: str) -> str:
    """Join the lines of a caption."""
    return f"{title}\n{settings}\n{see}"


class Panel(NamedTuple):
    """A picture of a sheet: grey (H, W), or colour (H, W, 3), from 0 to 255."""

    title: str
    picture: npt.NDArray[Any]


def write_below(figure: Figure, words: str) -> None:
    """Write a caption below the figure; the layout makes room for it."""
    across = int(figure.get_size_inches()[0] * _LETTERS)
    lines = [line for paragraph in words.splitlines() for line in textwrap.wrap(paragraph, across)]
    layout: Any = figure.get_layout_engine()
    layout.set(w_pad=0.06, h_pad=0.06)
    figure.supxlabel("\n".join(lines), fontsize=10)


def show(axes: Axes, panel: Panel) -> None:
    """Draw a picture in axes."""
    picture = panel.picture
    if picture.ndim == 3:
        picture = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    axes.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    axes.set_title(panel.title, fontsize=10)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def pictures(rows: Sequence[Sequence[Panel]], words: str, names: Sequence[str] = ()) -> Figure:
    """Draw pictures of one shape in rows, which may have names, with a caption below."""
    columns = max(map(len, rows))
    height, width = rows[0][0].picture.shape[:2]
    side = 3.0 if columns > 3 else 3.9
    scale = side / max(height, width)
    titled = 0.2 + 0.18 * max(panel.title.count("\n") + 1 for row in rows for panel in row)
    across = columns * (scale * width + 0.1) + (0.4 if names else 0.1)
    lines = sum(len(textwrap.wrap(line, int(across * _LETTERS))) for line in words.splitlines())
    figure = new_figure(across, len(rows) * (scale * height + titled) + 0.2 + 0.2 * lines, "constrained")
    axes = figure.subplots(len(rows), columns, squeeze=False)
    for k, (line, row) in enumerate(zip(axes, rows, strict=True)):
        for place, panel in zip(line, row, strict=False):
            show(place, panel)
        for place in line[len(row) :]:
            place.set_axis_off()
        if names:
            line[0].set_ylabel(names[k], fontsize=12)
    write_below(figure, words)
    return figure


def share(part: float, whole: float, digits: int = 4) -> float:
    """Return part / whole, rounded; NaN if the whole is 0, such as the volume of a flat sheet."""
    return round(part / whole, digits) if whole else float("nan")


def psnr(picture: npt.NDArray[Any], truth: npt.NDArray[Any]) -> float:
    """Compute the peak signal-to-noise ratio in dB, for a peak of 255."""
    from skimage.metrics import peak_signal_noise_ratio

    return round(
        float(peak_signal_noise_ratio(np.asarray(truth, float), np.asarray(picture, float), data_range=255)), 2
    )
