"""Read polygonal curves from SVG and GeoJSON documents, and replace them."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..arrays import FloatArray

_SVG = "http://www.w3.org/2000/svg"
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_TOKEN = re.compile(r"([A-Za-z])|([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|([\s,]+)|(.)", re.S)
_LINES = "MLHVZ"

Rows = tuple[FloatArray, bool]


@dataclass(frozen=True, eq=False)
class Svg:
    """An SVG document."""

    text: str

    @classmethod
    def of(cls, text: str) -> Svg:
        """Parse a text; raise ValueError if it is not SVG."""
        root = _tree(text)
        if root.tag not in (f"{{{_SVG}}}svg", "svg"):
            raise ValueError("its root is not <svg>")
        return cls(text)

    def read(self) -> list[Rows]:
        """Read polygons, polylines and the parts of paths, in the order of the document.

        Raises
        ------
        ValueError
            Curved segments; transforms; invalid lists of numbers.
        """
        return [rows for element in _shapes(_tree(self.text)) for rows in _rows_of(element)]

    def write(self, curves: Sequence[FloatArray]) -> bytes:
        """Encode the document with new vertices, (n, 2) each, for the curves that :meth:`read` returns."""
        root = _tree(self.text)
        for prefix, uri in _namespaces(self.text):
            ElementTree.register_namespace(prefix, uri)
        left = list(curves)
        for element in _shapes(root):
            old = _rows_of(element)
            new, left = left[: len(old)], left[len(old) :]
            if _name(element) == "path":
                parts = [_path(points, closed) for points, (_, closed) in zip(new, old, strict=True)]
                element.set("d", " ".join(parts))
            else:
                element.set("points", " ".join(_pair(point) for point in new[0]))
        written: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
        return written + b"\n"


def _tree(text: str) -> ElementTree.Element:
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    try:
        return ElementTree.fromstring(text, parser)
    except ElementTree.ParseError as error:
        raise ValueError(f"damaged, or no XML: {error}") from None


def _namespaces(text: str) -> list[tuple[str, str]]:
    events = ElementTree.iterparse(io.StringIO(text), events=["start-ns"])
    # prefixes that ElementTree reserves cannot be registered
    return [(prefix, uri) for _, (prefix, uri) in events if not re.fullmatch(r"ns\d+", prefix or "")]


def _name(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _shapes(root: ElementTree.Element) -> Iterator[ElementTree.Element]:
    """Yield the elements with straight lines, in the document's coordinate system."""

    def walk(element: ElementTree.Element, transformed: bool) -> Iterator[ElementTree.Element]:
        name = _name(element)
        # these are only drawn where they are referred to
        if name in ("defs", "symbol", "clipPath", "mask", "marker", "pattern"):
            return
        transformed = transformed or element.get("transform") is not None
        if name in ("polygon", "polyline", "path"):
            if transformed:
                raise ValueError(f"a <{name}> is under a transform: apply it first (Inkscape does), then try again")
            yield element
        for child in element:
            yield from walk(child, transformed)

    yield from walk(root, False)


def _rows_of(element: ElementTree.Element) -> list[Rows]:
    name = _name(element)
    if name == "path":
        return _subpaths(element.get("d", ""))
    words = _NUMBER.findall(element.get("points", ""))
    if len(words) % 2 or _NUMBER.sub("", element.get("points", "")).strip(" ,\t\r\n"):
        raise ValueError(f"the points of a <{name}> are not pairs of numbers")
    points = np.array(words, np.float64).reshape(-1, 2)
    if name == "polygon" and len(points) > 1 and (points[0] == points[-1]).all():
        points = points[:-1]
    return [(points, name == "polygon")] if len(points) else []


def _subpaths(d: str) -> list[Rows]:
    """Return the subpaths of straight lines in a path's d, in absolute coordinates."""
    found: list[Rows] = []
    points: list[tuple[float, float]] = []
    command, x, y = "", 0.0, 0.0
    numbers: list[float] = []

    def close(shut: bool) -> None:
        nonlocal points
        if points:
            again = shut and len(points) > 1 and points[0] == points[-1]
            found.append((np.array(points[:-1] if again else points), shut))
        points = []

    def step() -> None:
        """Use the numbers that the command needs."""
        nonlocal x, y, command, numbers
        need = {"M": 2, "L": 2, "H": 1, "V": 1}[command.upper()]
        while len(numbers) >= need:
            given, numbers = numbers[:need], numbers[need:]
            base = (x, y) if command.islower() else (0.0, 0.0)
            if command.upper() == "H":
                x = base[0] + given[0]
            elif command.upper() == "V":
                y = base[1] + given[0]
            else:
                x, y = base[0] + given[0], base[1] + given[1]
            if command.upper() == "M":
                close(False)
                # further pairs are lines
                command = "l" if command == "m" else "L"
            points.append((x, y))

    for letter, number, space, other in _TOKEN.findall(d):
        if other or (number and not command):
            raise ValueError(f"a path's d has {other or number!r} where a command or number was expected")
        if space:
            continue
        if number:
            if command.upper() == "Z":
                raise ValueError(f"a path's d has the number {number} after Z")
            numbers.append(float(number))
            step()
            continue
        if numbers:
            raise ValueError(f"a path's d has {len(numbers)} numbers too few or too many before {letter}")
        if letter.upper() not in _LINES:
            raise ValueError(f"a path has {letter}, a curved segment: flatten it into straight ones first")
        if not command and letter.upper() != "M":
            raise ValueError(f"a path's d begins with {letter}, not with M")
        if letter.upper() == "Z":
            if points:
                x, y = points[0]
            close(True)
        elif command.upper() == "Z" and letter.upper() != "M":
            # a line after Z begins at the start of the closed subpath
            points.append((x, y))
        command = letter
    if numbers:
        raise ValueError("a path's d ends within a pair of numbers")
    close(False)
    return found


