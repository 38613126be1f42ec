"""Write the PLY format: binary files of polygons."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import IntArray
from .ply import TYPES

# Names of types in files, by numpy's.
WRITTEN = {kind: name for name, kind in TYPES.items() if not name[-1].isdigit()}


def encode_ply(
    vertices: npt.NDArray[Any],
    columns: dict[str, npt.NDArray[Any]],
    sizes: IntArray,
    corners: IntArray,
    of_faces: dict[str, npt.NDArray[Any]],
    places: npt.NDArray[Any] | None,
    comments: list[str],
) -> bytes:
    """Encode a binary PLY file.

    Parameters
    ----------
    vertices : (n, 3) float32 or float64 array
    columns : dict of (n,) arrays
        Numbers at the vertices, in types of `WRITTEN`.
    sizes, corners : (P,) and (c,) int arrays
        The polygons.
    of_faces : dict of (P,) arrays
    places : (c, 2) float32 array or None
        Places in the texture at the corners.
    comments : list of str
        Lines of the header.
    """
    points = {axis: vertices[:, k] for k, axis in enumerate("xyz")} | columns
    header = ["ply", "format binary_little_endian 1.0", *comments, f"element vertex {len(vertices)}"]
    header += _properties(points)
    count = "uchar" if not len(sizes) or sizes.max() < (128 if places is not None else 256) else "int"
    header += [f"element face {len(sizes)}", f"property list {count} int vertex_indices"]
    header += [] if places is None else [f"property list {count} float texcoord"]
    header += [*_properties(of_faces), "end_header\n"]
    table = np.empty(len(vertices), [(name, f"<{x.dtype.str[1:]}") for name, x in points.items()])
    for name, values in points.items():
        table[name] = values
    rows = _rows(sizes, corners, of_faces, places, "u1" if count == "uchar" else "<i4")
    return "\n".join(header).encode() + table.tobytes() + rows


def _properties(columns: dict[str, npt.NDArray[Any]]) -> list[str]:
    return [f"property {WRITTEN[values.dtype.str[1:]]} {name}" for name, values in columns.items()]


def _rows(
    sizes: IntArray,
    corners: IntArray,
    of_faces: dict[str, npt.NDArray[Any]],
    places: npt.NDArray[Any] | None,
    count: str,
) -> bytes:
    """Encode the polygons, those with the same number of corners at a time."""
    starts = np.cumsum(sizes) - sizes
    each, kinds = np.zeros(len(sizes), np.int64), {}
    for size in np.unique(sizes).tolist():
        kind: list[Any] = [("n", count), ("corners", "<i4", (size,))]
        kind += [] if places is None else [("m", count), ("places", "<f4", (2 * size,))]
        kinds[size] = np.dtype(kind + [(f"_{name}", f"<{x.dtype.str[1:]}") for name, x in of_faces.items()])
        each[sizes == size] = kinds[size].itemsize
    begin = np.cumsum(each) - each
    out = np.empty(int(each.sum()), np.uint8)
    for size, row in kinds.items():
        at = np.flatnonzero(sizes == size)
        items = starts[at, None] + np.arange(size)
        rows = np.empty(len(at), row)
        rows["n"], rows["corners"] = size, corners[items]
        if places is not None:
            rows["m"], rows["places"] = 2 * size, places[items].reshape(len(at), -1)
        for name, values in of_faces.items():
            rows[f"_{name}"] = values[at]
        out[begin[at, None] + np.arange(row.itemsize)] = rows.view(np.uint8).reshape(len(at), -1)
    return out.tobytes()
