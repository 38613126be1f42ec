"""Read and write the points of PLY files."""

from __future__ import annotations

import io
import os
import re
from typing import Any

import numpy as np
import numpy.typing as npt

from .contents import PointsError, PointsFile, bytes_of

_PLY_TYPES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint"}
_PLY_TYPES |= {"f4": "float", "f8": "double"}
# Names of the corners of faces.
_CORNERS = ("vertex_indices", "vertex_index")


def of_ply(path: str | os.PathLike[str], columns: tuple[str, ...] | None) -> PointsFile:
    """Read a PLY file, see :func:`gpureg.read_points`."""
    import trimesh

    data = bytes_of(path)
    comments, elements = _header(data)
    # trimesh would look for the picture
    plain = re.sub(rb"(?m)^comment[^\n]*TextureFile[^\n]*\n", b"", data[: _end(data)]) + data[_end(data) :]
    try:
        loaded = trimesh.load(io.BytesIO(plain), file_type="ply", process=False)
        raw = loaded.metadata["_ply_raw"]["vertex"]
        kinds, table, count = raw["properties"], raw["data"], raw["length"]
        values = {name: np.array(table[name]).reshape(-1) for name, kind in kinds.items() if "," not in kind}
        points = np.stack([values.pop(axis) for axis in "xyz"], axis=1)
    except MemoryError:
        raise
    except Exception as error:  # the parser of trimesh raises many types of errors
        raise PointsError(f"{path} is damaged, truncated or no PLY file with points x, y, z") from error
    if len(points) != count or not count:
        raise PointsError(f"{path} is truncated or empty: it announces {count} points, and has {len(points)}")
    dtype = np.dtype(np.float32 if "f4" in kinds["x"] else np.float64)
    told = {name: column.astype(column.dtype.newbyteorder("=")) for name, column in values.items()}
    faces = np.asarray(getattr(loaded, "faces", np.zeros((0, 3), int)))
    announced = elements.get("face", (0, []))[0]
    lost = [f"the list {name!r} at points" for name, kind in kinds.items() if "," in kind]
    lost += [f"the {n} elements {name!r}" for name, (n, _) in elements.items() if name not in ("vertex", "face") and n]
    lost += [f"the property {name!r} of faces" for name in elements.get("face", (0, []))[1] if name not in _CORNERS]
    if announced and len(faces) != announced:
        lost.append(f"the corners of {announced} faces, which are {len(faces)} triangles now")
    return PointsFile(
        points.astype(np.float64), dtype, told, faces if len(faces) else None, comments=comments, lost=tuple(lost)
    )


def _end(data: bytes) -> int:
    """Return where the header ends."""
    return max(data.find(b"end_header"), 0)


def _header(data: bytes) -> tuple[tuple[str, ...], dict[str, tuple[int, list[str]]]]:
    """Return the comments, and the number and the names of the properties of each element."""
    comments, elements = [], dict[str, tuple[int, list[str]]]()
    for line in data[: _end(data)].decode("utf-8", "replace").splitlines():
        word, _, rest = line.strip().partition(" ")
        names = rest.split()
        if word in ("comment", "obj_info"):
            comments.append(f"{word} {rest}")
        elif word == "element" and len(names) > 1 and names[1].isdecimal():
            elements[names[0]] = (int(names[1]), [])
        elif word == "property" and elements and names:
            elements[list(elements)[-1]][1].append(names[-1])
    return tuple(comments), elements


def ply(
    x: npt.NDArray[Any],
    told: dict[str, npt.NDArray[Any]],
    faces: npt.NDArray[Any] | None,
    comments: tuple[str, ...] = (),
) -> bytes:
    """Encode points (n, 3), numbers at them, triangles (F, 3) and lines of comments as a PLY file."""
    columns = {axis: x[:, k] for k, axis in enumerate("xyz")} | told
    kept = {}
    for name, values in columns.items():
        if not re.fullmatch(r"[!-~]+", name):
            raise PointsError(f"the name of a PLY's property must be one word, got {name!r}")
        short = values.dtype.str[1:]
        if values.dtype.kind in "iu" and short not in _PLY_TYPES:
            narrow = values.astype(np.int32)
            values = narrow if np.array_equal(narrow, values) else values.astype(np.float64)
        elif short not in _PLY_TYPES:
            values = values.astype(np.uint8 if values.dtype.kind == "b" else np.float64)
        kept[name] = values
    rows = np.empty(len(x), [(name, f"<{values.dtype.str[1:]}") for name, values in kept.items()])
    for name, values in kept.items():
        rows[name] = values
    header = ["ply", "format binary_little_endian 1.0", *comments, f"element vertex {len(rows)}"]
    header += [f"property {_PLY_TYPES[values.dtype.str[1:]]} {name}" for name, values in kept.items()]
    body = rows.tobytes()
    if faces is not None:
        corners = np.empty(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
        corners["count"], corners["corners"] = 3, faces
        header += [f"element face {len(corners)}", "property list uchar int vertex_indices"]
        body += corners.tobytes()
    return "\n".join([*header, "end_header\n"]).encode() + body
