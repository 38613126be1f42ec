"""Write mesh files: :func:`write_mesh`."""

from __future__ import annotations

import os
import re
import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..doors import door, outside
from ..files.pictures import check_place, write_atomically
from ..graphs.of_shapes import face_edges
from ..shapes.surface import Surface, taken_apart
from .beside import Told
from .contents import CHANNELS, Contents
from .obj import encode_obj
from .off import encode_off
from .outgoing import channels_of, contents_of, in_triangles, normals_at_vertices, split_at_seams
from .ply_writing import WRITTEN, encode_ply
from .reading import check_format
from .scenes import encode_scene
from .stl import encode_stl
from .threemf import encode_3mf

# Formats whose coordinates are float32.
_NARROW = ("STL", "GLB", "GLTF")

# Rounding to float32 is worth a note above this share of the change, or of the mean edge.
_LOSS = 0.01


@door
def write_mesh(path: str | os.PathLike[str], mesh: Any, *, dtype: npt.DTypeLike | None = None) -> None:
    """Write a mesh in the format of the extension, completely or not at all.

    Parameters
    ----------
    path : path
        A name that ends in .ply, .obj, .off, .stl, .glb, .gltf or .3mf. An existing file is replaced when the new one
        is complete.
    mesh : trimesh.Trimesh, (vertices, faces), pyvista.PolyData or open3d.geometry.TriangleMesh
        The mesh of :func:`read_mesh`, also after :func:`denoise_mesh`, is written with its polygons, normals,
        materials, groups and comments, as far as the format has them.
    dtype : {float32, float64}, optional
        Type of the coordinates in a PLY file. None: float32 if that loses no digits, otherwise float64. STL, GLB and
        glTF have only float32; OBJ and OFF have 16 digits of the largest coordinate, 3MF has all.

    Raises
    ------
    MeshError, PictureError
        An unknown extension; a folder that does not exist or is not writable; an error of the disk.
    TypeError, ValueError
        Not a triangle mesh.

    Warns
    -----
    UserWarning
        Names the data that the format has no place for, and says what rounding to float32 loses if that is above one
        percent of the mean edge.

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
    told = Told()
    encoded = encode_mesh(path, mesh, dtype, told=told)
    check_place(path)
    write_atomically(path, lambda temporary: temporary.write_bytes(encoded))
    for line in told.lines(f"{check_format(path)} has no place for"):
        warnings.warn(f"{path}: {line}", stacklevel=outside())


def encode_mesh(
    path: str | os.PathLike[str],
    mesh: Any,
    dtype: npt.DTypeLike | None = None,
    *,
    told: Told | None = None,
    change: float | None = None,
) -> bytes:
    """Encode a mesh as :func:`write_mesh` writes it to a file of that name, with the same errors.

    Parameters
    ----------
    path, mesh, dtype
        As for :func:`write_mesh`.
    told : Told, optional
        Takes what the format has no place for.
    change : float, optional
        Root mean square displacement of the vertices by the work, to compare the loss of digits with.
    """
    kind = check_format(path)
    told = Told() if told is None else told
    surface = taken_apart(mesh)
    contents = contents_of(mesh, surface, told)
    narrow = np.array_equal(contents.vertices.astype(np.float32), contents.vertices, equal_nan=True)
    if dtype is None:
        dtype = np.float32 if narrow else np.float64
    if np.dtype(dtype) not in (np.float32, np.float64):
        raise ValueError(f"dtype must be float32 or float64, got {np.dtype(dtype)}")
    if not narrow and (kind in _NARROW or (kind == "PLY" and np.dtype(dtype) == np.float32)):
        told.notes += loss_of_digits(surface, f"{kind} holds" if kind in _NARROW else "the file holds", change)
    return bytes(_ENCODERS[kind](contents, np.dtype(dtype), told))


def loss_of_digits(surface: Surface, holder: str, change: float | None) -> list[str]:
    """Say what rounding the coordinates to float32 loses, if it is not small beside the change or the mean edge."""
    v = surface.vertices[np.unique(surface.faces)]
    loss = np.linalg.norm(v.astype(np.float32) - v, axis=1)
    rms = float(np.sqrt(np.mean(loss**2)))
    edges = face_edges(surface.faces)
    edge = float(np.linalg.norm(surface.vertices[edges[:, 0]] - surface.vertices[edges[:, 1]], axis=1).mean())
    shares = [(rms / x, words) for x, words in ((change, "what was changed"), (edge, "the mean edge")) if x]
    told = [
        f"{share:.2g} times {words}" if share > 1 else f"{100 * share:.2g} % of {words}"
        for share, words in shares
        if share > _LOSS
    ]
    if not told:
        return []
    largest = float(np.abs(v).max())
    return [
        f"{holder} float32, which moves vertices by up to {loss.max():.2g} at coordinates of {largest:.3g}, "
        f"{' and '.join(told)}: write PLY as float64, or subtract an offset first"
    ]


def _ply(found: Contents, dtype: np.dtype[Any], told: Told) -> bytes:
    columns: dict[str, npt.NDArray[Any]] = {}
    normals = normals_at_vertices(found, told)
    if normals is not None:
        columns |= {f"n{axis}": normals[:, k].astype(np.float32) for k, axis in enumerate("xyz")}
    if found.uv is not None and found.uv_of is None:
        columns |= {"s": found.uv[:, 0].astype(np.float32), "t": found.uv[:, 1].astype(np.float32)}
    colours, of_faces = (channels_of(data) for data in (found.at_vertices, found.of_faces))
    if colours is not None:
        columns |= dict(zip(CHANNELS, colours.T, strict=False))
    faces = {} if of_faces is None else dict(zip(CHANNELS, of_faces.T, strict=False))
    normals = found.of_faces.get("normals")
    if normals is not None and normals.ndim == 2 and normals.shape[1] == 3:
        del found.of_faces["normals"]
        faces |= {f"n{axis}": normals[:, k].astype(np.float32) for k, axis in enumerate("xyz")}
    columns |= _numbers(found.at_vertices, "at vertices", told)
    faces |= _numbers(found.of_faces, "of faces", told)
    comments = [line if line.startswith(("comment", "obj_info")) else f"comment {line}" for line in found.comments]
    comments += [f"comment {label} {k} {name}" for label, names in found.names.items() for k, name in enumerate(names)]
    comments += [f"comment mtllib {name}" for name in found.libraries]
    _name_materials(found, told)
    places = None if found.uv is None or found.uv_of is None else found.uv[found.uv_of].astype(np.float32)
    lines = [" ".join(line.split()) for line in dict.fromkeys(comments)]
    return encode_ply(found.vertices.astype(dtype), columns, found.sizes, found.corners, faces, places, lines)


def _numbers(data: dict[str, npt.NDArray[Any]], where: str, told: Told) -> dict[str, npt.NDArray[Any]]:
    """Return the data of one number per element, (m,) each, in types that PLY has."""
    found = {}
    for name, values in data.items():
        if values.ndim != 1 or values.dtype.kind not in "biuf" or not re.fullmatch(r"[!-~]+", name):
            told.lost.append(f"the data {name!r} {where}")
            continue
        fits = values.dtype.str[1:] in WRITTEN
        found[name] = values if fits else values.astype(np.uint8 if values.dtype.kind == "b" else np.float64)
        if not fits and not np.array_equal(
            found[name].astype(values.dtype), values, equal_nan=values.dtype.kind == "f"
        ):
            told.lost.append(f"digits of the data {name!r}, which are float64")
    return found


def _name_materials(found: Contents, told: Told) -> None:
    """Name pictures and properties of materials, which a file of its own would hold."""
    for material in found.materials:
        pictures = (getattr(material, name, None) for name in ("image", "baseColorTexture"))
        # trimesh gives a texture without a picture one of a single pixel
        pictured = any(picture is not None and max(picture.size) > 1 for picture in pictures)
        name = getattr(material, "name", None)
        if pictured or getattr(material, "baseColorFactor", None) is not None:
            told.lost.append(f"the material{f' {name!r}' if name else ''}{' with its picture' if pictured else ''}")


def _obj(found: Contents, dtype: np.dtype[Any], told: Told) -> bytes:
    colours = channels_of(found.at_vertices)
    if colours is not None and colours.shape[1] == 4 and (colours[:, 3] != 255).any():
        told.lost.append("the alpha of colours")
    labels: dict[str, list[str | None]] = {}
    for label, names in found.names.items():
        numbers = found.of_faces.pop(label, None)
        if numbers is not None:
            labels[label] = [names[k] if 0 <= k < len(names) else None for k in numbers.tolist()]
    _name_all(found, told)
    _name_materials(found, told)
    head = [f"# {_plain(line)}".rstrip() for line in found.comments]
    head += [f"mtllib {name}" for name in found.libraries]
    places_of = found.corners if found.uv is not None and found.uv_of is None else found.uv_of
    normals_of = found.corners if found.normals is not None and found.normal_of is None else found.normal_of
    return encode_obj(
        found.vertices,
        None if colours is None else colours[:, :3],
        found.sizes,
        [found.corners, places_of, normals_of],
        found.uv,
        found.normals,
        labels,
        head,
    )


def _plain(line: str) -> str:
    """Return a comment without the words of a PLY header."""
    return re.sub(r"^(comment|obj_info)\s+", "", line)


def _name_all(found: Contents, told: Told) -> None:
    """Name all data of vertices and faces that are left."""
    for data, where in ((found.at_vertices, "at vertices"), (found.of_faces, "of faces")):
        told.lost += [f"the {name} {where}" if name == "colours" else f"the data {name!r} {where}" for name in data]


def _off(found: Contents, dtype: np.dtype[Any], told: Told) -> bytes:
    colours, of_faces = (channels_of(data) for data in (found.at_vertices, found.of_faces))
    if colours is not None and colours.shape[1] == 3:
        colours = np.column_stack([colours, np.full(len(colours), 255, np.uint8)])
    _name_all(found, told)
    _name_rest(found, told, uv=True, normals=True)
    _name_materials(found, told)
    comments = [_plain(line) for line in found.comments]
    return encode_off(found.vertices, colours, found.sizes, found.corners, of_faces, comments)


def _name_rest(found: Contents, told: Told, *, uv: bool, normals: bool) -> None:
    if uv and found.uv is not None:
        told.lost.append("the places in a texture")
    if normals and found.normals is not None:
        told.lost.append("the normals at vertices")
    if found.libraries:
        told.lost.append(f"the materials in {', '.join(found.libraries)}")


def _stl(found: Contents, dtype: np.dtype[Any], told: Told) -> bytes:
    in_triangles(found, "STL", told)
    _name_all(found, told)
    _name_rest(found, told, uv=True, normals=True)
    _name_materials(found, told)
    title = _plain(found.comments[0]) if found.comments else ""
    if len(found.comments) > 1 or len(title) > 80:
        told.lost.append("the comments, but for the first 80 letters")
    return encode_stl(found.vertices, found.corners, title)


def _scene(kind: str) -> Any:
    def encode(found: Contents, dtype: np.dtype[Any], told: Told) -> bytes:
        in_triangles(found, kind, told)
        split_at_seams(found)
        found.normals = normals_at_vertices(found, told)
        for data in (found.at_vertices, found.of_faces):
            colours = channels_of(data)
            if colours is not None:
                data["colours"] = colours
        if found.comments:
            told.lost.append("the comments")
        _name_rest(found, told, uv=False, normals=False)
        return encode_scene(found, kind, told)

    return encode


def _3mf(found: Contents, dtype: np.dtype[Any], told: Told) -> bytes:
    in_triangles(found, "3MF", told)
    label = found.of_faces.pop("object", None)
    _name_all(found, told)
    _name_rest(found, told, uv=True, normals=True)
    _name_materials(found, told)
    if label is not None:
        found.of_faces = {"object": label}
    return encode_3mf(found)


_ENCODERS: dict[str, Any] = {
    "PLY": _ply,
    "OBJ": _obj,
    "OFF": _off,
    "STL": _stl,
    "GLB": _scene("GLB"),
    "GLTF": _scene("GLTF"),
    "3MF": _3mf,
}


def rms(vectors: FloatArray) -> float:
    """Return the root mean square length of vectors, (m, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean())) if len(vectors) else 0.0
