"""Read and write polygonal curves: CSV, SVG, GeoJSON and GPX, including other contents of the last three."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..checks import flag
from ..doors import door, outside
from ..files.pictures import PictureError, check_place, write_atomically
from ..files.table import encode_table, read_table, read_text
from ..shapes.ends import Ends, ends_of
from .geojson import Geo, new_geo
from .gpx import Gpx, new_gpx
from .lines import Line
from .svg import Svg, new_svg

CURVE_FORMATS = (".csv", ".csv.gz", ".svg", ".geojson", ".json", ".gpx")


class CurveError(PictureError):
    """Curves cannot be read or written; the message gives the file and the reason."""


@dataclass(frozen=True, eq=False)
class CurveInFile:
    """A curve in a file.

    Attributes
    ----------
    points : (n, 2) float64 array
        The vertices, without a first vertex repeated at the end.
    closed : bool
        Whether the last vertex is joined to the first.
    more : (n, q) float64 array
        Other numbers of each vertex: altitudes of GeoJSON and GPX, NaN where there is none; columns of CSV.
    ends : Ends or None
        Why the curve is open or closed; None if it was not read from a file.
    rows : (n,) int array or None
        The vertices of the file whose other contents, such as the times of GPX, these vertices have. None: all in
        order, if there are as many.
    """

    points: FloatArray
    closed: bool
    more: FloatArray
    ends: Ends | None = field(default=None, repr=False)
    rows: IntArray | None = field(default=None, repr=False)


class Document(Protocol):
    """The contents of a file without its curves, for writing a file with new curves."""

    def encode(self, curves: Sequence[CurveInFile]) -> bytes:
        """Encode the file with new curves, in the same order."""


@dataclass(frozen=True, eq=False)
class CurvesFile:
    """The contents of a file of curves, from :func:`read_curves`.

    Attributes
    ----------
    curves : list of CurveInFile
    degrees : bool
        Whether coordinates are longitude and latitude: GPX, and GeoJSON without another reference system.
    kind : str
        The extension.
    document : Document
        The other contents.
    left : tuple of str
        The curves of the file that cannot be treated, each with the reason. In a file of the same format they stay as
        they were.
    """

    curves: list[CurveInFile]
    degrees: bool
    kind: str
    document: Document = field(repr=False)
    left: tuple[str, ...] = ()


def curve_format(path: str | os.PathLike[str]) -> str:
    """Return the extension of a file of curves; raise CurveError if it is unknown."""
    name = Path(path).name.lower()
    found = [kind for kind in CURVE_FORMATS if name.endswith(kind) and len(name) > len(kind)]
    if not found:
        raise CurveError(f"{path}: the extension of curves must be one of {', '.join(CURVE_FORMATS)}")
    return found[-1]


@door
def read_curves(path: str | os.PathLike[str], *, closed: bool | None = None) -> CurvesFile:
    """Read polygonal curves in the plane.

    Parameters
    ----------
    path : path
        CSV: one row per vertex, in columns x and y or the first two columns; several curves are separated by a blank
        line or numbered by a column ``curve``. SVG: polygons, polylines, and paths of straight segments. GeoJSON: lines
        and polygons in any geometry, feature or collection. GPX: the segments of tracks, and routes.
    closed : bool, optional
        Whether the curves of a CSV file are closed. None: if some curves repeat the first vertex at the end (to 1e-6 of
        the mean segment), only these are closed; otherwise those whose ends are at most twice the 95 % quantile of the
        segments' lengths apart. SVG and GeoJSON files contain this information; a segment of GPX is closed if it
        repeats its first point.

    Raises
    ------
    CurveError
        The file is missing, cannot be read, is damaged or has another format; none of its curves can be treated.

    Warns
    -----
    UserWarning
        Some curves cannot be treated: they are empty, or have too few different vertices, or vertices that are not
        finite. They are not in the result; :func:`write_curves` with ``like=`` writes them as they were.
    """
    found = read(path, closed=closed)
    if found.left:
        warnings.warn(f"{path}: {left_words(found.left)}", UserWarning, stacklevel=outside())
    return found


def left_words(left: Sequence[str], most: int = 5) -> str:
    """Say in a sentence which curves cannot be treated."""
    more = f"; and {len(left) - most} more" if len(left) > most else ""
    count = f"{len(left)} curves" if len(left) > 1 else "1 curve"
    return f"{count} cannot be treated: {'; '.join(left[:most])}{more}"


def read(path: str | os.PathLike[str], *, closed: bool | None = None) -> CurvesFile:
    """Read curves as :func:`read_curves`, without a warning."""
    kind = curve_format(path)
    if closed is not None:
        flag("closed", closed)
        if not kind.startswith(".csv"):
            raise CurveError(f"{path}: a {kind} file says by itself which curves are closed")
    try:
        if kind.startswith(".csv"):
            return _of_csv(path, closed)
        text = read_text(path, CurveError)
        document = Svg.of(text) if kind == ".svg" else Gpx.of(text) if kind == ".gpx" else Geo.of(text)
        lines = document.read()
        treated, left = _treated(path, lines)
        degrees = isinstance(document, Gpx) or (isinstance(document, Geo) and document.in_degrees)
        return CurvesFile(
            [_curve(lines[k]) for k in treated], degrees, kind, _Placed(document, len(lines), treated), left
        )
    except ValueError as error:
        if isinstance(error, CurveError):
            raise
        raise CurveError(f"{path}: {error}") from None


def _treated(path: str | os.PathLike[str], lines: Sequence[Line]) -> tuple[list[int], tuple[str, ...]]:
    """Return the numbers of the curves that can be treated, and the reasons of the others."""
    faults = [line.untreatable() for line in lines]
    treated = [k for k, fault in enumerate(faults) if fault is None]
    left = tuple(fault for fault in faults if fault is not None)
    if not treated:
        why = f" that can be treated: {'; '.join(left[:5])}" if left else ""
        raise CurveError(f"{path} contains no polygonal curve{why}")
    return treated, left


def _curve(line: Line) -> CurveInFile:
    """Make a curve of a document; columns of which nothing is known are left out."""
    points, more = line.rows[:, :2], line.rows[:, 2:]
    ends = replace(ends_of(points, line.closed), why="source")
    known = np.isfinite(more).any(axis=0)
    # no column is left out before one that is known
    width = int(np.flatnonzero(known)[-1]) + 1 if known.any() else 0
    return CurveInFile(points, line.closed, more[:, :width], ends, np.arange(len(points)))


@dataclass(frozen=True, eq=False)
class _Placed:
    """An SVG, GeoJSON or GPX document, which adds or omits the closing vertex of a curve as its format needs.

    `count` is the number of its curves, `treated` are the numbers of those that can be treated.
    """

    document: Svg | Geo | Gpx
    count: int
    treated: Sequence[int]

    def encode(self, curves: Sequence[CurveInFile]) -> bytes:
        new: list[FloatArray | None] = [None] * self.count
        rows: list[IntArray | None] = [None] * self.count
        for k, curve in zip(self.treated, curves, strict=True):
            new[k], rows[k] = np.concatenate([curve.points, curve.more], axis=1), curve.rows
        return self.document.write(new, rows) if isinstance(self.document, Gpx) else self.document.write(new)


@dataclass(frozen=True, eq=False)
class _Csv:
    """The form of a CSV file: its header, its delimiter, how its curves are separated, and those not treated."""

    names: tuple[str, ...] | None
    delimiter: str
    by_column: IntArray | None
    repeated: list[bool]
    untreated: dict[int, CurveInFile] = field(default_factory=dict)

    def encode(self, curves: Sequence[CurveInFile]) -> bytes:
        others = iter(curves)
        count = len(curves) + len(self.untreated)
        curves = [self.untreated[k] if k in self.untreated else next(others) for k in range(count)]
        rows: list[FloatArray] = []
        gaps: list[int] = []
        number: list[npt.NDArray[Any]] = []
        for k, (curve, again) in enumerate(zip(curves, self._repeats(curves), strict=True)):
            table = np.concatenate([curve.points, curve.more], axis=1)
            table = np.concatenate([table, table[:1]]) if again else table
            gaps.append(sum(len(part) for part in rows))
            number.append(np.full(len(table), k if self.by_column is None else self.by_column[k]))
            rows.append(table)
        columns = list(np.concatenate(rows).T)
        columns = [column.astype(np.int64) if (column == np.rint(column)).all() else column for column in columns]
        if self.by_column is not None:
            columns.insert(2, np.concatenate(number))
        return encode_table(columns, self.names, self.delimiter, [] if self.by_column is not None else gaps[1:])

    def _repeats(self, curves: Sequence[CurveInFile]) -> list[bool]:
        """Choose the curves that repeat their first vertex: as in the input, or all closed ones if that is wrong."""
        told = [k < len(self.repeated) and self.repeated[k] and curve.closed for k, curve in enumerate(curves)]
        closed = [curve.closed for curve in curves]
        read = told if any(told) else [ends_of(curve.points).closed for curve in curves]
        return told if read == closed else closed


def _of_csv(path: str | os.PathLike[str], closed: bool | None) -> CurvesFile:
    table = read_table(path, CurveError)
    rows, names = table.rows, table.names
    if rows.shape[1] < 2:
        raise CurveError(f"{path}: a vertex needs two coordinates, x and y")
    lower = [name.lower() for name in names] if names is not None else []
    x, y = (lower.index("x"), lower.index("y")) if {"x", "y"} <= set(lower) else (0, 1)
    which = lower.index("curve") if "curve" in lower else None
    rest = [k for k in range(rows.shape[1]) if k not in (x, y, which)]
    label = table.blocks if which is None else rows[:, which].astype(np.int64)
    numbers, first = np.unique(label, return_index=True)
    numbers = numbers[np.argsort(first)]
    parts = [rows[label == number] for number in numbers]
    ends = [ends_of(part[:, [x, y]], closed) for part in parts]
    if closed is None and any(one.repeated for one in ends):
        # if a file repeats the first vertex of some curves, the others are open
        ends = [one if one.repeated else replace(one, closed=False, why="source") for one in ends]
    lines = [
        Line((part[:-1] if one.repeated else part)[:, [x, y, *rest]], one.closed, f"curve {k}")
        for k, (part, one) in enumerate(zip(parts, ends, strict=True))
    ]
    curves = [
        CurveInFile(line.rows[:, :2], line.closed, line.rows[:, 2:], one) for line, one in zip(lines, ends, strict=True)
    ]
    head = None
    if names is not None:
        head = (names[x], names[y], *([] if which is None else [names[which]]), *(names[k] for k in rest))
    treated, left = _treated(path, lines)
    untreated = {k: curve for k, curve in enumerate(curves) if k not in set(treated)}
    repeated = [one.repeated for one in ends]
    document = _Csv(head, table.delimiter, None if which is None else numbers, repeated, untreated)
    return CurvesFile([curves[k] for k in treated], False, ".csv", document, left)


@door
def write_curves(
    path: str | os.PathLike[str], curves: Sequence[CurveInFile], *, like: CurvesFile | None = None
) -> None:
    """Write curves in the format of the extension, completely or not at all.

    Parameters
    ----------
    path : path
        A name that ends in .csv, .csv.gz, .svg, .geojson, .json or .gpx. An existing file is replaced when the new one
        is complete.
    curves : sequence of CurveInFile
    like : CurvesFile, optional
        The source of the curves: if it has the same format and number of curves, its other contents are written too.

    Raises
    ------
    CurveError, PictureError
        An unknown extension; a folder that does not exist; an error of the disk; GPX of what is not in degrees.

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> from gpureg.curves.files import CurveInFile, read_curves, write_curves
    >>> triangle = CurveInFile(np.array([[0, 0], [2, 0], [1, 1.5]]), True, np.empty((3, 0)))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_curves(os.path.join(folder, "a.svg"), [triangle])
    ...     [found] = read_curves(os.path.join(folder, "a.svg")).curves
    >>> found.points.tolist(), found.closed
    ([[0.0, 0.0], [2.0, 0.0], [1.0, 1.5]], True)
    """
    encoded = encode_curves(path, curves, like=like)
    check_place(path)
    write_atomically(path, lambda temporary: temporary.write_bytes(encoded))


def encode_curves(
    path: str | os.PathLike[str],
    curves: Sequence[CurveInFile],
    *,
    like: CurvesFile | None = None,
    names: Sequence[str] = (),
) -> bytes:
    """Encode curves as :func:`write_curves` writes them; `names` are the other columns of a new CSV file."""
    kind = curve_format(path)
    same = like is not None and _family(like.kind) == _family(kind) and len(like.curves) == len(curves)
    rows = [(np.concatenate([curve.points, curve.more], axis=1), curve.closed) for curve in curves]
    if like is not None and same:
        encoded = like.document.encode(curves)
    elif kind == ".svg":
        encoded = new_svg([(points[:, :2], closed) for points, closed in rows])
    elif kind.startswith(".csv"):
        # if some curves are open, the closed ones repeat their first vertex, so that a reader finds them closed
        mixed = not all(curve.closed for curve in curves)
        told = [CurveInFile(curve.points, curve.closed, curve.more[:, : len(names)]) for curve in curves]
        encoded = _Csv(("x", "y", *names), ",", None, [curve.closed and mixed for curve in curves]).encode(told)
    elif kind == ".gpx":
        try:
            encoded = new_gpx(rows)
        except ValueError as error:
            raise CurveError(f"{path}: {error}") from None
    else:
        encoded = new_geo(rows)
    if kind == ".csv.gz":
        import gzip

        return gzip.compress(encoded, mtime=0)
    return encoded


def _family(kind: str) -> str:
    return {".csv.gz": ".csv", ".json": ".geojson"}.get(kind, kind)
