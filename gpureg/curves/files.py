"""Read and write polygonal curves: CSV, SVG and GeoJSON, including other contents of the last two."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..checks import flag
from ..doors import door
from ..files.pictures import PictureError, check_place, write_atomically
from ..files.table import encode_table, read_table, read_text
from ..shapes.ends import Ends, ends_of
from .documents import Geo, Svg, new_geo, new_svg

CURVE_FORMATS = (".csv", ".csv.gz", ".svg", ".geojson", ".json")


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
        Other numbers of each vertex: altitudes of GeoJSON, columns of CSV.
    ends : Ends or None
        Why the curve is open or closed; None if it was not read from a file.
    """

    points: FloatArray
    closed: bool
    more: FloatArray
    ends: Ends | None = field(default=None, repr=False)


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
        Whether coordinates are longitude and latitude: GeoJSON without another reference system.
    kind : str
        The extension.
    document : Document
        The other contents.
    """

    curves: list[CurveInFile]
    degrees: bool
    kind: str
    document: Document = field(repr=False)


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
        and polygons in any geometry, feature or collection.
    closed : bool, optional
        Whether the curves of a CSV file are closed. None: if some curves repeat the first vertex at the end (to 1e-6 of
        the mean segment), only these are closed; otherwise those whose ends are at most twice the 95 % quantile of the
        segments' lengths apart. SVG and GeoJSON files contain this information.

    Raises
    ------
    CurveError
        The file is missing, cannot be read, is damaged or has another format; it has no curve, or a curve with too few
        vertices or vertices that are not finite.
    """
    kind = curve_format(path)
    if closed is not None:
        flag("closed", closed)
        if not kind.startswith(".csv"):
            raise CurveError(f"{path}: a {kind} file says by itself which curves are closed")
    try:
        if kind.startswith(".csv"):
            found = _of_csv(path, closed)
        elif kind == ".svg":
            svg = Svg.of(read_text(path, CurveError))
            found = CurvesFile(_curves(svg.read()), False, kind, _Placed(svg))
        else:
            geo = Geo.of(read_text(path, CurveError))
            found = CurvesFile(_curves(geo.read()), geo.in_degrees, kind, _Placed(geo))
    except ValueError as error:
        if isinstance(error, CurveError):
            raise
        raise CurveError(f"{path}: {error}") from None
    if not found.curves:
        raise CurveError(f"{path} contains no polygonal curve")
    for k, curve in enumerate(found.curves):
        least = 3 if curve.closed else 2
        if len(curve.points) < least:
            raise CurveError(f"{path}: curve {k} has {len(curve.points)} vertices, it needs {least}")
        if not np.isfinite(curve.points).all():
            raise CurveError(f"{path}: curve {k} has a vertex that is not finite")
    return found


@dataclass(frozen=True, eq=False)
class _Placed:
    """An SVG or GeoJSON document, which adds or omits the closing vertex of a curve as its format needs."""

    document: Svg | Geo

    def encode(self, curves: Sequence[CurveInFile]) -> bytes:
        return self.document.write([np.concatenate([curve.points, curve.more], axis=1) for curve in curves])


def _curves(found: Sequence[tuple[FloatArray, bool]]) -> list[CurveInFile]:
    return [
        CurveInFile(rows[:, :2], closed, rows[:, 2:], replace(ends_of(rows[:, :2], closed), why="source"))
        for rows, closed in found
    ]


@dataclass(frozen=True, eq=False)
class _Csv:
    """The form of a CSV file: its header, its delimiter, and how its curves are separated."""

    names: tuple[str, ...] | None
    delimiter: str
    by_column: IntArray | None
    repeated: list[bool]

    def encode(self, curves: Sequence[CurveInFile]) -> bytes:
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
    curves = []
    for part, one in zip(parts, ends, strict=True):
        own = part[:-1] if one.repeated else part
        curves.append(CurveInFile(own[:, [x, y]], one.closed, own[:, rest], one))
    head = None
    if names is not None:
        head = (names[x], names[y], *([] if which is None else [names[which]]), *(names[k] for k in rest))
    document = _Csv(head, table.delimiter, None if which is None else numbers, [one.repeated for one in ends])
    return CurvesFile(curves, False, ".csv", document)


@door
def write_curves(
    path: str | os.PathLike[str], curves: Sequence[CurveInFile], *, like: CurvesFile | None = None
) -> None:
    """Write curves in the format of the extension, completely or not at all.

    Parameters
    ----------
    path : path
        A name that ends in .csv, .csv.gz, .svg, .geojson or .json. An existing file is replaced when the new one is
        complete.
    curves : sequence of CurveInFile
    like : CurvesFile, optional
        The source of the curves: if it has the same format and number of curves, its other contents are written too.

    Raises
    ------
    CurveError, PictureError
        An unknown extension; a folder that does not exist; an error of the disk.

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
    else:
        encoded = new_geo(rows)
    if kind == ".csv.gz":
        import gzip

        return gzip.compress(encoded, mtime=0)
    return encoded


def _family(kind: str) -> str:
    return {".csv.gz": ".csv", ".json": ".geojson"}.get(kind, kind)
