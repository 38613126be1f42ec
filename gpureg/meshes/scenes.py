"""The formats GLB and glTF, through trimesh: objects with positions, textures and materials."""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import logging
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from .beside import Told
from .contents import Contents, Fault
from .outgoing import MADE

# Parts of a glTF document that a mesh has no place for.
_OTHER = {"animations": "animations", "skins": "skins", "cameras": "cameras"}


def parse_scene(data: bytes, kind: str, path: str | os.PathLike[str]) -> Contents:
    """Parse a GLB or glTF file, join its objects to one mesh, and move them to their places."""
    import trimesh

    document = _document(data, kind)
    beside = Path(path).absolute().parent
    missing = {key: _missing(document.get(key), beside) for key in ("buffers", "images")}
    if missing["buffers"]:
        raise Fault(f"{missing['buffers'][0]}, which holds its numbers, is not beside it")
    resolver = trimesh.resolvers.FilePathResolver(str(Path(path).absolute()))
    try:
        with _unlogged():
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind.lower(), resolver=resolver, process=False)
    except Exception as error:
        required = document.get("extensionsRequired")
        if required and not isinstance(error, MemoryError):
            raise Fault(f"it needs {', '.join(map(str, required))}, which cannot be read") from error
        raise
    parts = []
    told = Told([f"{len(document[key])} {word}" for key, word in _OTHER.items() if document.get(key)])
    told.lost += [f"the picture {name}, which is not beside it" for name in missing["images"]]
    for node in sorted(scene.graph.nodes_geometry, key=str):
        transform, name = scene.graph[node]
        mesh = scene.geometry[name]
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            parts.append((str(node), str(name), mesh, np.asarray(transform, float)))
        else:
            told.lost.append(f"the object {node!r}, which has no faces")
    if not parts:
        return Contents(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64))
    if len(parts) > 1:
        told.notes.append(f"its {len(parts)} objects are one mesh, and their names are labels of faces")
    if any(not np.array_equal(transform, np.eye(4)) for *_, transform in parts):
        told.notes.append("the positions of its objects are part of the coordinates now")
    return joined(parts, told)


def _missing(entries: Any, folder: Path) -> list[str]:
    """List the files that entries of a document name, and that are not in the folder."""
    names = [unquote(entry["uri"]) for entry in entries or () if isinstance(entry, dict) and "uri" in entry]
    return [name for name in names if not name.startswith("data:") and not (folder / name).exists()]


@contextlib.contextmanager
def _unlogged() -> Iterator[None]:
    """Keep trimesh from writing tracebacks to standard error."""
    logger = logging.getLogger("trimesh")
    before = logger.disabled
    logger.disabled = True
    try:
        yield
    finally:
        logger.disabled = before


def _document(data: bytes, kind: str) -> dict[str, Any]:
    """Return the JSON of a file."""
    try:
        if kind == "GLTF":
            found = json.loads(data)
        else:
            if data[:4] != b"glTF" or struct.unpack("<I", data[8:12])[0] > len(data):
                raise Fault("its header is not that of a GLB, or it is shorter than announced")
            (length,) = struct.unpack("<I", data[12:16])
            found = json.loads(data[20 : 20 + length])
    except (ValueError, struct.error) as error:
        raise error if isinstance(error, Fault) else Fault("its document is not JSON") from None
    if not isinstance(found, dict):
        raise Fault("its document is not an object")
    return found


def joined(parts: list[tuple[str, str, Any, FloatArray]], told: Told) -> Contents:
    """Join meshes of trimesh: the name of the object and of the mesh, the mesh, and its transform (4, 4)."""
    meshes = [_moved(mesh, transform) for *_, mesh, transform in parts]
    begin = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.concatenate([np.asarray(mesh.faces) + at for mesh, at in zip(meshes, begin, strict=False)])
    found = Contents(
        np.concatenate([np.asarray(mesh.vertices) for mesh in meshes]),
        np.full(len(faces), 3),
        faces.astype(np.int64).ravel(),
        np.dtype(np.float32),
        told=told,
    )
    counts, of_faces = np.diff(begin), [len(mesh.faces) for mesh in meshes]
    names = [node for node, *_ in parts]
    found.of_faces["object"] = np.repeat(np.arange(len(parts), dtype=np.int32), of_faces)
    found.names["object"] = tuple(names)
    textures = [getattr(mesh.visual, "kind", None) == "texture" for mesh in meshes]
    if any(textures):
        _take_materials(found, meshes, textures, of_faces, counts)
    colours = [_colours(mesh) for mesh in meshes]
    if any(c is not None for c in colours):
        white = [np.full((n, 4), 255, np.uint8) if c is None else c for c, n in zip(colours, counts, strict=True)]
        found.at_vertices["colours"] = np.concatenate(white)
    if all("vertex_normals" in mesh._cache for mesh in meshes):
        found.normals = np.concatenate([np.asarray(mesh.vertex_normals) for mesh in meshes])
    _take_attributes(found, meshes, counts)
    extra = {key for mesh in meshes for key in mesh.metadata if key not in MADE}
    if extra:
        told.lost.append(f"the metadata {', '.join(sorted(map(str, extra)))}")
    return found


