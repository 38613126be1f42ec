"""Read and write polygonal curves: CSV, SVG, GeoJSON and GPX, including other contents of the last three."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..checks import flag
from ..doors import door, outside
from ..files.pictures import check_place, write_atomically
from ..files.table import read_text
from ..shapes.ends import ends_of
from .contents import CurveError, CurveInFile, CurvesFile, curve_format, treated
from .csv import Csv, read_csv
from .geojson import Geo, new_geo
from .gpx import Gpx, new_gpx
from .lines import Line
from .svg import Svg, new_svg


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
            return read_csv(path, closed)
        text = read_text(path, CurveError)
        document = Svg.of(text) if kind == ".svg" else Gpx.of(text) if kind == ".gpx" else Geo.of(text)
        lines = document.read()
        own, left = treated(path, lines)
        degrees = isinstance(document, Gpx) or (isinstance(document, Geo) and document.in_degrees)
        return CurvesFile([_curve(lines[k]) for k in own], degrees, kind, _Placed(document, len(lines), own), left)
    except ValueError as error:
        if isinstance(error, CurveError):
            raise
        raise CurveError(f"{path}: {error}") from None


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
        encoded = Csv(("x", "y", *names), ",", None, [curve.closed and mixed for curve in curves]).encode(told)
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


def same_format(one: str | os.PathLike[str], other: str | os.PathLike[str]) -> bool:
    """Return whether two files of curves have one format, so that contents of the one can be in the other."""
    return _family(curve_format(one)) == _family(curve_format(other))


def _family(kind: str) -> str:
    return {".csv.gz": ".csv", ".json": ".geojson"}.get(kind, kind)
