"""The contents of files of curves: :class:`CurvesFile`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ..arrays import FloatArray, IntArray
from ..files.pictures import PictureError
from ..shapes.ends import Ends
from .lines import Line

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


def treated(path: str | os.PathLike[str], lines: Sequence[Line]) -> tuple[list[int], tuple[str, ...]]:
    """Return the numbers of the curves that can be treated, and the reasons of the others."""
    faults = [line.untreatable() for line in lines]
    own = [k for k, fault in enumerate(faults) if fault is None]
    left = tuple(fault for fault in faults if fault is not None)
    if not own:
        why = f" that can be treated: {'; '.join(left[:5])}" if left else ""
        raise CurveError(f"{path} contains no polygonal curve{why}")
    return own, left
