"""Take lines and polygons of shapely, and make them again from new vertices: :func:`shapes_of`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import FloatArray, IntArray
from .lines import Line

# Makes the objects again from the vertices (k, 2) of each line, and their indices (k,) in the input.
Maker = Callable[[Sequence[FloatArray], Sequence[IntArray]], Any]


@dataclass(frozen=True, eq=False)
class Shapes:
    """The lines and rings of objects of shapely.

    Attributes
    ----------
    lines : list of Line
        Those that can be treated, rings without their last vertex, which repeats the first.
    left : tuple of str
        The parts that cannot be treated, each with the reason; they stay as they are.
    make : callable
        Makes the objects again.
    """

    lines: list[Line]
    left: tuple[str, ...]
    make: Maker


def shapes_of(given: Any) -> Shapes | None:
    """List the lines and rings of an object of shapely or of a list of them; None for anything else.

    Raises
    ------
    TypeError
        A list of objects of shapely and others.
    ValueError
        Nothing can be treated.
    """
    several = isinstance(given, list | tuple)
    objects = list(given) if several else [given]
    known = [_is_shape(one) for one in objects]
    if not any(known):
        return None
    if not all(known):
        raise TypeError("a list of curves must hold arrays, or objects of shapely, not both")
    names = [f"object {k}" if several else "the object" for k in range(len(objects))]
    lines = [line for one, name in zip(objects, names, strict=True) for line in _lines(one, name)]
    faults = [line.untreatable() for line in lines]
    left = tuple(fault for fault in faults if fault is not None)
    treated = [fault is None for fault in faults]
    if not any(treated):
        raise ValueError(f"there is no line or ring that can be treated{': ' if left else ''}{'; '.join(left)}")

    def make(values: Sequence[FloatArray], kept: Sequence[IntArray]) -> Any:
        pairs = iter(zip(values, kept, strict=True))
        new = iter([next(pairs) if own else None for own in treated])
        made = [_made(one, new) for one in objects]
        return type(given)(made) if several else made[0]

    return Shapes([line for line, own in zip(lines, treated, strict=True) if own], left, make)


def _is_shape(given: Any) -> bool:
    return type(given).__module__.partition(".")[0] == "shapely" and hasattr(given, "geom_type")


def _parts(shape: Any) -> list[Any]:
    """List the parts of a polygon or a collection; no part for a line, a point or what is empty."""
    if shape.is_empty:
        return []
    if shape.geom_type == "Polygon":
        return [shape.exterior, *shape.interiors]
    return list(shape.geoms) if hasattr(shape, "geoms") else []


def _lines(shape: Any, name: str) -> Iterator[Line]:
    import shapely

    if shape.geom_type in ("LineString", "LinearRing") and not shape.is_empty:
        rows = shapely.get_coordinates(shape, include_z=bool(shape.has_z))
        ring = shape.geom_type == "LinearRing"
        yield Line(rows[:-1] if ring else rows, ring, name)
    parts = _parts(shape)
    for k, part in enumerate(parts):
        yield from _lines(part, f"{name}, part {k}" if len(parts) > 1 else name)


def _made(shape: Any, new: Iterator[tuple[FloatArray, IntArray] | None]) -> Any:
    """Make a shape again with the next lines of `new`; None leaves a line as it is."""
    import shapely

    kind = shape.geom_type
    if shape.is_empty:
        return shape
    if kind in ("LineString", "LinearRing"):
        line = next(new)
        if line is None:
            return shape
        points, kept = line
        rows = shapely.get_coordinates(shape, include_z=bool(shape.has_z))
        # a height stays with its vertex
        rows = np.concatenate([points, rows[kept, 2:]], axis=1)
        return getattr(shapely, kind)(rows)
    parts = [_made(part, new) for part in _parts(shape)]
    if kind == "Polygon":
        return shapely.Polygon(parts[0], parts[1:])
    return getattr(shapely, kind)(parts) if parts else shape
