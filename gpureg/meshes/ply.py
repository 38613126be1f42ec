"""Read the PLY format: text and binary files of polygons."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import IntArray
from .beside import Told
from .contents import CHANNELS, Contents, Fault

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8"},
}

# Names that writers give to a place in a texture at a vertex.
_PLACES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_LABELS = ("object", "group", "material", "smoothing")
_CORNERS = ("vertex_indices", "vertex_index")


@dataclass
class _Property:
    """A property of an element; `count` is the type of a list's length, None for a number."""

    name: str
    kind: str
    count: str | None = None


@dataclass
class _Element:
    """An element: its rows' numbers, (n,) each, and its lists: the lengths, (n,), and all items."""

    name: str
    length: int
    properties: list[_Property] = field(default_factory=list)
    numbers: dict[str, npt.NDArray[Any]] = field(default_factory=dict)
    lists: dict[str, tuple[IntArray, npt.NDArray[Any]]] = field(default_factory=dict)

    def take(self, *names: str) -> npt.NDArray[Any] | None:
        """Remove columns of numbers and return them as (n, k); None if one is missing."""
        if any(name not in self.numbers for name in names):
            return None
        return np.stack([self.numbers.pop(name) for name in names], axis=1)


def parse_ply(data: bytes) -> Contents:
    """Parse a PLY file; raise Fault if it is damaged."""
    head, mark, _ = data.partition(b"end_header")
    if not mark:
        raise Fault("its header does not end")
    begin = data.find(b"\n", len(head)) + 1 or len(data)
    form, comments, elements = _header(head.decode("utf-8", "replace"))
    if form == "ascii":
        _read_text(data[begin:], elements)
    else:
        _read_binary(data[begin:], elements, ">" if form == "binary_big_endian" else "<")
    return _contents({element.name: element for element in elements}, comments)


def _header(text: str) -> tuple[str, list[str], list[_Element]]:
    form, comments, elements = "", list[str](), list[_Element]()
    lines = text.splitlines()
    if not lines or lines[0].strip() != "ply":
        raise Fault("it does not begin with ply")
    for line in lines[1:]:
        word, _, rest = line.strip().partition(" ")
        words = rest.split()
        try:
            if word == "format":
                form = words[0]
            elif word in ("comment", "obj_info"):
                comments.append(f"{word} {rest}")
            elif word == "element":
                elements.append(_Element(words[0], int(words[1])))
            elif word == "property" and words[0] == "list":
                elements[-1].properties.append(_Property(words[3], TYPES[words[2]], TYPES[words[1]]))
            elif word == "property":
                elements[-1].properties.append(_Property(words[1], TYPES[words[0]]))
        except (IndexError, KeyError, ValueError):
            raise Fault(f"its header has the line {line.strip()!r}") from None
    if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise Fault(f"its format is {form!r}")
    return form, comments, elements


def _truncated(element: _Element) -> Fault:
    return Fault(f"it announces {element.length} of its element {element.name}, and has fewer")


def _read_text(body: bytes, elements: list[_Element]) -> None:
    try:
        words = np.array(body.split(), "S").astype(np.float64) if body.strip() else np.zeros(0)
    except ValueError:
        raise Fault("its text holds words that are not numbers") from None
    at = 0
    for element in elements:
        n, properties = element.length, element.properties
        if not any(p.count for p in properties):
            if at + n * len(properties) > len(words):
                raise _truncated(element)
            table = words[at : at + n * len(properties)].reshape(n, -1)
            element.numbers = {p.name: table[:, k].astype(p.kind) for k, p in enumerate(properties)}
            at += table.size
            continue
        places: dict[str, list[int]] = {p.name: [] for p in properties}
        sizes: dict[str, list[int]] = {p.name: [] for p in properties}
        try:
            for _ in range(n):
                for p in properties:
                    count = 1
                    if p.count:
                        count = int(words[at])
                        at += 1
                    places[p.name].append(at)
                    sizes[p.name].append(count)
                    at += count
        except IndexError:
            raise _truncated(element) from None
        if at > len(words):
            raise _truncated(element)
        for p in properties:
            size = np.array(sizes[p.name], np.int64)
            items = words[_run(np.array(places[p.name], np.int64), size)].astype(p.kind)
            _put(element, p, size, items)


def _put(element: _Element, p: _Property, sizes: IntArray, items: npt.NDArray[Any]) -> None:
    if p.count:
        element.lists[p.name] = sizes, items
    else:
        element.numbers[p.name] = items


def _run(starts: IntArray, sizes: IntArray) -> IntArray:
    """Return starts[0], starts[0] + 1, ... starts[0] + sizes[0] - 1, starts[1], ..."""
    ends = np.cumsum(sizes)
    found: IntArray = np.arange(ends[-1] if len(ends) else 0) + np.repeat(starts - (ends - sizes), sizes)
    return found


def _read_binary(body: bytes, elements: list[_Element], order: str) -> None:
    at = 0
    for element in elements:
        at = _fixed(body, at, element, order) or _by_row(body, at, element, order)


