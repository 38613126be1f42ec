"""Read mesh files, through trimesh: PLY, OBJ, OFF and STL."""

from __future__ import annotations

import io
import os
import re
import struct
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, IntArray
from ..doors import door
from ..files.pictures import PictureError
from ..shapes.surface import surface_of

FORMATS = {".ply": "PLY", ".obj": "OBJ", ".off": "OFF", ".stl": "STL"}

# Properties of a PLY vertex that trimesh reads itself: all others become attributes.
_KNOWN = {
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "red",
    "green",
    "blue",
    "alpha",
    "s",
    "t",
    "u",
    "v",
    "texture_u",
    "texture_v",
}

CHANNELS = ("red", "green", "blue", "alpha")


class MeshError(PictureError):
    """A mesh cannot be read or written; the message gives the file and the reason."""


@dataclass(frozen=True, eq=False)
class MeshFile:
    """The contents of a mesh file, from :func:`read_mesh`.

    Attributes
    ----------
    vertices : (n, 3) float64 array
    faces : (F, 3) int64 array
    mesh : trimesh.Trimesh
        The same mesh with the other data of the file: colours, texture coordinates, numbers at vertices and faces.
    dtype : numpy.dtype
        The type of the coordinates in the file: float32 or float64; float64 for text.
    """

    vertices: FloatArray
    faces: IntArray
    mesh: Any
    dtype: np.dtype[Any]


@door
def read_mesh(path: str | os.PathLike[str]) -> MeshFile:
    """Read a triangle mesh from a PLY, OBJ, OFF or STL file, with the vertices and faces in the order of the file.

    Polygons are cut into triangles. STL repeats each vertex once per face. Reading an OBJ with a texture changes the
    order, and repeats the vertices at the seams of the texture.

    Parameters
    ----------
    path : path

    Raises
    ------
    MeshError
        The file is missing, cannot be read, is truncated or has another format; it contains points without faces, or
        several meshes.
    """
    kind = check_format(path)
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise MeshError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise MeshError(f"{path} is a folder, not a mesh") from None
    except OSError as error:
        raise MeshError(f"{path} cannot be read: {error.strerror}") from None
    if not data.strip():
        raise MeshError(f"{path} is empty")
    fault = _FAULTS[kind](data)
    if fault:
        raise MeshError(f"{path} is damaged, truncated or no {kind} file: {fault}")
    mesh, dtype = _loaded(_plain_obj(data) if kind == "OBJ" else _utf8(data) if kind == "OFF" else data, kind, path)
    if kind == "OBJ":
        mesh.metadata["materials"] = [
            line.decode("utf-8", "replace").strip() for line in re.findall(rb"(?m)^(?:mtllib|usemtl)\b.*$", data)
        ]
    try:
        surface = surface_of(mesh)
    except (TypeError, ValueError) as error:
        raise MeshError(f"{path}: {error}") from None
    return MeshFile(surface.vertices, surface.faces.astype(np.int64), mesh, dtype)


def check_format(path: str | os.PathLike[str]) -> str:
    """Return the format of a mesh file by its extension; raise MeshError if it is unknown."""
    kind = FORMATS.get(Path(path).suffix.lower())
    if kind is None:
        raise MeshError(f"{path}: the extension of a mesh must be one of {', '.join(FORMATS)}")
    return kind


def _loaded(data: bytes, kind: str, path: str | os.PathLike[str]) -> tuple[Any, np.dtype[Any]]:
    """Load the only mesh in a file; return it and the type of its coordinates."""
    import trimesh

    # a vertex with two texture coordinates would lose one of them
    ordered = kind != "OBJ" or re.search(rb"(?m)^vt\b", data) is None
    try:
        with warnings.catch_warnings():
            # numpy's warning about text that is not a number
            warnings.filterwarnings("error", message=".*could not be read to its end.*")
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind.lower(), process=False, maintain_order=ordered)
    except MemoryError:
        raise
    except Exception as error:  # the parsers of trimesh raise many types of errors
        only = ", or its polygons differ in size, which is read from a PLY in text alone" if kind == "PLY" else ""
        raise MeshError(f"{path} is damaged, truncated or no {kind} file{only}") from error
    parts = list(scene.geometry.values())
    if len(parts) > 1:
        raise MeshError(f"{path} contains {len(parts)} meshes, by material; join them, or save each to a separate file")
    if not parts or not isinstance(parts[0], trimesh.Trimesh) or not len(parts[0].faces):
        raise MeshError(f"{path} has no face; gpureg mesh needs triangles, points alone are for gpureg points")
    mesh = parts[0]
    dtype = np.dtype(np.float32 if kind == "STL" else np.float64)
    elements = mesh.metadata.pop("_ply_raw", None)
    if elements is not None:
        for name, element in elements.items():
            if element["length"] and len(_column(element["data"])) < element["length"]:
                raise MeshError(f"{path} is truncated: it announces {element['length']} of its element {name}")
        dtype = np.dtype(np.float32 if "f4" in elements["vertex"]["properties"]["x"] else np.float64)
        _take_attributes(mesh, elements)
    return mesh, dtype


