"""Triangle meshes in and out of files, through trimesh: PLY, OBJ, OFF and STL."""

from __future__ import annotations

import io
import math
import os
import re
import struct
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, IntArray
from .files.pictures import PictureError, check_place, write_atomically
from .shapes.surface import surface_of

FORMATS = {".ply": "PLY", ".obj": "OBJ", ".off": "OFF", ".stl": "STL"}

# Properties of a PLY vertex that trimesh makes something of: all others are attributes.
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

_PLY_TYPES = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}
_CHANNELS = ("red", "green", "blue", "alpha")


class MeshError(PictureError):
    """A mesh that cannot be read or written; the message says which and why."""


@dataclass(frozen=True, eq=False)
class MeshFile:
    """What :func:`read_mesh` found in a file.

    Attributes
    ----------
    vertices : (n, 3) float64 array
    faces : (F, 3) int64 array
    mesh : trimesh.Trimesh
        The same, with what else is in the file: colours, coordinates of textures, numbers at vertices and faces.
    dtype : numpy.dtype
        The type of the coordinates in the file: float32 or float64; float64 for text.
    """

    vertices: FloatArray
    faces: IntArray
    mesh: Any
    dtype: np.dtype[Any]


def read_mesh(path: str | os.PathLike[str]) -> MeshFile:
    """Read a triangle mesh from a PLY, OBJ, OFF or STL file, its vertices and faces in the order of the file.

    Polygons are cut into triangles. STL has each vertex as often as faces meet there. An OBJ with a texture is put into
    another order, and vertices at the texture's seams are repeated.

    Parameters
    ----------
    path : path

    Raises
    ------
    MeshError
        A file that is missing, may not be read, is truncated or none of these kinds; that holds points without faces,
        or several meshes.
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
    """The format that the extension of a mesh's file names.

    Raises
    ------
    MeshError
        An unknown extension.
    """
    kind = FORMATS.get(Path(path).suffix.lower())
    if kind is None:
        raise MeshError(f"{path}: the extension of a mesh must be one of {', '.join(FORMATS)}")
    return kind


def _loaded(data: bytes, kind: str, path: str | os.PathLike[str]) -> tuple[Any, np.dtype[Any]]:
    """The one mesh in a file, and the type of its coordinates."""
    import trimesh

    # a vertex with two places in a texture would lose one of them
    ordered = kind != "OBJ" or re.search(rb"(?m)^vt\b", data) is None
    try:
        with warnings.catch_warnings():
            # how numpy says that text is no numbers
            warnings.filterwarnings("error", message=".*could not be read to its end.*")
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind.lower(), process=False, maintain_order=ordered)
    except MemoryError:
        raise
    except Exception as error:  # its parsers raise whatever they stumble over
        only = ", or its polygons differ in size, which is read from a PLY in text alone" if kind == "PLY" else ""
        raise MeshError(f"{path} is damaged, truncated or no {kind} file{only}") from error
    parts = list(scene.geometry.values())
    if len(parts) > 1:
        raise MeshError(f"{path} holds {len(parts)} meshes, by material; join them, or write each to a file of its own")
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
    """The first property of a PLY element, as trimesh keeps them."""
    return next(iter(data.values())) if isinstance(data, dict) else data


def _take_attributes(mesh: Any, elements: dict[str, Any]) -> None:
    """Give the mesh, as attributes, the numbers at vertices and faces of a PLY file that trimesh does not know."""
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
    """Lines that are missing, of which trimesh takes as many as there are."""
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
    """A length that is not the one announced, for which trimesh would go on to read it as text."""
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
    """Text whose comments may be in another encoding."""
    try:
        data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1").encode()
    return data


def _plain_obj(data: bytes) -> bytes:
    """An OBJ file without normals.

    A vertex with two normals would be read as two: they would tear at creases, and the order would be lost.
    """
    text = re.sub(rb"(?m)^vn\b.*$", b"", _utf8(data).replace(b"\r\n", b"\n"))
    # a corner is vertex/texture/normal, of which the texture may be missing
    text = re.sub(rb"(?<=\d)/(-?\d*)/-?\d+", rb"/\1", text)
    return re.sub(rb"(?<=\d)/(?=\s)", b"", text)


def write_mesh(path: str | os.PathLike[str], mesh: Any, *, dtype: npt.DTypeLike | None = None) -> None:
    """Write a triangle mesh in the format that the extension names, whole or not at all.

    Parameters
    ----------
    path : path
        One that ends in .ply, .obj, .off or .stl. A file that is there is replaced when the new one is complete.
    mesh : trimesh.Trimesh, (vertices, faces), pyvista.PolyData or open3d.geometry.TriangleMesh
        Of a trimesh, PLY keeps the colours and the numbers at vertices and faces, OBJ the colours of vertices, the
        coordinates of textures and the name of the material; of others the vertices and faces are written.
    dtype : {float32, float64}, optional
        Type of the coordinates in a PLY file. None: float32 where that loses no digit, otherwise float64. STL has
        float32 only; OBJ and OFF get 16 digits of the largest coordinate.

    Raises
    ------
    MeshError, PictureError
        An unknown extension, a folder that does not exist or may not be written, a disk that refuses.
    TypeError, ValueError
        What is no mesh of triangles.

    Examples
    --------
    >>> import os, tempfile
    >>> from gpureg.mesh_io import read_mesh, write_mesh
    >>> tetrahedron = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0.1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_mesh(os.path.join(folder, "a.ply"), tetrahedron)
    ...     found = read_mesh(os.path.join(folder, "a.ply"))
    >>> found.faces.shape, found.dtype, float(found.vertices[3, 2])
    ((4, 3), dtype('float64'), 0.1)
    """
    encoded = encode_mesh(path, mesh, dtype)
    check_place(path)
    write_atomically(path, lambda temporary: temporary.write_bytes(encoded))


def encode_mesh(path: str | os.PathLike[str], mesh: Any, dtype: npt.DTypeLike | None = None) -> bytes:
    """What :func:`write_mesh` writes to a file of that name.

    Raises
    ------
    MeshError, TypeError, ValueError
        As :func:`write_mesh`, but for the disk.
    """
    kind = check_format(path)
    surface = surface_of(mesh)
    whole = mesh if hasattr(mesh, "visual") else _bare(surface.vertices, surface.faces)
    if dtype is None:
        narrow = surface.vertices.astype(np.float32)
        dtype = np.float32 if np.array_equal(narrow, surface.vertices) else np.float64
    if np.dtype(dtype) not in (np.float32, np.float64):
        raise ValueError(f"dtype must be float32 or float64, got {np.dtype(dtype)}")
    return _encoded(kind, whole, np.dtype(dtype))


def _bare(vertices: FloatArray, faces: IntArray) -> Any:
    import trimesh

    return trimesh.Trimesh(vertices=vertices, faces=faces, process=False)


def _encoded(kind: str, mesh: Any, dtype: np.dtype[Any]) -> bytes:
    if kind == "PLY":
        return _ply(mesh, dtype)
    from trimesh.exchange import obj, off, stl

    if kind == "STL":
        return bytes(stl.export_stl(mesh))
    largest = float(np.abs(mesh.vertices).max())
    digits = max(0, 15 - math.floor(math.log10(largest))) if largest > 0 else 0
    if kind == "OFF":
        return str(off.export_off(mesh, digits=digits)).encode()
    text = str(obj.export_obj(mesh, include_normals=False, digits=digits, header=None))
    lines = [line for line in text.splitlines() if not line.startswith(("mtllib", "usemtl"))]
    return "\n".join([*mesh.metadata.get("materials", []), *lines, ""]).encode()


def _ply(mesh: Any, dtype: np.dtype[Any]) -> bytes:
    """A binary PLY file; trimesh would narrow coordinates to float32."""
    colours = getattr(mesh.visual, "kind", None)
    vertex = {axis: np.asarray(mesh.vertices[:, k], dtype) for k, axis in enumerate("xyz")}
    if colours == "texture" and np.shape(mesh.visual.uv) == (len(mesh.vertices), 2):
        vertex |= {"s": np.asarray(mesh.visual.uv[:, 0], np.float32), "t": np.asarray(mesh.visual.uv[:, 1], np.float32)}
    if colours == "vertex":
        vertex |= dict(zip(_CHANNELS, mesh.visual.vertex_colors.T, strict=True))
    face = dict(zip(_CHANNELS, mesh.visual.face_colors.T, strict=True)) if colours == "face" else {}
    vertex |= _numbers(mesh.vertex_attributes, len(mesh.vertices))
    face |= _numbers(mesh.face_attributes, len(mesh.faces))
    corners = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
    rows = np.empty(len(mesh.faces), corners.descr + [(name, f"<{x.dtype.str[1:]}") for name, x in face.items()])
    rows["count"], rows["corners"] = 3, mesh.faces
    points = np.empty(len(mesh.vertices), [(name, f"<{x.dtype.str[1:]}") for name, x in vertex.items()])
    for table, columns in ((points, vertex), (rows, face)):
        for name, values in columns.items():
            table[name] = values
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *_properties(vertex)]
    header += [
        f"element face {len(rows)}",
        "property list uchar int vertex_indices",
        *_properties(face),
        "end_header\n",
    ]
    return "\n".join(header).encode() + points.tobytes() + rows.tobytes()


def _properties(columns: dict[str, npt.NDArray[Any]]) -> list[str]:
    return [f"property {_PLY_TYPES[values.dtype.str[1:]]} {name}" for name, values in columns.items()]


def _numbers(attributes: Any, count: int) -> dict[str, npt.NDArray[Any]]:
    """The attributes that are a number each, in types that PLY has."""
    found = {}
    for name, given in attributes.items():
        values = np.asarray(given)
        if values.shape == (count,) and values.dtype.kind in "biuf" and re.fullmatch(r"[!-~]+", name):
            fits = values.dtype.str[1:] in _PLY_TYPES
            found[name] = values if fits else values.astype(np.uint8 if values.dtype.kind == "b" else np.float64)
    return found
