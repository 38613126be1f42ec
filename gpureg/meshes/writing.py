"""Write mesh files: :func:`write_mesh`."""

from __future__ import annotations

import math
import os
import re
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..doors import door
from ..files.pictures import check_place, write_atomically
from ..shapes.surface import surface_of
from .reading import CHANNELS, check_format

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


@door
def write_mesh(path: str | os.PathLike[str], mesh: Any, *, dtype: npt.DTypeLike | None = None) -> None:
    """Write a triangle mesh in the format of the extension, completely or not at all.

    Parameters
    ----------
    path : path
        A name that ends in .ply, .obj, .off or .stl. An existing file is replaced when the new one is complete.
    mesh : trimesh.Trimesh, (vertices, faces), pyvista.PolyData or open3d.geometry.TriangleMesh
        Of a trimesh, PLY contains the colours and the numbers at vertices and faces, and OBJ the colours of vertices,
        the texture coordinates and the name of the material; of other meshes only vertices and faces are written.
    dtype : {float32, float64}, optional
        Type of the coordinates in a PLY file. None: float32 if that loses no digits, otherwise float64. STL has only
        float32; OBJ and OFF have 16 digits of the largest coordinate.

    Raises
    ------
    MeshError, PictureError
        An unknown extension; a folder that does not exist or is not writable; an error of the disk.
    TypeError, ValueError
        Not a triangle mesh.

    Examples
    --------
    >>> import os, tempfile
    >>> import gpureg as gr
    >>> tetrahedron = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0.1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     gr.write_mesh(os.path.join(folder, "a.ply"), tetrahedron)
    ...     found = gr.read_mesh(os.path.join(folder, "a.ply"))
    >>> found.faces.shape, found.dtype, float(found.vertices[3, 2])
    ((4, 3), dtype('float64'), 0.1)
    """
    encoded = encode_mesh(path, mesh, dtype)
    check_place(path)
    write_atomically(path, lambda temporary: temporary.write_bytes(encoded))


def encode_mesh(path: str | os.PathLike[str], mesh: Any, dtype: npt.DTypeLike | None = None) -> bytes:
    """Encode a mesh as :func:`write_mesh` writes it to a file of that name, with the same errors."""
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
    """Encode a binary PLY file; trimesh would convert coordinates to float32."""
    colours = getattr(mesh.visual, "kind", None)
    vertex = {axis: np.asarray(mesh.vertices[:, k], dtype) for k, axis in enumerate("xyz")}
    if colours == "texture" and np.shape(mesh.visual.uv) == (len(mesh.vertices), 2):
        vertex |= {"s": np.asarray(mesh.visual.uv[:, 0], np.float32), "t": np.asarray(mesh.visual.uv[:, 1], np.float32)}
    if colours == "vertex":
        vertex |= dict(zip(CHANNELS, mesh.visual.vertex_colors.T, strict=True))
    face = dict(zip(CHANNELS, mesh.visual.face_colors.T, strict=True)) if colours == "face" else {}
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
    """Return the attributes of one number per element, (count,) each, in types that PLY has."""
    found = {}
    for name, given in attributes.items():
        values = np.asarray(given)
        if values.shape == (count,) and values.dtype.kind in "biuf" and re.fullmatch(r"[!-~]+", name):
            fits = values.dtype.str[1:] in _PLY_TYPES
            found[name] = values if fits else values.astype(np.uint8 if values.dtype.kind == "b" else np.float64)
    return found