def _column(data: Any) -> Any:
    """Return the first property of a PLY element, as stored by trimesh."""
    return next(iter(data.values())) if isinstance(data, dict) else data


def _take_attributes(mesh: Any, elements: dict[str, Any]) -> None:
    """Add the numbers at vertices and faces of a PLY file that trimesh does not read as attributes of the mesh."""
    for element, attributes, count in (
        ("vertex", mesh.vertex_attributes, len(mesh.vertices)),
        ("face", mesh.face_attributes, len(mesh.faces)),
    ):
        found = elements.get(element)
        if found is None or found["length"] != count:
            continue
        for name, kind in found["properties"].items():
            if name not in _KNOWN and "," not in kind:
                values = np.array(found["data"][name]).reshape(-1)
                attributes[name] = values.astype(values.dtype.newbyteorder("="))


def _fault_of_ply(data: bytes) -> str:
    return "" if b"end_header" in data else "its header does not end"


def _fault_of_obj(data: bytes) -> str:
    short = re.search(rb"(?m)^f(?:[ \t]+\S+){0,2}[ \t]*\r?$", data)
    return f"it has a face with fewer than three corners, {_shown(short[0])}" if short else ""


def _fault_of_off(data: bytes) -> str:
    """Describe missing lines: trimesh accepts a truncated file."""
    start, _, rest = re.sub(rb"#.*", b"", data).partition(b"OFF")
    lines = [line.split() for line in rest.splitlines() if line.strip()]
    if start.strip(b"C \t\r\n") or not lines or not all(word.isdigit() for word in lines[0]) or len(lines[0]) < 2:
        return "it does not begin with OFF and the numbers of vertices and faces"
    n_vertices, n_faces = (int(word) for word in lines[0][:2])
    if len(lines) - 1 < n_vertices + n_faces:
        return f"it announces {n_vertices} vertices and {n_faces} faces, and has {len(lines) - 1} lines of them"
    last = lines[n_vertices + n_faces]
    whole = not n_faces or (last[0].isdigit() and len(last) > int(last[0]))
    return "" if whole else f"its last face is {_shown(b' '.join(last))}"


def _fault_of_stl(data: bytes) -> str:
    """Describe a wrong length: trimesh would then read the file as text."""
    if data.lstrip()[:5].lower() == b"solid" and b"\0" not in data:
        return "" if b"endsolid" in data.lower() else "its text does not end with endsolid"
    if len(data) < 84:
        return "it is shorter than a header"
    (count,) = struct.unpack("<I", data[80:84])
    there = (len(data) - 84) / 50
    return "" if there == count else f"it announces {count} triangles, and has bytes for {there:.6g}"


_FAULTS = {"PLY": _fault_of_ply, "OBJ": _fault_of_obj, "OFF": _fault_of_off, "STL": _fault_of_stl}


def _shown(line: bytes) -> str:
    return repr(line.decode("latin-1").strip())


def _utf8(data: bytes) -> bytes:
    """Encode text as UTF-8; its comments may be in another encoding."""
    try:
        data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1").encode()
    return data


def _plain_obj(data: bytes) -> bytes:
    """Remove the normals from an OBJ file: a vertex with two normals would be read as two vertices."""
    text = re.sub(rb"(?m)^vn\b.*$", b"", _utf8(data).replace(b"\r\n", b"\n"))
    # a corner is vertex/texture/normal; the texture may be missing
    text = re.sub(rb"(?<=\d)/(-?\d*)/-?\d+", rb"/\1", text)
    return re.sub(rb"(?<=\d)/(?=\s)", b"", text)
