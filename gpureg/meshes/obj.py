"""The OBJ format: polygons with places in a texture, normals, materials, groups and objects."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from .beside import Told
from .contents import Contents, Fault, numbers_of

# Words that begin a line, and the label of faces that they set.
_SETS = {"o": "object", "g": "group", "usemtl": "material", "s": "smoothing"}

_ZERO = re.compile(r"(?:^|[\s/])-?0+(?=[/\s]|$)")


def parse_obj(data: bytes) -> Contents:
    """Parse an OBJ file; raise Fault if it is damaged.

    An index < 0 counts from the last of the vertices (or places, normals) that stand before the face; 0 is illegal.
    """
    rows: dict[str, list[str]] = {"v": [], "vt": [], "vn": []}
    faces, before = list[str](), dict[int, tuple[int, int, int]]()
    # for each label its names, and the faces from which on one of them is valid
    names: dict[str, dict[str, int]] = {label: {} for label in _SETS.values()}
    changes: dict[str, list[tuple[int, int]]] = {label: [(0, -1)] for label in names}
    comments, libraries, other = list[str](), list[str](), dict[str, int]()
    for line in text_of(data).replace("\\\r\n", " ").replace("\\\n", " ").split("\n"):
        word, *rest = line.split(None, 1)[:2] or [""]
        if word in rows:
            rows[word].append(rest[0].partition("#")[0] if rest else "")
        elif word == "f":
            if rest and "-" in rest[0]:
                before[len(faces)] = len(rows["v"]), len(rows["vt"]), len(rows["vn"])
            faces.append(rest[0].partition("#")[0] if rest else "")
        elif word in _SETS:
            known = names[_SETS[word]]
            number = known.setdefault(rest[0].strip() if rest else "", len(known))
            changes[_SETS[word]].append((len(faces), number))
        elif word.startswith("#"):
            comments.append(line.strip()[1:].strip())
        elif word == "mtllib":
            libraries.append(rest[0].strip() if rest else "")
        elif word:
            word = word if word.isprintable() and len(word) < 20 else "?"
            other[word] = other.get(word, 0) + 1
    sizes = np.array([len(face.split()) for face in faces], np.int64)
    if (sizes < 3).any():
        short = faces[int(np.flatnonzero(sizes < 3)[0])].strip()
        raise Fault(f"it has a face with fewer than three corners, {f'f {short}'!r}")
    table = {word: _table(word, lines) for word, lines in rows.items()}
    lost = [f"{count} lines {word!r}" for word, count in other.items()]
    columns = _columns(faces)
    there = np.zeros((len(faces), 3), np.int64)
    there[list(before)] = np.array(list(before.values()), np.int64).reshape(-1, 3)
    corners, uv_of, normal_of = (
        _absolute(column, len(table[word]), np.repeat(there[:, k], sizes), word)
        for k, (column, word) in enumerate(zip(columns, table, strict=True))
    )
    found = Contents(
        table["v"][:, :3], sizes, corners, comments=tuple(comments), libraries=tuple(libraries), told=Told(lost)
    )
    _take_vertices(found, table["v"])
    widest = max((len(line.split()) for line in rows["v"]), default=0) if table["v"].shape[1] < 6 else 0
    if widest > max(table["v"].shape[1], 4):
        lost.append("the colours of vertices, which some have not")
    if (uv_of >= 0).any():
        found.uv, found.uv_of = table["vt"][:, :2], uv_of
        if table["vt"].shape[1] > 2 and table["vt"][:, 2].any():
            lost.append("the third number of places in the texture")
    if (normal_of >= 0).all() and len(normal_of):
        found.normals, found.normal_of = table["vn"][:, :3], normal_of
    elif (normal_of >= 0).any():
        lost.append("the normals, which some corners have not")
    for label, steps in changes.items():
        if names[label]:
            begins = np.array([begin for begin, _ in steps])
            counts = np.diff(begins, append=len(faces))
            found.of_faces[label] = np.repeat(np.array([number for _, number in steps], np.int32), counts)
            found.names[label] = tuple(names[label])
    return found


def text_of(data: bytes) -> str:
    """Decode text as UTF-8; its comments may be in another encoding."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _table(word: str, lines: list[str]) -> FloatArray:
    """Convert lines of numbers to an array; rows are cut to the shortest, which has at least three (vt: two)."""
    least = 2 if word == "vt" else 3
    width = len(lines[0].split()) if lines else 0
    text = " ".join(lines)
    flat = numbers_of(text, np.float64)
    if width >= least and len(flat) == width * len(lines):
        # it may be that two rows differ in length, and together do not
        if all(len(line.split()) == width for line in lines):
            return flat.reshape(-1, width)
    split = [line.split() for line in lines]
    if word == "vt":
        split = [[*row, "0"] if len(row) == 1 else row for row in split]
    width = min((len(row) for row in split), default=least)
    if width < least:
        raise Fault(f"it has a line {word!r} with {width} numbers")
    try:
        return np.array([row[:width] for row in split], np.float64).reshape(-1, width)
    except ValueError:
        raise Fault(f"it has a line {word!r} with words that are not numbers") from None


