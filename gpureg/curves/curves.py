"""Check polygonal curves and return them in the form of the input: :class:`Curves`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, checked_points, unmasked
from ..checks import flag
from ..graphs.csr import Graph
from ..graphs.of_shapes import curve_graph
from ..shapes.ends import Ends, ends_of
from .shapely import Shapes, shapes_of


@dataclass(frozen=True, eq=False)
class Curves:
    """Checked polygonal curves.

    Attributes
    ----------
    points : list of (n, d) float64 arrays
        The vertices of each curve, without a first vertex repeated at the end.
    ends : list of Ends
        Whether each curve is closed, and the reason.
    dtypes : list of dtype
        The floating-point type in which each curve is returned.
    several : bool
        Whether the input was a list.
    shapes : Shapes or None
        The objects of shapely to which the curves belong.
    """

    points: list[FloatArray]
    ends: list[Ends]
    dtypes: list[np.dtype[Any]]
    several: bool
    shapes: Shapes | None = None

    @property
    def left(self) -> tuple[str, ...]:
        """The parts of the input that cannot be treated and stay as they are, each with the reason."""
        return () if self.shapes is None else self.shapes.left

    @property
    def closed(self) -> list[bool]:
        """Whether each curve is closed."""
        return [ends.closed for ends in self.ends]

    def graph(self) -> Graph:
        """Make one graph of all curves, with the centred positions of each."""
        parts = [curve_graph(x - x.mean(axis=0), shut) for x, shut in zip(self.points, self.closed, strict=True)]
        if len(parts) == 1:
            return parts[0]
        starts = np.cumsum([0, *(part.n_vertices for part in parts[:-1])])
        ends = np.cumsum([0, *(part.n_edges for part in parts)])
        return Graph(
            np.concatenate([[0], *(part.indptr[1:] + end for part, end in zip(parts, ends, strict=False))]),
            np.concatenate([part.indices + start for part, start in zip(parts, starts, strict=True)]),
            None,
            np.concatenate([part.positions for part in parts if part.positions is not None]),
        )

    def split(self, f: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
        """Split a function on the vertices of all curves, (n,) or (n, m), into one per curve."""
        return np.split(f, np.cumsum([len(x) for x in self.points[:-1]]))

    def as_came(self, values: list[FloatArray], kept: list[IntArray] | None = None) -> Any:
        """Return (k, d) vertices per curve in the form of the input: its types, repeated vertices, list or not.

        `kept` are the (k,) indices of the vertices in the input, if there are fewer.
        """
        if self.shapes is not None:
            return self.shapes.make(values, [np.arange(len(x)) for x in values] if kept is None else kept)
        made = [
            (np.concatenate([x, x[:1]]) if ends.repeated else x).astype(dtype)
            for x, ends, dtype in zip(values, self.ends, self.dtypes, strict=True)
        ]
        return made if self.several else made[0]


def curves_of(points: npt.ArrayLike | Sequence[npt.ArrayLike] | Curves, closed: bool | None = None) -> Curves:
    """Convert one or several polygonal curves, and check them; :class:`Curves` are returned unchanged.

    Parameters
    ----------
    points : (n, d) array, list of (n, d) arrays, object of shapely or a list of them, or Curves
    closed : bool, optional
        As in :func:`gpureg.shapes.ends.ends_of`, for each curve.

    Raises
    ------
    TypeError, ValueError
        Coordinates that are not real and finite; curves with too few vertices or of different dimensions.
    """
    if isinstance(points, Curves):
        return points
    objects = shapes_of(points)
    if objects is not None:
        return _of_shapes(objects, closed)
    several = isinstance(points, list | tuple) and _of_curves(points)
    given: list[Any] = list(points) if several else [points]  # type: ignore[arg-type]
    if not given:
        raise ValueError("there is no curve: the list is empty")
    parts, shapes, dtypes = [], [], []
    for k, curve in enumerate(given):
        what = f"curve {k}" if several else "points"
        array = unmasked(curve, what)
        x = checked_points(array, what)
        ends = ends_of(x, closed)
        x = x[:-1] if ends.repeated else x
        least = 3 if ends.closed else 2
        if len(x) < least:
            what = f"curve {k}" if several else "the curve"
            kind = "a closed" if ends.closed else "an open"
            raise ValueError(f"{what} has {len(x)} vertices; {kind} one needs {least}")
        parts.append(x)
        shapes.append(ends)
        dtypes.append(array.dtype if array.dtype.kind == "f" else np.dtype(np.float64))
    if len({x.shape[1] for x in parts}) > 1:
        raise ValueError(f"all curves must have the same dimension, got {sorted({x.shape[1] for x in parts})}")
    return Curves(parts, shapes, dtypes, several)


def _of_curves(points: Sequence[Any]) -> bool:
    """Return whether a list is one of curves, and not of the vertices of one; a curve may be empty, which is refused.

    Raises
    ------
    ValueError
        A curve, or a vertex, has rows of different lengths.
    """
    try:
        dimensions = {np.ndim(x) if len(x) else 0 for x in points if np.ndim(x)}
    except ValueError:
        raise ValueError("a curve has vertices with different numbers of coordinates") from None
    return 2 in dimensions or not points


def _of_shapes(shapes: Shapes, closed: bool | None) -> Curves:
    if closed is not None and any(line.closed != flag("closed", closed) for line in shapes.lines):
        raise ValueError("an object of shapely says by itself which curves are closed: leave closed= out")
    points = [line.rows[:, :2] for line in shapes.lines]
    ends = [replace(ends_of(x, line.closed), why="source") for x, line in zip(points, shapes.lines, strict=True)]
    return Curves(points, ends, [np.dtype(np.float64)] * len(points), True, shapes)
