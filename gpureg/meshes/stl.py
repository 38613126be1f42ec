"""The STL format: triangles without shared vertices, in text or binary."""

from __future__ import annotations

import re
import struct

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from .beside import Told
from .contents import Contents, Fault, same_rows
from .obj import text_of

_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_SOLID = re.compile(r"^[ \t]*solid\b[ \t]*(.*)$", re.MULTILINE | re.IGNORECASE)


def parse_stl(data: bytes) -> Contents:
    """Parse an STL file; corners at the same point become one vertex, in the order of the file."""
    if data.lstrip()[:5].lower() == b"solid" and b"\0" not in data:
        return _text(text_of(data))
    if len(data) < 84:
        raise Fault("it is shorter than a header")
    (count,) = struct.unpack("<I", data[80:84])
    there = (len(data) - 84) / _ROW.itemsize
    if there != count:
        raise Fault(f"it announces {count} triangles, and has bytes for {there:.6g}")
    rows = np.frombuffer(data, _ROW, count, 84)
    found = _merged(rows["corners"].reshape(-1, 3))
    if rows["attribute"].any():
        found.told.lost.append("the two bytes, such as a colour, after each triangle")
    title = data[:80].strip(b"\0 ").decode("latin-1")
    found.comments = (title,) if title and title.isprintable() else ()
    return found


def _text(text: str) -> Contents:
    if "endsolid" not in text.lower():
        raise Fault("its text does not end with endsolid")
    words = re.findall(r"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", text, re.IGNORECASE)
    try:
        corners = np.array(words, np.float64).reshape(-1, 3)
    except ValueError:
        raise Fault("it has a vertex with words that are not numbers") from None
    if len(corners) % 3 or len(corners) != 3 * len(re.findall(r"\bendfacet\b", text, re.IGNORECASE)):
        raise Fault("it has a facet without three corners")
    found = _merged(corners)
    parts = list(_SOLID.finditer(text))
    if len(parts) > 1:
        ends = [*(part.start() for part in parts[1:]), len(text)]
        counts = [
            len(re.findall(r"\bendfacet\b", text[part.start() : end], re.IGNORECASE))
            for part, end in zip(parts, ends, strict=True)
        ]
        found.of_faces["object"] = np.repeat(np.arange(len(parts), dtype=np.int32), counts)
        found.names["object"] = tuple(part[1].strip() or f"solid {k}" for k, part in enumerate(parts))
    elif parts and parts[0][1].strip():
        found.comments = (parts[0][1].strip(),)
    return found


def _merged(corners: npt.NDArray[np.floating]) -> Contents:
    first, which = same_rows(corners)
    sizes = np.full(len(corners) // 3, 3)
    return Contents(corners[first].astype(np.float64), sizes, which, np.dtype(np.float32), told=Told())


def encode_stl(vertices: FloatArray, corners: IntArray, title: str) -> bytes:
    """Encode triangles, (3 F,) corners, as a binary STL file."""
    rows = np.zeros(len(corners) // 3, _ROW)
    triangles = vertices[corners.reshape(-1, 3)]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    rows["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    rows["corners"] = triangles
    # a title that begins with solid would be taken for text
    head = title.encode("latin-1", "replace")[:80] if not title.lower().startswith("solid") else b""
    return head.ljust(80, b"\0") + struct.pack("<I", len(rows)) + rows.tobytes()
