"""What a file of points holds: :class:`PointsFile`; and the error of such files."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..files.pictures import PictureError

# Names of normals among the data of points: an array, or its parts.
NORMALS = ("normals", "normal")
_PARTS = ("n{}", "normal_{}", "normal{}")
# Lengths of unit vectors in files with few digits.
_UNIT = 1e-2


class PointsError(PictureError):
    """A point cloud cannot be read or written; the message gives the file and the reason."""


@dataclass(frozen=True, eq=False)
class PointsFile:
    """The contents of a file of points, from :func:`read_points`.

    Attributes
    ----------
    points : (n, d) float64 array
    dtype : numpy.dtype
        The type of the coordinates in the file: float32 or float64, the latter for text.
    columns : dict
        The other data of the points by name, (n,) or (n, m) arrays: colours, labels, intensities.
    faces : (F, 3) array or None
        The triangles of a PLY file that is a mesh.
    names : tuple of str or None
        The names of the coordinates in the file; None if they have no names.
    delimiter : str
        The delimiter between numbers in text.
    comments : tuple of str
        The comments of a PLY or PCD file, and the lines of comments in text.
    others : dict
        The arrays of an NPZ file that do not belong to the points, by name.
    lost : tuple of str
        What the file holds beside that and is not read, in words.
    """

    points: FloatArray
    dtype: np.dtype[Any]
    columns: dict[str, npt.NDArray[Any]] = field(default_factory=dict)
    faces: npt.NDArray[Any] | None = None
    names: tuple[str, ...] | None = None
    delimiter: str = ","
    comments: tuple[str, ...] = ()
    others: dict[str, npt.NDArray[Any]] = field(default_factory=dict)
    lost: tuple[str, ...] = ()

    @property
    def normals(self) -> list[str]:
        """Names of the columns that are normals: three, or one with a row of d numbers for each point; else none."""
        d = self.points.shape[1]
        named = [[name for name in self.columns if name.lower() == word] for word in NORMALS]
        tables = [names[0] for names in named if names and self.columns[names[0]].shape == self.points.shape]
        if tables:
            return tables[:1]
        lower = {name.lower(): name for name in self.columns}
        for pattern in _PARTS:
            parts = [pattern.format(axis) for axis in "xyz"[:d]]
            if all(part in lower and self.columns[lower[part]].dtype.kind == "f" for part in parts):
                return [lower[part] for part in parts]
        # text without a header: three numbers after the coordinates that make unit vectors
        first = list(self.columns)[:d]
        if self.names is None and len(first) == d and all(name.startswith("column_") for name in first):
            length = np.linalg.norm(np.stack([self.columns[name] for name in first], axis=1), axis=1)
            if d == 3 and (np.abs(length - 1) < _UNIT).all():
                return first
        return []


def bytes_of(path: str | os.PathLike[str]) -> bytes:
    """Read a file; raise PointsError if it is not there, cannot be read or is empty."""
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise PointsError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise PointsError(f"{path} is a folder, not a file") from None
    except OSError as error:
        raise PointsError(f"{path} cannot be read: {error.strerror}") from None
    if not data.strip():
        raise PointsError(f"{path} is empty")
    return data