def _moved(mesh: Any, transform: FloatArray) -> Any:
    made = mesh.copy(include_cache=True)
    return made if np.array_equal(transform, np.eye(4)) else made.apply_transform(transform)


def _take_materials(found: Contents, meshes: list[Any], textures: list[bool], of_faces: Any, counts: Any) -> None:
    uv = [getattr(mesh.visual, "uv", None) for mesh in meshes]
    if any(x is not None for x in uv):
        found.uv = np.concatenate([np.zeros((n, 2)) if x is None else x for x, n in zip(uv, counts, strict=True)])
    materials = [mesh.visual.material if has else None for mesh, has in zip(meshes, textures, strict=True)]
    kinds: list[Any] = []
    numbers = []
    for material in materials:
        same = next((k for k, known in enumerate(kinds) if hash(known) == hash(material)), len(kinds))
        numbers.append(same)
        kinds += [material] if same == len(kinds) else []
    found.materials = tuple(kinds)
    found.of_faces["material"] = np.repeat(np.array(numbers, np.int32), of_faces)
    found.names["material"] = tuple(str(getattr(x, "name", None) or f"material {k}") for k, x in enumerate(kinds))


def _colours(mesh: Any) -> npt.NDArray[np.uint8] | None:
    visual = mesh.visual
    if getattr(visual, "kind", None) in ("vertex", "face"):
        return np.asarray(visual.vertex_colors, np.uint8)
    given = getattr(visual, "vertex_attributes", {}).get("color")
    return None if given is None or np.shape(given) != (len(mesh.vertices), 4) else np.asarray(given, np.uint8)


def _take_attributes(found: Contents, meshes: list[Any], counts: IntArray) -> None:
    """Take numbers at vertices, which begin with an underscore in these files; NaN where an object has none."""
    for key in dict.fromkeys(key for mesh in meshes for key in mesh.vertex_attributes):
        arrays = [np.asarray(mesh.vertex_attributes[key]) if key in mesh.vertex_attributes else None for mesh in meshes]
        shapes = {x.shape[1:] for x in arrays if x is not None}
        if len(shapes) > 1:
            found.told.lost.append(f"the numbers {key!r}, which differ in kind")
            continue
        shape = shapes.pop()
        filled = [np.full((n, *shape), np.nan) if x is None else x for x, n in zip(arrays, counts, strict=True)]
        found.at_vertices[str(key).removeprefix("_")] = np.concatenate(filled)


def encode_scene(contents: Contents, kind: str, told: Told) -> bytes:
    """Encode triangles as a GLB or glTF file, one object for each object and material."""
    import trimesh
    from trimesh.exchange import gltf

    corners = contents.corners.reshape(-1, 3)
    n = len(contents.vertices)
    object_of, material_of = (
        contents.of_faces.pop(label, np.zeros(len(corners), np.int64)) for label in ("object", "material")
    )
    told.lost += [f"the data {name!r} of faces" for name in contents.of_faces if name != "colours"]
    colours = contents.at_vertices.pop("colours", None)
    of_faces = contents.of_faces.pop("colours", None)
    if colours is not None and contents.uv is not None:
        told.lost.append("the colours at vertices, beside a texture")
    numbers = {}
    for name, values in contents.at_vertices.items():
        if values.dtype.kind in "biuf" and values.ndim <= 2:
            numbers[name] = values.astype(np.float32)
            if not np.array_equal(numbers[name], values, equal_nan=values.dtype.kind == "f"):
                told.lost.append(f"digits of the numbers {name!r}, which are float32")
        else:
            told.lost.append(f"the data {name!r} at vertices")
    scene = trimesh.Scene()
    pairs = np.stack([object_of, material_of], axis=1)
    for number, material in np.unique(pairs, axis=0).tolist():
        part = (pairs == [number, material]).all(axis=1)
        used = np.arange(n) if part.all() else np.unique(corners[part])
        local = np.searchsorted(used, corners[part])
        names = contents.names.get("object", ())
        name = whole = names[number] if 0 <= number < len(names) else "mesh"
        for k in itertools.count(1):
            if name not in scene.geometry:
                break
            name = f"{whole}_{k}"
        more: dict[str, Any] = {}
        if colours is not None and contents.uv is None:
            more["vertex_colors"] = colours[used]
        elif of_faces is not None and contents.uv is None:
            more["face_colors"] = of_faces[part]
        mesh = trimesh.Trimesh(contents.vertices[used], local, process=False, **more)
        known = contents.materials[material] if 0 <= material < len(contents.materials) else None
        words = contents.names.get("material", ())
        if known is None and 0 <= material < len(words):
            known = trimesh.visual.material.PBRMaterial(name=words[material])
        if contents.uv is not None or known is not None:
            uv = None if contents.uv is None else contents.uv[used]
            mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=known)
        if contents.normals is not None:
            mesh.vertex_normals = contents.normals[used]
        mesh.vertex_attributes.update({f"_{key.removeprefix('_')}": x[used] for key, x in numbers.items()})
        scene.add_geometry(mesh, node_name=name, geom_name=name)
    include = contents.normals is not None
    if kind == "GLB":
        return bytes(gltf.export_glb(scene, include_normals=include))
    return bytes(gltf.export_gltf(scene, include_normals=include, embed_buffers=True)["model.gltf"])
