"""Read tracks and routes from GPX documents, and replace them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from ..arrays import FloatArray, IntArray
from ..shapes.ends import ends_of
from .lines import Line
from .markup import name_of, parsed, register_prefixes, written

_GPX = "http://www.topografix.com/GPX/1/1"


@dataclass(frozen=True, eq=False)
class Gpx:
    """A GPX document."""

    text: str

    @classmethod
    def of(cls, text: str) -> Gpx:
        """Parse a text; raise ValueError if it is not GPX."""
        if name_of(parsed(text)) != "gpx":
            raise ValueError("its root is not <gpx>")
        return cls(text)

    def read(self) -> list[Line]:
        """Read the segments of tracks and the routes: longitude, latitude and elevation, NaN where there is none.

        A segment is closed if it repeats its first point at the end; else it is open.
        """
        found = []
        for _, points, name in _parts(parsed(self.text)):
            try:
                rows = np.array([_row(point) for point in points], np.float64).reshape(-1, 3)
            except ValueError as error:
                found.append(Line(np.empty((0, 3)), False, name, str(error)))
                continue
            ends = None if len(rows) < 4 else ends_of(rows[:, :2])
            shut = ends is not None and ends.repeated
            found.append(Line(rows[:-1] if shut else rows, shut, name))
        return found

    def write(self, curves: Sequence[FloatArray | None], rows: Sequence[IntArray | None]) -> bytes:
        """Encode the document with new vertices for the curves that :meth:`read` returns.

        Parameters
        ----------
        curves : sequence of (k, 2) or (k, 3) arrays, or None
            Longitude, latitude and elevation; None leaves a curve as it was.
        rows : sequence of (k,) int arrays, or None
            The points of the document whose times and other contents the vertices have. None: the vertices are those
            of the document if there are as many, otherwise they have no other contents.
        """
        root = parsed(self.text)
        register_prefixes(self.text)
        for (parent, points, _), new, which in zip(list(_parts(root)), curves, rows, strict=True):
            if new is None:
                continue
            old = [_row(point) for point in points]
            shut = len(old) > 3 and ends_of(np.array(old)[:, :2]).repeated
            count = len(points) - shut
            which = np.arange(count) if which is None and len(new) == count else which
            if which is None:
                tag = points[0].tag
                made = [ElementTree.Element(tag) for _ in new]
            else:
                made = [points[k] for k in which.tolist()]
            for point, vertex in zip(made, new, strict=True):
                _set(point, vertex)
            if shut:
                made.append(points[-1])
                _set(points[-1], new[0])
            _replace(parent, points, made)
        return written(root)


def _parts(root: ElementTree.Element) -> list[tuple[ElementTree.Element, list[ElementTree.Element], str]]:
    """List the segments of tracks, and the routes: their element, their points and their name."""
    found = []
    for k, outer in enumerate(child for child in root if name_of(child) in ("trk", "rte")):
        label = next((child.text for child in outer if name_of(child) == "name" and child.text), None)
        what = "route" if name_of(outer) == "rte" else "track"
        name = f"{what} {k}" + (f" ({label[:40]})" if label else "")
        segments = [outer] if what == "route" else [child for child in outer if name_of(child) == "trkseg"]
        for number, segment in enumerate(segments):
            points = [child for child in segment if name_of(child) in ("trkpt", "rtept")]
            found.append((segment, points, f"{name}, segment {number}" if len(segments) > 1 else name))
    return found


def _row(point: ElementTree.Element) -> tuple[float, float, float]:
    try:
        x, y = float(point.get("lon", "")), float(point.get("lat", ""))
        height = _elevation(point)
        return x, y, math.nan if height is None or not height.text else float(height.text)
    except ValueError:
        raise ValueError("a point has no lon and lat, or an elevation that is no number") from None


def _elevation(point: ElementTree.Element) -> ElementTree.Element | None:
    return next((child for child in point if name_of(child) == "ele"), None)


def _set(point: ElementTree.Element, vertex: FloatArray) -> None:
    """Set the place of a point, and its elevation if that has changed."""
    was = _row(point) if point.get("lon") is not None else (math.nan,) * 3
    for name, value, before in zip(("lon", "lat"), vertex.tolist(), was, strict=False):
        if value != before:
            point.set(name, repr(float(value)))
    if len(vertex) > 2 and math.isfinite(vertex[2]) and float(vertex[2]) != was[2]:
        height = _elevation(point)
        if height is None:
            height = ElementTree.Element(point.tag.rpartition("}")[0] + "}ele" if "}" in point.tag else "ele")
            # the schema has it first
            point.insert(0, height)
        height.text = repr(float(vertex[2]))


def _replace(parent: ElementTree.Element, old: list[ElementTree.Element], new: list[ElementTree.Element]) -> None:
    """Replace elements by others of the same parent."""
    place = list(parent).index(old[0])
    indent = old[0].tail
    for point in old:
        parent.remove(point)
    for k, point in enumerate(new):
        point.tail = point.tail or indent
        parent.insert(place + k, point)


def new_gpx(curves: Sequence[tuple[FloatArray, bool]]) -> bytes:
    """Encode a GPX document with one track per curve, (n, 2) or (n, 3) each; closed ones repeat their first point.

    Raises
    ------
    ValueError
        A latitude outside -90..90.
    """
    ElementTree.register_namespace("", _GPX)
    root = ElementTree.Element(f"{{{_GPX}}}gpx", {"version": "1.1", "creator": "gpureg"})
    for points, closed in curves:
        if np.abs(points[:, 1]).max() > 90:
            raise ValueError(f"GPX has degrees: a latitude of {np.abs(points[:, 1]).max():g} is outside -90..90")
        segment = ElementTree.SubElement(ElementTree.SubElement(root, f"{{{_GPX}}}trk"), f"{{{_GPX}}}trkseg")
        for vertex in np.concatenate([points, points[:1]]) if closed else points:
            _set(ElementTree.SubElement(segment, f"{{{_GPX}}}trkpt"), vertex)
    ElementTree.indent(root)
    return written(root)
