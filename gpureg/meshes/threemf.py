"""The 3MF format: objects with names and positions, in a zip archive."""

from __future__ import annotations

import io
import zipfile
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np

from ..arrays import FloatArray, IntArray
from .beside import Told
from .contents import Contents, Fault

_SPACE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_MODEL = "3D/3dmodel.model"
_START = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
_TYPES = (
    _HEAD + '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)
_RELATIONS = (
    _HEAD + '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    f'<Relationship Target="/{_MODEL}" Id="rel0" Type="{_START}"/></Relationships>'
)

# One object: its name, vertices (n, 3) and triangles (F, 3).
_Part = tuple[str, FloatArray, IntArray]


def parse_3mf(data: bytes) -> Contents:
    """Parse a 3MF file, join its objects to one mesh, and move them to their places."""
    models: dict[str, Any] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for name in archive.namelist():
                if name.lower().endswith(".model"):
                    models[name.strip("/").lower()] = _without_spaces(ElementTree.fromstring(archive.read(name)))
            other = [n for n in archive.namelist() if n.lower().endswith((".png", ".jpg", ".jpeg", ".texture"))]
    except (zipfile.BadZipFile, ElementTree.ParseError, EOFError, OSError) as error:
        raise Fault(f"it is no archive of models: {error}") from None
    main = models.get(_MODEL.lower()) or next(iter(models.values()), None)
    if main is None:
        raise Fault("it holds no model")
    told = Told([f"{len(other)} pictures"] if other else [])
    try:
        objects = {(path, one.get("id")): one for path, model in models.items() for one in model.iter("object")}
        path = next(path for path, model in models.items() if model is main)
        parts: list[_Part] = []
        items = list(main.iter("item"))
        moved = any(item.get("transform") for item in [*items, *main.iter("component")])
        for item in items:
            _collect(objects, _path(item, path), item.get("objectid"), _matrix(item), parts, 0)
        if not items:
            for key in [key for key in objects if key[0] == path]:
                _collect(objects, *key, np.eye(4), parts, 0)
    except (KeyError, TypeError, ValueError) as error:
        raise Fault(f"an object lacks data: {error}") from None
    if not parts:
        return Contents(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64))
    if any(one.get("pid") for model in models.values() for one in model.iter() if one.tag in ("object", "triangle")):
        told.lost.append("the colours and materials")
    if len(parts) > 1:
        told.notes.append(f"its {len(parts)} objects are one mesh, and their names are labels of faces")
    if moved:
        told.notes.append("the positions of its objects are part of the coordinates now")
    begin = np.cumsum([0, *(len(v) for _, v, _ in parts)])
    faces = np.concatenate([f + at for (_, _, f), at in zip(parts, begin, strict=False)])
    texts = [(one.get("name"), (one.text or "").strip()) for one in main.iter("metadata")]
    found = Contents(
        np.concatenate([v for _, v, _ in parts]),
        np.full(len(faces), 3),
        faces.ravel(),
        comments=tuple(f"{name}: {text}" for name, text in texts if text),
        units=main.get("unit", "millimeter"),
        told=told,
    )
    found.of_faces["object"] = np.repeat(np.arange(len(parts), dtype=np.int32), [len(f) for *_, f in parts])
    found.names["object"] = tuple(name for name, *_ in parts)
    return found


def _without_spaces(root: Any) -> Any:
    for one in root.iter():
        one.tag = one.tag.rpartition("}")[2]
    return root


def _path(one: Any, path: str) -> str:
    """Return the model that a component or item is in: its attribute path, in any namespace."""
    other = next((value for key, value in one.attrib.items() if key.rpartition("}")[2] == "path"), None)
    return path if other is None else str(other).strip("/").lower()


def _matrix(one: Any) -> FloatArray:
    """Return the transform (4, 4) of an item, for columns."""
    found = np.eye(4)
    if one.get("transform"):
        found[:3] = np.array(one.get("transform").split(), float).reshape(4, 3).T
    return found


def _collect(objects: Any, path: str, number: Any, transform: FloatArray, parts: list[_Part], depth: int) -> None:
    """Add the meshes of an object and of its components, moved, to `parts`."""
    if depth > 50:
        raise ValueError("its objects contain each other")
    one = objects[path, number]
    for mesh in one.iter("mesh"):
        v = np.array([[x.get(axis) for axis in "xyz"] for x in mesh.iter("vertex")], float).reshape(-1, 3)
        f = np.array([[x.get(k) for k in ("v1", "v2", "v3")] for x in mesh.iter("triangle")], np.int64).reshape(-1, 3)
        if f.size and not 0 <= f.min() <= f.max() < len(v):
            raise ValueError(f"faces must name vertices 0..{len(v) - 1}")
        if not np.array_equal(transform, np.eye(4)):
            v = v @ transform[:3, :3].T + transform[:3, 3]
            f = f[:, ::-1] if np.linalg.det(transform[:3, :3]) < 0 else f
        parts.append((one.get("name") or f"object {number}", v, f))
    for part in one.iter("component"):
        _collect(objects, _path(part, path), part.get("objectid"), transform @ _matrix(part), parts, depth + 1)


def encode_3mf(contents: Contents) -> bytes:
    """Encode triangles as a 3MF file, one object for each label of the faces."""
    corners, vertices = contents.corners.reshape(-1, 3), contents.vertices
    label = contents.of_faces.get("object", np.zeros(len(corners), np.int64))
    names = contents.names.get("object", ("mesh",))
    lines = [_HEAD, f'<model unit={quoteattr(contents.units or "millimeter")} xmlns="{_SPACE}">']
    lines += [f'<metadata name="Description">{_escaped(" | ".join(contents.comments))}</metadata>'] * bool(
        contents.comments
    )
    lines.append("<resources>")
    found = np.unique(label).tolist()
    for number, k in enumerate(found, start=1):
        used = np.unique(corners[label == k]) if len(found) > 1 else np.arange(len(vertices))
        local = np.searchsorted(used, corners[label == k])
        name = names[k] if 0 <= k < len(names) else f"object {k}"
        lines.append(f'<object id="{number}" type="model" name={quoteattr(name)}><mesh><vertices>')
        lines += [f'<vertex x="{x!r}" y="{y!r}" z="{z!r}"/>' for x, y, z in vertices[used].tolist()]
        lines.append("</vertices><triangles>")
        lines += [f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in local.tolist()]
        lines.append("</triangles></mesh></object>")
    lines += ["</resources><build>", *(f'<item objectid="{k + 1}"/>' for k in range(len(found))), "</build></model>"]
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in (("[Content_Types].xml", _TYPES), ("_rels/.rels", _RELATIONS), (_MODEL, "\n".join(lines))):
            # the same date always, so that equal meshes give equal files
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), text, zipfile.ZIP_DEFLATED)
    return out.getvalue()


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
