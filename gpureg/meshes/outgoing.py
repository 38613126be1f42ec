"""What there is to write of a mesh: :func:`contents_of`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..shapes.makers import NORMALS
from ..shapes.renewed_normals import unit
from ..shapes.surface import Surface
from .beside import KEY, Beside, Told
from .contents import CHANNELS, Contents

# Metadata that trimesh makes itself, from files and for the shapes of trimesh.creation.
MADE = {KEY, "name", "file_name", "file_path", "node", "units", "from_gltf_primitive", "gltf_extensions", "source"}
MADE |= {"shape", "radius", "extents", "height", "bounds", "processed"}


def contents_of(mesh: Any, surface: Surface, told: Told) -> Contents:
    """Return the contents of a file for a mesh, whose surface is given; name in `told` what it does not take."""
    if hasattr(mesh, "visual"):
        return _of_trimesh(mesh, told)
    found = Contents(surface.vertices, np.full(len(surface.faces), 3), surface.faces.ravel())
    if hasattr(mesh, "point_data"):
        _take_pyvista(mesh, found, told)
    elif hasattr(mesh, "triangles"):
        _take_open3d(mesh, found, told)
    return found


def _of_trimesh(mesh: Any, told: Told) -> Contents:
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    n = len(vertices)
    given = mesh.metadata.get(KEY)
    beside = given
    if not isinstance(given, Beside) or not given.fits(faces):
        corners = np.arange(faces.size).reshape(-1, 3)
        beside = Beside(vertices, np.full(len(faces), 3), faces.ravel(), corners, np.arange(n))
        if isinstance(given, Beside):
            beside = replace(
                beside,
                names=given.names,
                comments=given.comments,
                libraries=given.libraries,
                units=given.units,
                materials=given.materials,
            )
            if given.normals is not None or (given.sizes > 3).any():
                told.lost.append("the normals and polygons of the file, as the faces are others now")
    first = beside.first
    visual = mesh.visual
    kind = getattr(visual, "kind", None)
    at_vertices = _fitting(mesh.vertex_attributes, n, "at vertices", told)
    of_faces = _fitting(mesh.face_attributes, len(faces), "of faces", told)
    if kind == "vertex":
        at_vertices["colours"] = np.asarray(visual.vertex_colors, np.uint8)
    elif kind == "face":
        of_faces["colours"] = np.asarray(visual.face_colors, np.uint8)
    uv = np.asarray(visual.uv, np.float64) if kind == "texture" and np.shape(visual.uv) == (n, 2) else None
    copies, one = _copies(beside.copies, vertices, at_vertices, uv is not None)
    extra = sorted(str(key) for key in mesh.metadata if key not in MADE)
    if extra:
        told.lost.append(f"the metadata {', '.join(extra)}")
    normals, normal_of = beside.normals_of(vertices)
    for name in [name for name in at_vertices if name.lower() in NORMALS and at_vertices[name].shape == (n, 3)]:
        if normals is None and len(one) == n:
            normals, normal_of = np.asarray(at_vertices.pop(name), np.float64), None
    materials = beside.materials
    if kind == "texture" and given is None and getattr(visual, "material", None) is not None:
        materials = (visual.material,)
    return Contents(
        vertices[one],
        beside.sizes,
        copies[beside.corners],
        at_vertices={name: x[one] for name, x in at_vertices.items()},
        of_faces={name: x[first] for name, x in of_faces.items()},
        uv=uv,
        uv_of=None if len(one) == n else beside.corners,
        normals=normals,
        normal_of=normal_of,
        names=beside.names,
        comments=beside.comments,
        libraries=beside.libraries,
        units=beside.units or (str(mesh.units) if getattr(mesh, "units", None) else None),
        materials=materials,
    )


def _copies(copies: IntArray, vertices: Any, data: dict[str, Any], textured: bool) -> tuple[IntArray, IntArray]:
    """Join the copies of vertices at the seams of a texture again, if nothing else differs between them.

    Return the new number of each vertex, (n,), and one of the old vertices of each new one.
    """
    n = len(vertices)
    apart = np.arange(n), np.arange(n)
    if not textured or len(copies) != n:
        return apart
    _, one, number = np.unique(copies, return_index=True, return_inverse=True)
    number = number.ravel()
    same = all(np.array_equal(x[one][number], x, equal_nan=x.dtype.kind == "f") for x in (vertices, *data.values()))
    return (number, one) if same else apart


def _fitting(data: Any, count: int, where: str, told: Told) -> dict[str, npt.NDArray[Any]]:
    arrays = {str(name): np.asarray(x) for name, x in data.items()}
    told.lost += [f"the data {name!r} {where}" for name, x in arrays.items() if not x.ndim or len(x) != count]
    return {name: x for name, x in arrays.items() if x.ndim and len(x) == count}


def _take_pyvista(mesh: Any, found: Contents, told: Told) -> None:
    names = mesh.point_data.active_normals_name, mesh.point_data.active_texture_coordinates_name
    other = mesh.n_cells - len(found.sizes)
    if other:
        told.lost.append(f"{other} lines and vertex cells")
    told.lost += [f"the field data {name!r}" for name in mesh.field_data]
    for data, into, begin in ((mesh.point_data, found.at_vertices, 0), (mesh.cell_data, found.of_faces, other)):
        for name in data:
            values = np.asarray(data[name])[begin:]
            coloured = values.dtype == np.uint8 and values.ndim == 2 and values.shape[1] in (3, 4)
            normal = str(name).lower() in NORMALS or (into is found.at_vertices and name == names[0])
            if normal and into is found.at_vertices:
                found.normals = np.asarray(values, np.float64)
            elif normal:
                continue  # every reader computes them
            elif into is found.at_vertices and name == names[1]:
                found.uv = np.asarray(values, np.float64)
            else:
                into["colours" if coloured and "colours" not in into else str(name)] = values


def _take_open3d(mesh: Any, found: Contents, told: Told) -> None:
    if mesh.has_vertex_colors():
        found.at_vertices["colours"] = np.rint(255 * np.asarray(mesh.vertex_colors)).astype(np.uint8)
    if mesh.has_vertex_normals():
        found.normals = np.asarray(mesh.vertex_normals)
    if mesh.has_triangle_uvs():
        found.uv = np.asarray(mesh.triangle_uvs).reshape(-1, 2)
        found.uv_of = np.arange(found.corners.size)
    if mesh.has_triangle_material_ids():
        found.of_faces["material"] = np.asarray(mesh.triangle_material_ids)
    if mesh.has_textures():
        told.lost.append(f"{len(mesh.textures)} pictures of textures")


def in_triangles(found: Contents, kind: str, told: Told) -> None:
    """Cut the polygons into triangles, for a format that has no others."""
    from .polygons import triangulated

    many = int((found.sizes > 3).sum())
    if not many:
        return
    told.notes.append(f"{kind} has triangles only: {many} polygons are cut")
    at = triangulated(found.vertices, found.sizes, found.corners)
    polygon = np.repeat(np.arange(len(found.sizes)), found.sizes)[at[:, 0]]
    found.corners, found.sizes = found.corners[at].ravel(), np.full(len(at), 3)
    found.uv_of, found.normal_of = (None if x is None else x[at].ravel() for x in (found.uv_of, found.normal_of))
    found.of_faces = {name: x[polygon] for name, x in found.of_faces.items()}


def split_at_seams(found: Contents) -> None:
    """Repeat vertices with several places in the texture, for a format that has places at vertices only."""
    if found.uv_of is None or found.uv is None:
        return
    pairs = np.stack([found.corners, found.uv_of], axis=1)
    keys, number = np.unique(pairs, axis=0, return_inverse=True)
    found.vertices = found.vertices[keys[:, 0]]
    found.at_vertices = {name: x[keys[:, 0]] for name, x in found.at_vertices.items()}
    found.uv, found.uv_of, found.corners = found.uv[keys[:, 1]], None, number.ravel()


def normals_at_vertices(found: Contents, told: Told) -> FloatArray | None:
    """Return one normal at each vertex, (n, 3), for a format that has no more."""
    if found.normals is None or found.normal_of is None:
        return found.normals
    normals: FloatArray = np.zeros((len(found.vertices), 3))
    normals[found.corners] = found.normals[found.normal_of]
    several = np.zeros(len(normals), bool)
    several[found.corners[(normals[found.corners] != found.normals[found.normal_of]).any(axis=1)]] = True
    if several.any():
        told.notes.append(f"{several.sum()} vertices have several normals, at creases: the mean is written")
        at = found.normals[found.normal_of]
        sums = [np.bincount(found.corners, weights=x, minlength=len(normals)) for x in at.T]
        normals[several] = unit(np.stack(sums, axis=1))[several]
    return normals


def channels_of(data: dict[str, npt.NDArray[Any]]) -> npt.NDArray[np.uint8] | None:
    """Take the colours out of data of vertices or faces, (m, 3 or 4); also those that are channels of bytes."""
    if "colours" in data:
        return data.pop("colours")
    names = [name for name in CHANNELS if name in data]
    if len(names) < 3 or any(data[name].dtype != np.uint8 or data[name].ndim != 1 for name in names):
        return None
    return np.stack([data.pop(name) for name in names], axis=1)