def _take_vertices(found: Contents, table: FloatArray) -> None:
    """Take what follows the coordinates: colours, or a weight."""
    more = table[:, 3:]
    if more.shape[1] in (1, 4) and (more[:, 0] != 1).any():
        found.told.lost.append("the weights of vertices")
    if more.shape[1] in (1, 4):
        more = more[:, 1:]
    if more.shape[1] == 3:
        scaled = more * (255 if more.max(initial=0) <= 1 else 1)
        found.at_vertices["colours"] = np.clip(np.rint(scaled), 0, 255).astype(np.uint8)
    elif more.shape[1]:
        found.told.lost.append(f"{more.shape[1]} numbers after the coordinates")


def _columns(faces: list[str]) -> list[IntArray]:
    """Return the indices of vertices, places and normals at all corners, (c,) each, 0 where there is none."""
    text = " ".join(faces)
    if _ZERO.search(text) is not None:
        wrong = next(face for face in faces if _ZERO.search(face)).strip()
        raise Fault(f"the first vertex has the number 1, and the face {f'f {wrong}'!r} names 0")
    if "/" not in text:
        corners = numbers_of(text, np.int64)
        return [corners, np.zeros_like(corners), np.zeros_like(corners)]
    words = text.split()
    slashes = {word.count("/") for word in words}
    try:
        if len(slashes) == 1 and max(slashes) < 3 and not re.search(r"/(?:\s|$)", text):
            table = numbers_of(text.replace("//", "/0/").replace("/", " "), np.int64).reshape(len(words), -1)
        else:
            parts = [(*word.split("/"), "", "")[:3] for word in words]
            table = np.array([[int(part or 0) for part in three] for three in parts], np.int64).reshape(-1, 3)
    except ValueError:
        raise Fault("it has a face with words that are not numbers") from None
    if (table[:, 0] == 0).any():
        raise Fault("it has a face without vertices")
    return [table[:, k] if k < table.shape[1] else np.zeros(len(table), np.int64) for k in range(3)]


def _absolute(index: IntArray, count: int, before: IntArray, word: str) -> IntArray:
    """Return indices from 0; -1 for none."""
    found: IntArray = np.where(index < 0, before + index, index - 1)
    wrong = (index != 0) & ((found < 0) | (found >= count))
    if wrong.any():
        k = int(np.flatnonzero(wrong)[0])
        there = f"has {count} of them" if index[k] > 0 else f"has {before[k]} of them before it"
        raise Fault(f"a face names number {index[k]} of the lines {word!r}, and the file {there}")
    return found


def digits_of(vertices: FloatArray) -> int:
    """Return how many digits after the point are 16 digits of the largest coordinate."""
    largest = float(np.abs(vertices[np.isfinite(vertices)]).max(initial=0))
    return max(0, 15 - math.floor(math.log10(largest))) if largest > 0 else 0


def encode_obj(
    vertices: FloatArray,
    colours: npt.NDArray[np.uint8] | None,
    sizes: IntArray,
    indices: list[IntArray | None],
    places: FloatArray | None,
    normals: FloatArray | None,
    labels: dict[str, list[str | None]],
    head: list[str],
) -> bytes:
    """Encode an OBJ file.

    Parameters
    ----------
    vertices : (n, 3) float array
    colours : (n, 3) uint8 array or None
    sizes : (P,) int array
    indices : list of three (c,) int arrays or None
        The vertex, the place in the texture and the normal at each corner.
    places, normals : (m, 2) and (k, 3) arrays or None
    labels : dict of lists of P names
    head : list of str
        Lines before all others.
    """
    form = "v " + " ".join([f"%.{digits_of(vertices)}f"] * 3) + (" %.6f %.6f %.6f" if colours is not None else "")
    table = vertices if colours is None else np.concatenate([vertices, colours / 255], axis=1)
    lines = [*head, *(form % tuple(row) for row in table.tolist())]
    lines += [] if places is None else [f"vt {u!r} {v!r}" for u, v in places.tolist()]
    lines += [] if normals is None else [f"vn {x:.9g} {y:.9g} {z:.9g}" for x, y, z in normals.tolist()]
    v, vt, vn = ([""] * int(sizes.sum()) if x is None else [str(i + 1) for i in x.tolist()] for x in indices)
    if indices[1] is None and indices[2] is None:
        words = v
    elif indices[2] is None:
        words = [f"{a}/{b}" for a, b in zip(v, vt, strict=True)]
    else:
        words = [f"{a}/{b}/{c}" for a, b, c in zip(v, vt, vn, strict=True)]
    now: dict[str, Any] = dict.fromkeys(labels)
    begin = 0
    for k, size in enumerate(sizes.tolist()):
        for word, label in _SETS.items():
            name = labels[label][k] if label in labels else None
            if name is not None and name != now[label]:
                lines.append(f"{word} {name}".rstrip())
                now[label] = name
        lines.append("f " + " ".join(words[begin : begin + size]))
        begin += size
    return "\n".join([*lines, ""]).encode()
