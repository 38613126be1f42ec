"""The common parts of pictures of shapes: a camera, and panels side by side."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from ..arrays import FloatArray
from ..checks import choice
from .canvas import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Axis = Literal["x", "y", "z"]

# Longer side of a panel, in inches, and the number of panels in a row.
PANEL, _ACROSS = 4.6, 4
# Letters of the caption per inch.
_LETTERS = 12


@dataclass(frozen=True, eq=False)
class Camera:
    """Directions to the right, up and to the viewer, the rows of `frame` (3, 3), and the centre (3,) of the view."""

    frame: FloatArray
    middle: FloatArray

    def seen(self, points: FloatArray) -> FloatArray:
        """Convert points (n, 3) to the coordinates right, up, towards the viewer."""
        turned: FloatArray = (points - self.middle) @ self.frame.T
        return turned


def camera_of(
    points: FloatArray, view: tuple[float, float] | Literal["auto"], up: Axis | None, outward: FloatArray
) -> Camera:
    """Return the camera for points (n, 3) of a surface with the mean normal `outward` (3,).

    Raises
    ------
    ValueError
        The view or the axis is wrong.
    """
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    names = get_args(Axis)
    if up is not None:
        choice("up", up, names)
    if view == "auto":
        _, directions = np.linalg.eigh(np.cov(points.T))
        towards = _to_the_front(directions[:, 0], outward)
        if up is None:
            up = "y" if abs(towards[1]) < 0.8 else "z"
        upward = np.eye(3)[names.index(up)]
        right = _unit(np.cross(upward, towards), np.roll(upward, 1))
        towards = _unit(_unit(towards - (towards @ upward) * upward, np.cross(right, upward)), upward)
        # slightly from above and from the side
        towards = np.cos(np.radians(28)) * towards - np.sin(np.radians(28)) * np.cross(upward, towards)
        towards = np.cos(np.radians(18)) * towards + np.sin(np.radians(18)) * upward
    else:
        azimuth, elevation = _angles(view)
        upward = np.eye(3)[names.index(up or "y")]
        ahead = np.roll(upward, 1)
        side = np.cross(upward, ahead)
        level = np.cos(azimuth) * ahead + np.sin(azimuth) * side
        towards = np.cos(elevation) * level + np.sin(elevation) * upward
        if abs(towards @ upward) > 1 - 1e-9:
            # from straight above: the direction to the back is up
            upward = -level
    right = _unit(np.cross(upward, towards), np.roll(upward, 1))
    return Camera(np.stack([right, np.cross(towards, right), towards]), middle)


def _to_the_front(direction: FloatArray, outward: FloatArray) -> FloatArray:
    """Turn a direction (3,) to the side of the mean normal of an open surface, else make its largest part positive."""
    net = float(outward @ direction)
    if abs(net) < 0.05:
        net = float(direction[np.abs(direction).argmax()])
    return direction if net > 0 else -direction


def _angles(view: Any) -> FloatArray:
    angles = np.asarray(view, dtype=np.float64) if not isinstance(view, str) else np.empty(0)
    if angles.shape != (2,) or not np.isfinite(angles).all() or abs(angles[1]) > 90:
        raise ValueError(f'view must be "auto" or (azimuth, elevation) in degrees, elevation in -90..90, got {view!r}')
    radians: FloatArray = np.radians(angles)
    return radians


def _unit(vector: FloatArray, instead: FloatArray) -> FloatArray:
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-9 else instead


def panels_of(size: FloatArray, titles: Sequence[str], caption: str, *, bar: bool) -> tuple[Figure, list[Axes]]:
    """Make a figure with one panel for each title, in rows, with the aspect of `size` (2,)."""
    across = min(len(titles), _ACROSS)
    down = -(-len(titles) // across)
    width, height = np.maximum(PANEL * size / size.max(), [2.4, 1.2])
    titled = 0.15 + 0.2 * max(title.count("\n") + bool(title) for title in titles)
    total = [across * (width + 0.1) + 0.1 + (1.1 if bar else 0), 0.0]
    lines = [part for line in caption.splitlines() for part in textwrap.wrap(line, int(total[0] * _LETTERS))]
    below = 0.12 + 0.2 * len(lines)
    total[1] = down * (height + titled) + below
    figure = new_figure(total[0], total[1])
    panels = []
    for k in range(len(titles)):
        row, column = divmod(k, across)
        left, bottom = 0.1 + column * (width + 0.1), total[1] - (row + 1) * (height + titled)
        panels.append(figure.add_axes((left / total[0], bottom / total[1], width / total[0], height / total[1])))
    if lines:
        figure.text(0.5, 0.08 / total[1], "\n".join(lines), ha="center", va="bottom", fontsize=10)
    return figure, panels
