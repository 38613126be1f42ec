"""The OFF format: text of polygons, with colours."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from .contents import Contents, Fault, numbers_of
from .obj import digits_of, text_of

_BEGIN = re.compile(r"\s*(ST)?(C)?(N)?(4)?(n)?OFF\b")


def parse_off(data: bytes) -> Contents:
    """Parse an OFF file; raise Fault if it is damaged."""
    text = text_of(data)
    comments = [line.partition("#")[2].strip() for line in text.splitlines() if "#" in line]
    lines = [line.partition("#")[0].split() for line in text.splitlines()]
    whole = "\n".join(" ".join(words) for words in lines if words)
    begin = _BEGIN.match(whole)
    if begin is None:
        raise Fault("it does not begin with OFF and the numbers of vertices and faces")
    if begin[4] or begin[5]:
        raise Fault(f"its points are not in space: it is a file {begin[0].strip()}")
    rows = [line.split() for line in whole[begin.end() :].splitlines() if line.strip()]
    if not rows or not all(word.isdigit() for word in rows[0]) or len(rows[0]) < 2:
        raise Fault("it does not begin with OFF and the numbers of vertices and faces")
    n, count = (int(word) for word in rows[0][:2])
    rows = rows[1:]
    if len(rows) < n + count:
        raise Fault(f"it announces {n} vertices and {count} faces, and has {len(rows)} lines of them")
    last = rows[n + count - 1]
    if count and not (last[0].isdigit() and len(last) > int(last[0])):
        raise Fault(f"its last face is {' '.join(last)!r}")
    try:
        width = min((len(row) for row in rows[:n]), default=3)
        table = numbers_of(" ".join(word for row in rows[:n] for word in row[:width]), np.float64).reshape(n, width)
        sizes = np.array([int(row[0]) for row in rows[n : n + count]], np.int64)
        if any(len(row) <= size for row, size in zip(rows[n:], sizes.tolist(), strict=False)):
            raise Fault("it has a face with fewer corners than announced")
        corners = numbers_of(
            " ".join(x for row, size in zip(rows[n:], sizes.tolist(), strict=False) for x in row[1 : 1 + size]),
            np.int64,
        )
    except ValueError as error:
        raise error if isinstance(error, Fault) else Fault("it has words that are not numbers") from None
    if width < 3:
        raise Fault("it has a vertex with fewer than three coordinates")
    found = Contents(table[:, :3], sizes, corners, comments=tuple(line for line in comments if line))
    more = table[:, 3:]
    if begin[3] and more.shape[1] >= 3:
        found.normals, more = more[:, :3], more[:, 3:]
    # files without the letter C have colours too
    if more.shape[1] in (3, 4) or (begin[2] and more.shape[1] >= 3):
        found.at_vertices["colours"], more = _bytes(more[:, :4]), more[:, 4:]
    if begin[1] and more.shape[1] >= 2:
        found.uv, more = more[:, :2], more[:, 2:]
    if more.shape[1]:
        found.told.lost.append(f"{more.shape[1]} numbers after the coordinates")
    _take_colours(found, [row[1 + size :] for row, size in zip(rows[n:], sizes.tolist(), strict=False)])
    return found


def _take_colours(found: Contents, rest: list[list[str]]) -> None:
    """Take the colours of faces, if all have one."""
    widths = {len(row) for row in rest}
    if widths <= {3} or widths <= {4}:
        if widths:
            found.of_faces["colours"] = _bytes(np.array(rest, np.float64))
    elif widths != {0}:
        found.told.lost.append(f"the colours of {sum(bool(row) for row in rest)} faces, as they differ in kind")


def _bytes(colours: FloatArray) -> npt.NDArray[np.uint8]:
    """Convert colours of 0..255, or of 0..1 if all are, to bytes."""
    whole = colours.max(initial=0) > 1 or not (colours % 1).any()
    found: npt.NDArray[np.uint8] = np.clip(np.rint(colours if whole else 255 * colours), 0, 255).astype(np.uint8)
    return found


def encode_off(
    vertices: FloatArray,
    colours: npt.NDArray[np.uint8] | None,
    sizes: IntArray,
    corners: IntArray,
    of_faces: npt.NDArray[np.uint8] | None,
    comments: list[str],
) -> bytes:
    """Encode an OFF file; `colours` (n, 4) at vertices and `of_faces` (P, 3 or 4) are bytes."""
    form = " ".join([f"%.{digits_of(vertices)}f"] * 3) + (" %d %d %d %d" if colours is not None else "")
    table: Any = vertices if colours is None else np.concatenate([vertices, colours], axis=1)
    lines = ["OFF" if colours is None else "COFF", *(f"# {line}" for line in comments)]
    lines += [f"{len(vertices)} {len(sizes)} 0", *(form % tuple(row) for row in table.tolist())]
    begin, items = 0, corners.tolist()
    tails = [""] * len(sizes) if of_faces is None else ["".join(f" {x}" for x in row) for row in of_faces.tolist()]
    for size, tail in zip(sizes.tolist(), tails, strict=True):
        lines.append(f"{size} " + " ".join(map(str, items[begin : begin + size])) + tail)
        begin += size
    return "\n".join([*lines, ""]).encode()
