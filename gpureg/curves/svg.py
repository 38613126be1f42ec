"""Read polygonal curves from SVG documents, and replace them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from ..arrays import FloatArray
from ..shapes.ends import ends_of
from .lines import Line
from .markup import name_of, parsed, register_prefixes, written

_SVG = "http://www.w3.org/2000/svg"
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_TOKEN = re.compile(r"([A-Za-z])|([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|([\s,]+)|(.)", re.S)
_LINES = "MLHVZ"

# The vertices of a curve, and whether it is closed.
Rows = tuple[FloatArray, bool]


@dataclass(frozen=True, eq=False)
class Svg:
    """An SVG document."""

    text: str

    @classmethod
    def of(cls, text: str) -> Svg:
        """Parse a text; raise ValueError if it is not SVG."""
        root = parsed(text)
        if root.tag not in (f"{{{_SVG}}}svg", "svg"):
            raise ValueError("its root is not <svg>")
        return cls(text)

    def read(self) -> list[Line]:
        """Read polygons, polylines and the parts of paths, in the order of the document.

        Raises
        ------
        ValueError
            Curved segments; transforms; invalid lists of numbers.
        """
        found = [rows for element in _shapes(parsed(self.text)) for rows in _rows_of(element)]
        return [Line(points, shut, f"curve {k}") for k, (points, shut) in enumerate(found)]

    def write(self, curves: Sequence[FloatArray | None]) -> bytes:
        """Encode the document with new vertices, (n, 2) each, for the curves that :meth:`read` returns.

        None leaves a curve as it was.
        """
        root = parsed(self.text)
        register_prefixes(self.text)
        left = list(curves)
        for element in _shapes(root):
            old = _rows_of(element)
            new, left = left[: len(old)], left[len(old) :]
            if all(points is None for points in new):
                continue
            if name_of(element) == "path":
                parts = [
                    _path(was if points is None else points, shut) for points, (was, shut) in zip(new, old, strict=True)
                ]
                element.set("d", " ".join(parts))
            else:
                [points] = new
                assert points is not None
                element.set("points", " ".join(_pair(point) for point in points))
        return written(root)


def _shapes(root: ElementTree.Element) -> Iterator[ElementTree.Element]:
    """Yield the elements with straight lines, in the document's coordinate system."""

    def walk(element: ElementTree.Element, transformed: bool) -> Iterator[ElementTree.Element]:
        name = name_of(element)
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
    name = name_of(element)
    if name == "path":
        return _subpaths(element.get("d", ""))
    words = _NUMBER.findall(element.get("points", ""))
    if len(words) % 2 or _NUMBER.sub("", element.get("points", "")).strip(" ,\t\r\n"):
        raise ValueError(f"the points of a <{name}> are not pairs of numbers")
    points = np.array(words, np.float64).reshape(-1, 2)
    if name == "polygon" and len(points) > 1 and ends_of(points, True).repeated:
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
            rows = np.array(points)
            again = shut and len(points) > 1 and ends_of(rows, True).repeated
            found.append((rows[:-1] if again else rows, shut))
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