def _digits(value: float) -> str:
    return repr(int(value)) if value == int(value) and abs(value) < 1e15 else repr(float(value))


def _pair(point: FloatArray) -> str:
    return f"{_digits(float(point[0]))},{_digits(float(point[1]))}"


def _path(points: FloatArray, closed: bool) -> str:
    return "M " + " L ".join(_pair(point) for point in points) + (" Z" if closed else "")


def new_svg(curves: Sequence[Rows]) -> bytes:
    """Encode an SVG document with only these curves, as thin lines in a view that contains them."""
    together = np.concatenate([points for points, _ in curves])
    low, high = together.min(axis=0), together.max(axis=0)
    size = np.maximum(high - low, 1e-12)
    edge = 0.02 * float(size.max())
    view = " ".join(_digits(float(f"{v:.6g}")) for v in (*(low - edge), *(size + 2 * edge)))
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f'<svg xmlns="{_SVG}" viewBox="{view}" fill="none" stroke="black" stroke-width="{size.max() / 500:.3g}">',
    ]
    for points, closed in curves:
        written = " ".join(_pair(point) for point in points)
        lines.append(f'  <{"polygon" if closed else "polyline"} points="{written}"/>')
    return "\n".join([*lines, "</svg>", ""]).encode()


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
        name = str((self.document.get("crs") or {}).get("properties", {}).get("name", ""))
        return not name or "CRS84" in name or name.endswith("4326")

    def read(self) -> list[Rows]:
        """Read lines and rings, in the order of the document, with all numbers of a vertex.

        Raises
        ------
        ValueError
            Invalid coordinates.
        """
        return [_positions(line, ring) for line, ring in _lines(self.document)]

    def write(self, curves: Sequence[FloatArray]) -> bytes:
        """Encode the document with new vertices, (n, q) each, for the curves that :meth:`read` returns."""
        changed = json.loads(json.dumps(self.document))
        for (line, ring), points in zip(list(_lines(changed)), curves, strict=True):
            # in place, so that the document contains the new numbers
            line[:] = _numbers(points, ring)
        # bounding boxes of the old positions would be wrong
        _drop_boxes(changed)
        return (json.dumps(changed, ensure_ascii=False) + "\n").encode()


def _lines(node: Any) -> Iterator[tuple[list[Any], bool]]:
    """Yield the lists of positions, and whether each is a ring."""
    if not isinstance(node, dict):
        raise ValueError(f"not GeoJSON: {str(node)[:40]!r} where an object is expected")
    kind, places = node.get("type"), node.get("coordinates")
    if kind == "FeatureCollection":
        for feature in node.get("features", []):
            yield from _lines(feature)
    elif kind == "Feature":
        if node.get("geometry") is not None:
            yield from _lines(node["geometry"])
    elif kind == "GeometryCollection":
        for geometry in node.get("geometries", []):
            yield from _lines(geometry)
    elif kind in ("Point", "MultiPoint"):
        return
    elif kind in ("LineString", "MultiLineString", "Polygon", "MultiPolygon"):
        if not isinstance(places, list):
            raise ValueError(f"a {kind} has no list of coordinates")
        depth = {"LineString": 0, "MultiLineString": 1, "Polygon": 1, "MultiPolygon": 2}[kind]
        yield from ((line, kind.endswith("Polygon")) for line in _at_depth(places, depth))
    else:
        raise ValueError(f"not GeoJSON: a type {kind!r}")


def _at_depth(places: list[Any], depth: int) -> Iterator[list[Any]]:
    if depth == 0:
        yield places
        return
    for part in places:
        if not isinstance(part, list):
            raise ValueError("coordinates are not nested as their type says")
        yield from _at_depth(part, depth - 1)


def _positions(line: list[Any], ring: bool) -> Rows:
    try:
        points = np.array(line, np.float64)
    except (TypeError, ValueError):
        raise ValueError("coordinates are not lists of numbers of the same length") from None
    if points.ndim != 2 or points.shape[1] < 2:
        raise ValueError("coordinates are not lists of two or three numbers")
    if ring and len(points) > 1 and (points[0, :2] == points[-1, :2]).all():
        points = points[:-1]
    return points, ring


def _numbers(points: FloatArray, ring: bool) -> list[list[float]]:
    written: list[list[float]] = points.tolist()
    return [*written, written[0]] if ring else written


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


def new_geo(curves: Sequence[Rows]) -> bytes:
    """Encode a GeoJSON collection with one feature per curve, whose number is a property."""
    features = []
    for k, (points, closed) in enumerate(curves):
        written = _numbers(points[:, :3], closed)
        geometry = {"type": "Polygon" if closed else "LineString", "coordinates": [written] if closed else written}
        features.append({"type": "Feature", "properties": {"curve": k}, "geometry": geometry})
    return (json.dumps({"type": "FeatureCollection", "features": features}) + "\n").encode()
