"""Read and write the points of PCD files, the format of the Point Cloud Library, as text or binary."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from .contents import PointsError, PointsFile, bytes_of

_WORDS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_TYPES = {"I": "i", "U": "u", "F": "f"}


def of_pcd(path: str | os.PathLike[str], columns: tuple[str, ...] | None) -> PointsFile:
    """Read a PCD file, see :func:`gpureg.read_points`."""
    data = bytes_of(path)
    told, comments, begin = _header(data)
    try:
        names, count = told["FIELDS"], int(told["POINTS"][0])
        sizes, kinds = told["SIZE"], told["TYPE"]
        several = [int(word) for word in told.get("COUNT", ["1"] * len(names))]
        types = [f"<{_TYPES[kind]}{size}" for kind, size in zip(kinds, sizes, strict=True)]
        how = told["DATA"][0].lower()
        # padding has the name _, more than once
        fields = [
            (f"{name}#{i}" if name == "_" else name, kind, (m,))
            for i, (name, kind, m) in enumerate(zip(names, types, several, strict=True))
        ]
        row = np.dtype(fields)
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise PointsError(f"{path} is damaged, or no PCD file: its header has no valid {error}") from None
    if how == "binary_compressed":
        raise PointsError(f"{path} is compressed: pcl_convert_pcd_ascii_binary of PCL writes it as plain binary")
    if how == "ascii":
        table = _of_text(path, data[begin:], fields, count)
    elif len(data) - begin < count * row.itemsize:
        held = (len(data) - begin) // row.itemsize
        raise PointsError(f"{path} is truncated: it announces {count} points, and has {held}")
    else:
        raw = np.frombuffer(data, row, count, begin)
        table = {name: raw[name].astype(kind[1:]) for name, kind, _ in fields}
    if not count or any(axis not in table or table[axis].shape[1:] != (1,) for axis in "xyz"):
        raise PointsError(f"{path} holds no points x, y, z; it has {', '.join(names)}")
    points = np.concatenate([table[axis] for axis in "xyz"], axis=1)
    dtype = np.dtype(np.float32 if points.dtype == np.float32 else np.float64)
    rest: dict[str, npt.NDArray[Any]] = {}
    for name, _, (m,) in fields:
        if name in ("x", "y", "z") or "#" in name:
            continue
        rest |= {name if m == 1 else f"{name}_{i + 1}": table[name][:, i] for i in range(m)}
    width, height = (int(told.get(word, ["1"])[0]) for word in ("WIDTH", "HEIGHT"))
    lost = [f"the {width} x {height} raster of the points, which are a list now"] if height > 1 else []
    view = told.get("VIEWPOINT", [])
    comments += (f"VIEWPOINT {' '.join(view)}",) if view else ()
    return PointsFile(points.astype(np.float64), dtype, rest, None, comments=comments, lost=tuple(lost))


def _header(data: bytes) -> tuple[dict[str, list[str]], tuple[str, ...], int]:
    """Return the words of the header by the first of each line, the comments, and where the points begin."""
    told, comments, begin = dict[str, list[str]](), list[str](), 0
    while "DATA" not in told and begin < len(data):
        end = data.find(b"\n", begin)
        end = len(data) if end < 0 else end
        line = data[begin:end].decode("utf-8", "replace").strip()
        begin = end + 1
        word, *rest = line.split() or [""]
        if line.startswith("#"):
            comments.append(line)
        elif word in _WORDS:
            told[word] = rest
        elif word:
            break
    return told, tuple(comments), begin


def _of_text(path: Any, body: bytes, fields: list[Any], count: int) -> dict[str, npt.NDArray[Any]]:
    try:
        words = [line.split() for line in body.decode("ascii").splitlines() if line.strip()]
        table, k = dict[str, npt.NDArray[Any]](), 0
        for name, kind, (m,) in fields:
            # an integer of 64 bits has more digits than a float
            whole = int if kind[1] in "iu" else float
            column = [[whole(row[i]) for i in range(k, k + m)] for row in words[:count]]
            table[name] = np.array(column, kind[1:]).reshape(-1, m)
            k += m
    except (ValueError, IndexError, OverflowError) as error:
        raise PointsError(f"{path} is damaged: {error}") from None
    if len(words) < count:
        raise PointsError(f"{path} is truncated: it announces {count} points, and has {len(words)}")
    return table


def pcd(x: npt.NDArray[Any], told: dict[str, npt.NDArray[Any]], comments: tuple[str, ...] = ()) -> bytes:
    """Encode points (n, 3) and numbers at them as a binary PCD file; `comments` may hold its viewpoint."""
    columns = {axis: x[:, k] for k, axis in enumerate("xyz")} | told
    for name, values in columns.items():
        if not name.strip() or len(name.split()) > 1:
            raise PointsError(f"the name of a PCD's field must be one word, got {name!r}")
        if values.dtype.kind == "b":
            columns[name] = values.astype(np.uint8)
    rows = np.empty(len(x), [(name, f"<{values.dtype.str[1:]}") for name, values in columns.items()])
    for name, values in columns.items():
        rows[name] = values
    letters = {small: large for large, small in _TYPES.items()}
    view = [line for line in comments if line.startswith("VIEWPOINT")] or ["VIEWPOINT 0 0 0 1 0 0 0"]
    header = [
        *(line for line in comments if line.startswith("#")),
        "VERSION 0.7",
        f"FIELDS {' '.join(columns)}",
        f"SIZE {' '.join(str(values.dtype.itemsize) for values in columns.values())}",
        f"TYPE {' '.join(letters[values.dtype.kind] for values in columns.values())}",
        f"COUNT {' '.join('1' for _ in columns)}",
        f"WIDTH {len(x)}",
        "HEIGHT 1",
        view[0],
        f"POINTS {len(x)}",
        "DATA binary\n",
    ]
    return "\n".join(header).encode() + rows.tobytes()
