"""Read and write point clouds: PLY, PCD, XYZ, CSV (also packed by gzip) and NPZ."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..doors import door
from ..files.pictures import check_place, write_atomically
from ..files.table import encode_table, read_table
from .contents import PointsError, PointsFile
from .pcd import of_pcd, pcd
from .ply import of_ply, ply

POINT_FORMATS = (".ply", ".pcd", ".xyz", ".csv", ".csv.gz", ".npz")

# Columns that are a class and not a coordinate, if the header does not name coordinates x, y, z.
_CLASSES = ("label", "labels", "class", "cluster", "target")


def point_format(path: str | os.PathLike[str]) -> str:
    """Return the extension of a file of points; raise PointsError if it is unknown."""
    name = Path(path).name.lower()
    found = [kind for kind in POINT_FORMATS if name.endswith(kind) and len(name) > len(kind)]
    if not found:
        raise PointsError(f"{path}: the extension of points must be one of {', '.join(POINT_FORMATS)}")
    return found[-1]


@door
def read_points(path: str | os.PathLike[str], *, columns: tuple[str, ...] | None = None) -> PointsFile:
    """Read points and their other data, in the order of the file.

    Parameters
    ----------
    path : path
        .ply, .pcd (not compressed), .xyz (text, three coordinates first), .csv, .csv.gz, or .npz (an array ``points``,
        or the only one with two axes).
    columns : tuple of str, optional
        Names of the columns that are coordinates, for text with a header. None: x, y and z if present, otherwise all
        columns except those called label, labels, class, cluster or target.

    Raises
    ------
    PointsError
        The file is missing, cannot be read, is truncated or has another format; a column does not exist.
    """
    found = read_all(path, columns)
    if not np.isfinite(found.points).all():
        row = int(np.flatnonzero(~np.isfinite(found.points).all(axis=1))[0])
        raise PointsError(f"{path}: point {row} is not finite; take such points out first")
    return found


def read_all(path: str | os.PathLike[str], columns: tuple[str, ...] | None = None) -> PointsFile:
    """Read points as :func:`read_points` does, also those that are not finite."""
    kind = point_format(path)
    if columns is not None and kind not in (".csv", ".csv.gz", ".xyz"):
        raise PointsError(f"{path}: columns are chosen in text; a {kind} file says by itself which are coordinates")
    return _READERS[kind](path, columns)


def _of_text(path: str | os.PathLike[str], columns: tuple[str, ...] | None) -> PointsFile:
    table = read_table(path, PointsError)
    count = table.rows.shape[1]
    names = table.names
    if names is None:
        if columns is not None:
            raise PointsError(f"{path} has no header that would name columns")
        chosen = list(range(min(3, count) if point_format(path) == ".xyz" else count))
    else:
        chosen = _coordinates(path, names, columns)
    rest = [k for k in range(count) if k not in chosen]
    told = {
        (f"column_{k + 1}" if names is None else names[k]): (
            table.rows[:, k].astype(np.int64) if table.whole[k] else table.rows[:, k]
        )
        for k in rest
    }
    called = None if names is None else tuple(names[k] for k in chosen)
    return PointsFile(
        np.ascontiguousarray(table.rows[:, chosen]), np.dtype(np.float64), told, None, called, table.delimiter,
        comments=table.comments, lost=("comments behind numbers",) if table.behind else (),
    )  # fmt: skip


def _coordinates(path: str | os.PathLike[str], names: tuple[str, ...], columns: tuple[str, ...] | None) -> list[int]:
    if columns is not None:
        missing = [name for name in columns if name not in names]
        if missing:
            raise PointsError(f"{path} has no column {missing[0]!r}; it has {', '.join(names)}")
        return [names.index(name) for name in columns]
    lower = [name.lower() for name in names]
    if "x" in lower and "y" in lower:
        return [lower.index(axis) for axis in "xyz" if axis in lower]
    chosen = [k for k, name in enumerate(lower) if name not in _CLASSES]
    if not chosen:
        raise PointsError(f"{path} has no column of coordinates; it has {', '.join(names)}")
    return chosen


def _of_npz(path: str | os.PathLike[str], columns: tuple[str, ...] | None) -> PointsFile:
    try:
        with np.load(Path(path), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise PointsError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise PointsError(f"{path} is a folder, not a file") from None
    except (ValueError, zipfile.BadZipFile, EOFError, OSError) as error:
        raise PointsError(f"{path} is damaged, or no NPZ file of plain arrays: {error}") from None
    tables = [name for name, array in arrays.items() if array.ndim == 2]
    name = "points" if "points" in arrays else tables[0] if len(tables) == 1 else None
    if name is None or arrays[name].ndim != 2 or arrays[name].dtype.kind not in "iuf" or 0 in arrays[name].shape:
        raise PointsError(
            f"{path} needs an array 'points' of numbers with two axes; it has {', '.join(arrays) or 'none'}"
        )
    given = arrays.pop(name)
    dtype = np.dtype(np.float32 if given.dtype.itemsize <= 4 and given.dtype.kind == "f" else np.float64)
    told = {key: array for key, array in arrays.items() if array.shape[:1] == (len(given),)}
    others = {key: array for key, array in arrays.items() if key not in told}
    return PointsFile(given.astype(np.float64), dtype, told, None, (name,), others=others)


_READERS = {".ply": of_ply, ".pcd": of_pcd, ".xyz": _of_text, ".csv": _of_text, ".csv.gz": _of_text, ".npz": _of_npz}


@door
def write_points(
    path: str | os.PathLike[str],
    points: npt.ArrayLike,
    columns: Mapping[str, npt.ArrayLike] | None = None,
    *,
    like: PointsFile | None = None,
) -> None:
    """Write points and their other data in the format of the extension, completely or not at all.

    Parameters
    ----------
    path : path
        A name that ends in .ply, .pcd, .xyz, .csv, .csv.gz or .npz. An existing file is replaced when the new one is
        complete.
    points : (n, d) array
        PLY, PCD and XYZ need three coordinates.
    columns : mapping of str to (n,) arrays, optional
        Numbers at the points. NPZ takes arrays with any number of axes.
    like : PointsFile, optional
        The source of the points: its type of coordinates (PLY, PCD, NPZ), triangles (PLY), comments, arrays that do
        not belong to points (NPZ), header and delimiter (text) are used.

    Raises
    ------
    PointsError, PictureError
        An unknown extension; points or columns that the format does not support; a folder that does not exist; an error
        of the disk.

    Examples
    --------
    >>> import os, tempfile
    >>> from gpureg.points.files import read_points, write_points
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_points(os.path.join(folder, "a.csv"), [[0.1, 2], [3, 4]], {"label": [1, 0]})
    ...     found = read_points(os.path.join(folder, "a.csv"))
    >>> found.points.tolist(), found.columns["label"].tolist()
    ([[0.1, 2.0], [3.0, 4.0]], [1, 0])
    """
    encoded = encode_points(path, points, columns, like=like)
    check_place(path)
    write_atomically(path, lambda temporary: temporary.write_bytes(encoded))


def encode_points(
    path: str | os.PathLike[str],
    points: npt.ArrayLike,
    columns: Mapping[str, npt.ArrayLike] | None = None,
    *,
    like: PointsFile | None = None,
) -> bytes:
    """Encode points as :func:`write_points` writes them to a file of that name, with the same errors."""
    kind = point_format(path)
    x = np.asarray(points)
    if x.ndim != 2 or x.dtype.kind not in "biuf":
        raise PointsError(f"points must be numbers of shape (n, d), got {x.dtype} of {x.shape}")
    x = x.astype(np.float64) if x.dtype.kind != "f" else x
    told = {name: np.asarray(values) for name, values in (columns or {}).items()}
    for name, values in told.items():
        if values.shape[:1] != (len(x),):
            raise PointsError(f"the column {name!r} must have {len(x)} rows, one per point, got {values.shape}")
        if kind != ".npz" and (values.ndim != 1 or values.dtype.kind not in "biuf"):
            raise PointsError(f"a {kind} file has one number per point and column, {name!r} has shape {values.shape}")
    if like is not None:
        x = x.astype(like.dtype)
    if kind == ".npz":
        file = io.BytesIO()
        own = like.names[0] if like is not None and like.names is not None and len(like.names) == 1 else "points"
        arrays: dict[str, Any] = (like.others if like is not None else {}) | {own: x} | told
        np.savez_compressed(file, **arrays)
        return file.getvalue()
    if kind in (".ply", ".pcd", ".xyz") and x.shape[1] != 3:
        raise PointsError(f"a {kind} file needs points with three coordinates, got {x.shape[1]}: use .csv or .npz")
    comments = _comments(kind, like)
    if kind == ".ply":
        return ply(x, told, None if like is None else like.faces, comments)
    if kind == ".pcd":
        return pcd(x, told, comments)
    return _text(kind, x, told, like)


def _text(kind: str, x: npt.NDArray[Any], told: dict[str, npt.NDArray[Any]], like: PointsFile | None) -> bytes:
    whole = {name: values.astype(np.int64) if values.dtype.kind == "b" else values for name, values in told.items()}
    named = like is not None and like.names is not None and len(like.names) == x.shape[1]
    axes = like.names if like is not None and named else _axes(x.shape[1])
    bare = kind == ".xyz" or (like is not None and like.names is None and not whole.keys() - like.columns.keys())
    delimiter = " " if kind == ".xyz" else like.delimiter.replace(" ", ",") if like is not None else ","
    names = None if bare else [*(axes or ()), *whole]
    lines = "".join(f"{line}\n" for line in _comments(kind, like))
    encoded = lines.encode() + encode_table([*x.T, *whole.values()], names, delimiter)
    if kind == ".csv.gz":
        import gzip

        # no time stamp, so that equal points give equal bytes
        return gzip.compress(encoded, mtime=0)
    return encoded


# How a line of comments begins.
_SIGNS = {".ply": ("comment ", "obj_info "), ".pcd": ("# ",), ".npz": ()}


def _comments(kind: str, like: PointsFile | None) -> tuple[str, ...]:
    """Return the comments of the source as lines of another format; what a PCD's viewpoint is only a PCD can say."""
    signs = _SIGNS.get(kind, ("# ",))
    if like is None or not signs:
        return ()
    told = []
    for line in like.comments:
        if line.startswith("VIEWPOINT"):
            told += [line] if kind == ".pcd" else []
            continue
        bare = line.removeprefix("comment ").removeprefix("#").strip()
        told.append(line if line.startswith(signs) else f"{signs[0]}{bare}")
    return tuple(told)


def lost_in(path: str | os.PathLike[str], like: PointsFile) -> list[str]:
    """Name what a file of points held that a file with the name `path` does not, in words."""
    kind = point_format(path)
    lost = list(like.lost)
    if like.comments and not _SIGNS.get(kind, ("# ",)):
        lost.append(f"{len(like.comments)} lines of comments")
    if like.faces is not None and kind != ".ply":
        lost.append(f"{len(like.faces)} triangles")
    if like.others and kind != ".npz":
        lost += [f"the array {name!r}" for name in like.others]
    named = [name for name in like.columns if not name.startswith("column_")]
    if kind == ".xyz" and named:
        lost.append(f"the names of the columns {', '.join(named)}")
    return lost


def _axes(d: int) -> tuple[str, ...]:
    return tuple("xyz"[:d]) if d <= 3 else tuple(f"x{k + 1}" for k in range(d))