def _fixed(body: bytes, at: int, element: _Element, order: str) -> int | None:
    """Read an element whose lists have the lengths of its first row; return its end, or None if they differ."""
    row: list[Any] = []
    place = at
    for k, p in enumerate(element.properties):
        if not p.count:
            row.append((str(k), order + p.kind))
            place += np.dtype(p.kind).itemsize
            continue
        count = np.dtype(order + p.count)
        if not element.length or place + count.itemsize > len(body):
            return None
        size = int(np.frombuffer(body, count, 1, place)[0])
        if not 0 <= size <= len(body) - place:
            return None
        row += [(f"n{k}", count), (str(k), order + p.kind, (size,))]
        place += count.itemsize + size * np.dtype(p.kind).itemsize
    kind = np.dtype(row)
    if at + kind.itemsize * element.length > len(body):
        if any(p.count for p in element.properties):
            return None
        raise _truncated(element)
    table = np.frombuffer(body, kind, element.length, at)
    if any(p.count and (table[f"n{k}"] != table[str(k)].shape[1]).any() for k, p in enumerate(element.properties)):
        return None
    for k, p in enumerate(element.properties):
        items = table[str(k)].astype(p.kind)
        sizes = np.full(element.length, items.shape[1] if p.count else 1)
        _put(element, p, sizes, items.reshape(-1))
    return at + kind.itemsize * element.length


def _by_row(body: bytes, at: int, element: _Element, order: str) -> int:
    """Read an element whose lists have different lengths; return its end."""
    data = np.frombuffer(body, np.uint8)
    spans = [(np.dtype(p.kind).itemsize, np.dtype(order + p.count) if p.count else None) for p in element.properties]
    places: list[list[int]] = [[] for _ in spans]
    sizes: list[list[int]] = [[] for _ in spans]
    for _ in range(element.length):
        for k, (width, count) in enumerate(spans):
            size = 1
            if count is not None:
                if at + count.itemsize > len(body):
                    raise _truncated(element)
                size = body[at] if count.itemsize == 1 else int(np.frombuffer(body, count, 1, at)[0])
                if size < 0:
                    raise Fault(f"a list of its element {element.name} has the length {size}")
                at += count.itemsize
            places[k].append(at)
            sizes[k].append(size)
            at += size * width
    if at > len(body):
        raise _truncated(element)
    for k, p in enumerate(element.properties):
        lengths, width = np.array(sizes[k], np.int64), spans[k][0]
        items = data[_run(np.array(places[k], np.int64), lengths * width)].view(order + p.kind).astype(p.kind)
        _put(element, p, lengths, items)
    return at


def _contents(elements: dict[str, _Element], comments: list[str]) -> Contents:
    vertex, face = elements.get("vertex"), elements.get("face")
    if face is None and "tristrips" in elements:
        raise Fault("its triangles are strips, which are not read: convert them to faces")
    others = (element for name, element in elements.items() if name not in ("vertex", "face"))
    lost = [f"the {element.length} rows of its element {element.name!r}" for element in others if element.length]
    if vertex is None or any(axis not in vertex.numbers for axis in "xyz"):
        raise Fault("it has no vertices with x, y and z")
    kind = vertex.numbers["x"].dtype
    points = vertex.take("x", "y", "z")
    corners = next((face.lists.pop(name) for name in _CORNERS if name in face.lists), None) if face else None
    sizes, items = corners or (np.zeros(0, np.int64), np.zeros(0, np.int64))
    assert points is not None
    found = Contents(
        points.astype(np.float64),
        sizes,
        items.astype(np.int64),
        np.dtype(np.float32 if kind == np.float32 else np.float64),
        comments=tuple(comments),
        told=Told(lost),
    )
    normals = vertex.take("nx", "ny", "nz")
    found.normals = None if normals is None else normals.astype(np.float64)
    places = next((uv for names in _PLACES if (uv := vertex.take(*names)) is not None), None)
    found.uv = None if places is None else places.astype(np.float64)
    if face is not None and "texcoord" in face.lists and (face.lists["texcoord"][0] == 2 * sizes).all():
        found.uv = face.lists.pop("texcoord")[1].reshape(-1, 2).astype(np.float64)
        found.uv_of = np.arange(len(found.uv))
    of_faces = None if face is None else face.take("nx", "ny", "nz")
    if of_faces is not None:
        found.of_faces["normals"] = of_faces
    for element, data in ((vertex, found.at_vertices), (face, found.of_faces)):
        if element is None:
            continue
        colours = _colours(element, lost)
        data |= element.numbers if colours is None else element.numbers | {"colours": colours}
        lost += [f"the lists {name!r} of its element {element.name}" for name in element.lists]
    _take_names(found)
    return found


def _take_names(found: Contents) -> None:
    """Take the names of materials, groups and objects, which :func:`gpureg.write_mesh` writes as comments."""
    rest, names, libraries = list[str](), dict[str, dict[int, str]](), list[str]()
    for line in found.comments:
        _, label, *more = [*line.split(" ", 3), "", "", ""][:4]
        if label == "mtllib":
            libraries.append(line.split(" ", 2)[2])
        elif label in _LABELS and label in found.of_faces and more[0].isdigit():
            names.setdefault(label, {})[int(more[0])] = more[1]
        else:
            rest.append(line)
    if all(sorted(known) == list(range(len(known))) for known in names.values()):
        found.names = {label: tuple(known[k] for k in sorted(known)) for label, known in names.items()}
        found.comments, found.libraries = tuple(rest), tuple(libraries)


def _colours(element: _Element, lost: list[str]) -> npt.NDArray[np.uint8] | None:
    """Take the colours of an element as bytes, (n, 3 or 4); numbers of 8 bits only, others stay numbers."""
    there = [name for name in CHANNELS if name in element.numbers]
    if there not in (list(CHANNELS), list(CHANNELS[:3])):
        return None
    if any(element.numbers[name].dtype != np.uint8 for name in there):
        return None
    return element.take(*there)
