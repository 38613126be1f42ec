"""Read polygonal curves from GeoJSON documents, and replace them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..shapes.ends import ends_of
from .lines import Line

_DEPTHS = {"LineString": 0, "MultiLineString": 1, "Polygon": 1, "MultiPolygon": 2}
# Names of a feature for messages.
_NAMES = ("name", "NAME", "Name", "id")


@dataclass(frozen=True, eq=False)
class _Slot:
    """A list of positions in a document, or a part that has none for the reason `fault`."""

    line: list[Any]
    ring: bool
    name: str
    fault: str | None = None


@dataclass(frozen=True, eq=False)
class Geo:
    """A GeoJSON document."""

    document: dict[str, Any]

    @classmethod
    def of(cls, text: str) -> Geo:
        """Parse a text; raise ValueError if it is not GeoJSON."""
        try:
            document = json.loads(text)
        except json.JSONDecodeError as error:
            raise ValueError(f"damaged, or no JSON: {error}") from None
        if not isinstance(document, dict) or "type" not in document:
            raise ValueError("not GeoJSON: it is not an object with a type")
        return cls(document)

    @property
    def in_degrees(self) -> bool:
        """Whether coordinates are longitude and latitude, the default if the file names no reference system."""
        crs = self.document.get("crs")
        properties = crs.get("properties") if isinstance(crs, dict) else None
        name = str(properties.get("name", "")) if isinstance(properties, dict) else ""
        return not name or "CRS84" in name or name.endswith("4326")

    def read(self) -> list[Line]:
        """Read lines and rings in order, with all numbers of a vertex, NaN where one is missing."""
        return [_read(slot) for slot in _slots(self.document, "the document")]

    def write(self, curves: Sequence[FloatArray | None]) -> bytes:
        """Encode the document with new vertices, (n, q) each, for the curves that :meth:`read` returns.

        None leaves a curve as it was. Numbers that JSON does not have, NaN and infinity, become null.
        """
        changed = json.loads(json.dumps(self.document))
        for slot, points in zip(list(_slots(changed, "")), curves, strict=True):
            if points is not None:
                # in place, so that the document contains the new numbers
                slot.line[:] = _numbers(points, slot.ring)
        # bounding boxes of the old positions would be wrong
        _drop_boxes(changed)
        return (json.dumps(_finite(changed), ensure_ascii=False, allow_nan=False) + "\n").encode()


def _slots(node: Any, name: str) -> Iterator[_Slot]:
    """List the positions of a document in order, and the parts that are not understood."""
    if not isinstance(node, dict):
        yield _Slot([], False, name, f"not GeoJSON: {str(node)[:40]!r} where an object is expected")
        return
    kind, places = node.get("type"), node.get("coordinates")
    if kind == "FeatureCollection":
        features = node.get("features", [])
        for k, feature in enumerate(features if isinstance(features, list) else []):
            yield from _slots(feature, _named(feature, k))
    elif kind == "Feature":
        if node.get("geometry") is not None:
            yield from _slots(node["geometry"], name)
    elif kind == "GeometryCollection":
        geometries = node.get("geometries", [])
        for geometry in geometries if isinstance(geometries, list) else []:
            yield from _slots(geometry, name)
    elif kind in ("Point", "MultiPoint"):
        return
    elif kind not in _DEPTHS:
        yield _Slot([], False, name, f"not GeoJSON: a type {kind!r}")
    elif not isinstance(places, list):
        yield _Slot([], False, name, f"a {kind} has no list of coordinates")
    elif not places:
        yield _Slot([], False, name, f"an empty {kind}")
    else:
        lines = list(_at_depth(places, _DEPTHS[kind]))
        for k, line in enumerate(lines):
            part = f"{name}, part {k}" if len(lines) > 1 else name
            fault = None if isinstance(line, list) else "coordinates are not nested as their type says"
            yield _Slot(line if isinstance(line, list) else [], kind.endswith("Polygon"), part, fault)


def _named(feature: Any, k: int) -> str:
    """Name a feature by its number, and by a name in its properties."""
    properties = feature.get("properties") if isinstance(feature, dict) else None
    known = properties if isinstance(properties, dict) else {}
    names = [known[name] for name in _NAMES if isinstance(known.get(name), str | int)]
    label = names[0] if names else feature.get("id") if isinstance(feature, dict) else None
    return f"feature {k}" + (f" ({str(label)[:40]})" if label is not None else "")


def _at_depth(places: Any, depth: int) -> Iterator[Any]:
    if depth == 0 or not isinstance(places, list):
        yield places if depth == 0 else None
        return
    for part in places:
        yield from _at_depth(part, depth - 1)


def _read(slot: _Slot) -> Line:
    empty = np.empty((0, 2))
    if slot.fault is not None:
        return Line(empty, slot.ring, slot.name, slot.fault)
    if not slot.line:
        return Line(empty, slot.ring, slot.name, "it has no position")
    if not all(isinstance(place, list) for place in slot.line):
        return Line(empty, slot.ring, slot.name, "coordinates are not nested as their type says")
    width = max(map(len, slot.line))
    if width < 2:
        return Line(empty, slot.ring, slot.name, "coordinates are not lists of two or three numbers")
    points = np.full((len(slot.line), width), np.nan)
    for row, place in zip(points, slot.line, strict=True):
        if len(place) < 2 or not all(map(_is_number, place[:2])) or not all(_is_number(x) or x is None for x in place):
            return Line(empty, slot.ring, slot.name, "coordinates are not lists of numbers")
        row[: len(place)] = [math.nan if x is None else x for x in place]
    if slot.ring and len(points) > 1 and ends_of(points[:, :2], True).repeated:
        points = points[:-1]
    return Line(points, slot.ring, slot.name)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _numbers(points: FloatArray, ring: bool) -> list[list[float | None]]:
    """List positions; a number that is missing is left out at the end of a position, else null."""
    found: list[list[float | None]] = []
    whole = bool(np.isfinite(points).all())
    for row in points.tolist():
        place: list[float | None] = row if whole else [x if math.isfinite(x) else None for x in row]
        while len(place) > 2 and place[-1] is None:
            place.pop()
        found.append(place)
    return [*found, list(found[0])] if ring else found


def _finite(node: Any) -> Any:
    """Copy a document with null instead of NaN and infinity."""
    if isinstance(node, float):
        return node if math.isfinite(node) else None
    if isinstance(node, dict):
        return {name: _finite(child) for name, child in node.items()}
    if isinstance(node, list):
        return [_finite(child) for child in node]
    return node


def _drop_boxes(node: Any) -> None:
    if isinstance(node, dict):
        node.pop("bbox", None)
        for name, child in node.items():
            if name != "properties":
                _drop_boxes(child)
    elif isinstance(node, list):
        for child in node:
            if isinstance(child, dict):
                _drop_boxes(child)


def new_geo(curves: Sequence[tuple[FloatArray, bool]]) -> bytes:
    """Encode a GeoJSON collection with one feature per curve, whose number is a property."""
    features = []
    for k, (points, closed) in enumerate(curves):
        numbers = _numbers(points[:, :3], closed)
        geometry = {"type": "Polygon" if closed else "LineString", "coordinates": [numbers] if closed else numbers}
        features.append({"type": "Feature", "properties": {"curve": k}, "geometry": geometry})
    return (json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False) + "\n").encode()
