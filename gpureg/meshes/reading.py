"""Read mesh files: :func:`read_mesh`."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, IntArray
from ..doors import door, outside
from ..files.pictures import PictureError
from ..shapes.surface import taken_apart
from .beside import Told
from .contents import Fault
from .obj import parse_obj
from .off import parse_off
from .ply import parse_ply
from .scenes import parse_scene
from .stl import parse_stl
from .threemf import parse_3mf

__all__ = ["FORMATS", "MeshError", "MeshFile", "check_format", "load_mesh", "read_mesh"]

FORMATS = {
    ".ply": "PLY",
    ".obj": "OBJ",
    ".off": "OFF",
    ".stl": "STL",
    ".glb": "GLB",
    ".gltf": "GLTF",
    ".3mf": "3MF",
}

_PARSERS = {"PLY": parse_ply, "OBJ": parse_obj, "OFF": parse_off, "STL": parse_stl, "3MF": parse_3mf}


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
        The same mesh with the other data of the file: colours, texture coordinates, numbers at vertices and faces, and
        what :func:`write_mesh` needs for a file of the same kind: polygons, normals, materials, groups, comments.
    dtype : numpy.dtype
        The type of the coordinates in the file: float32 or float64; float64 for text.
    told : Told
        What was not read, and what was changed.
    """

    vertices: FloatArray
    faces: IntArray
    mesh: Any
    dtype: np.dtype[Any]
    told: Told = field(default_factory=Told)


@door
def read_mesh(path: str | os.PathLike[str]) -> MeshFile:
    """Read a mesh from a PLY, OBJ, OFF, STL, GLB, glTF or 3MF file, with the vertices and faces in its order.

    Polygons are cut into triangles; :func:`write_mesh` writes them as polygons again. Corners at the same point in an
    STL are one vertex. A vertex with several places in a texture is repeated, after all others. Several objects of
    a GLB, glTF or 3MF are one mesh, moved to their positions, with the number of the object at each face.

    Parameters
    ----------
    path : path

    Raises
    ------
    MeshError
        The file is missing, cannot be read, is truncated or has another format; it contains points without faces.

    Warns
    -----
    UserWarning
        Names what was not read.
    """
    found = load_mesh(path)
    for line in found.told.lines("not read:"):
        warnings.warn(f"{path}: {line}", stacklevel=outside())
    return found


def load_mesh(path: str | os.PathLike[str]) -> MeshFile:
    """Read a mesh as :func:`read_mesh`, without warnings."""
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
    try:
        contents = _PARSERS[kind](data) if kind in _PARSERS else parse_scene(data, kind, path)
        mesh = contents.assembled() if len(contents.sizes) else None
    except MemoryError:
        raise
    except Fault as fault:
        raise MeshError(f"{path} is damaged, truncated or no {kind} file: {fault}") from None
    except Exception as error:  # the parsers of trimesh raise many types of errors
        raise MeshError(f"{path} is damaged, truncated or no {kind} file") from error
    if mesh is None or not len(mesh.faces):
        raise MeshError(f"{path} has no face; gpureg mesh needs triangles, points alone are for gpureg points")
    try:
        surface = taken_apart(mesh)
    except (TypeError, ValueError) as error:
        raise MeshError(f"{path}: {error}") from None
    vertices = np.asarray(mesh.vertices, np.float64)
    return MeshFile(vertices, surface.faces.astype(np.int64), mesh, contents.dtype, contents.told)


def check_format(path: str | os.PathLike[str]) -> str:
    """Return the format of a mesh file by its extension; raise MeshError if it is unknown."""
    kind = FORMATS.get(Path(path).suffix.lower())
    if kind is None:
        raise MeshError(f"{path}: the extension of a mesh must be one of {', '.join(FORMATS)}")
    return kind
