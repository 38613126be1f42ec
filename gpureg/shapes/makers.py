"""Take meshes of other libraries apart, and make new ones of the same type that keep the data of the old ones."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from .carried import Carried, Split
from .renewed_normals import renewed_cell_normals, renewed_face_normals, renewed_vertex_normals

# A function that makes a mesh of the input's type from vertices, faces, and, if these are not the input's, where their
# data come from. It returns the mesh and what it lost, in words.
Maker = Callable[[FloatArray, IntArray, Carried | None], tuple[Any, list[str]]]

Found = tuple[npt.ArrayLike, npt.ArrayLike, Maker]

_PARAMETERS = "the parameters of the {}, which is a mesh like any other now"

# Names that normals have among the data at vertices and faces.
NORMALS = ("normal", "normals", "vertex_normals", "point_normals", "face_normals", "cell_normals")


def of_pair(mesh: Any) -> Found | None:
    """Take (vertices, faces) apart; new vertices have the given floating-point type, otherwise float64."""
    if not isinstance(mesh, tuple | list) or len(mesh) != 2:
        return None
    given = np.asarray(mesh[0]).dtype
    kind = given if given.kind == "f" else np.dtype(np.float64)

    def make(vertices: FloatArray, faces: IntArray, carried: Carried | None) -> tuple[Any, list[str]]:
        return (vertices.astype(kind), faces), []

    return mesh[0], mesh[1], make


def of_trimesh(mesh: Any) -> Found | None:
    """Take a trimesh.Trimesh apart; the normals of a new one are computed when they are asked for."""
    # asked of the type, because a mesh would compute its normals
    if not hasattr(type(mesh), "face_normals") or not hasattr(mesh, "vertices"):
        return None

    def make(vertices: FloatArray, faces: IntArray, carried: Carried | None) -> tuple[Any, list[str]]:
        if carried is not None:
            return _trimesh_with_less(mesh, carried)
        primitive = hasattr(mesh, "primitive")
        made = (mesh.to_mesh() if primitive else mesh).copy()
        made.vertices = vertices
        before = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        _renew(made.vertex_attributes, renewed_vertex_normals, (vertices, faces), before)
        _renew(made.face_attributes, renewed_face_normals, (vertices, faces), before)
        return made, [_PARAMETERS.format(type(mesh).__name__)] if primitive else []

    return mesh.vertices, mesh.faces, make


def _trimesh_with_less(mesh: Any, carried: Carried) -> tuple[Any, list[str]]:
    n, visual, lost = len(carried.before), mesh.visual, list[str]()
    kind = getattr(visual, "kind", None)
    at_vertices = _fitting(mesh.vertex_attributes, n, "at vertices", lost)
    at_faces = _fitting(mesh.face_attributes, len(carried.corners), "of faces", lost)
    arrays = list(at_vertices.values())
    uv = getattr(visual, "uv", None) if kind == "texture" else None
    beside = _fitting(getattr(visual, "vertex_attributes", {}), n, "at vertices", lost) if kind == "texture" else {}
    if kind == "vertex":
        arrays.append(np.asarray(visual.vertex_colors))
    if uv is not None:
        arrays.append(np.asarray(uv))
    split = carried.split([*arrays, *beside.values()])
    whole = type(mesh)
    if hasattr(mesh, "primitive"):
        whole = type(mesh.to_mesh())
        lost.append(_PARAMETERS.format(type(mesh).__name__))
    colours = {}
    if kind == "vertex":
        colours = {"vertex_colors": split.of_vertices(visual.vertex_colors)}
    elif kind == "face":
        colours = {"face_colors": carried.of_faces(visual.face_colors)}
    made = whole(vertices=split.vertices, faces=split.faces, process=False, **colours)
    if kind == "texture":
        of_faces = getattr(visual, "face_materials", None)
        made.visual = type(visual)(
            uv=None if uv is None else split.of_vertices(uv),
            material=copy.deepcopy(visual.material),
            face_materials=None if of_faces is None else carried.of_faces(of_faces),
        )
        made.visual.vertex_attributes.update({name: split.of_vertices(x) for name, x in beside.items()})
    made.vertex_attributes.update({name: split.of_vertices(x) for name, x in at_vertices.items()})
    made.face_attributes.update({name: carried.of_faces(x) for name, x in at_faces.items()})
    now, before = (split.vertices, split.faces), (carried.before, carried.corners)
    _renew(made.vertex_attributes, renewed_vertex_normals, now, before, mesh.vertex_attributes)
    _renew(made.face_attributes, renewed_face_normals, now, before, mesh.face_attributes)
    for name, value in mesh.metadata.items():
        if hasattr(value, "carried_to"):
            made.metadata[name], more = value.carried_to(split)
            lost += more
        else:
            made.metadata[name] = copy.deepcopy(value)
    return made, lost


def _fitting(data: Mapping[str, Any], count: int, where: str, lost: list[str]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of `count` values; name the others in `lost`."""
    arrays = {name: np.asarray(x) for name, x in data.items()}
    lost += [
        f"the data {name!r} {where}: {len(x) if x.ndim else 1} values instead of {count}"
        for name, x in arrays.items()
        if x.ndim == 0 or len(x) != count
    ]
    return {name: x for name, x in arrays.items() if x.ndim and len(x) == count}


def _renew(data: Any, renewed: Any, now: tuple[Any, Any], before: tuple[Any, Any], old: Any = None) -> None:
    """Compute the normals among the data at vertices or faces again, in place."""
    for name in list(data):
        given = np.asarray((data if old is None else old)[name])
        if str(name).lower() in NORMALS and given.ndim == 2 and given.shape[1] == 3 and given.dtype.kind == "f":
            data[name] = renewed(*now, *before, given)


def of_pyvista(mesh: Any) -> Found | None:
    """Take a pyvista.PolyData apart; polygons are cut into triangles, and stay if no vertex is removed."""
    if not hasattr(type(mesh), "regular_faces") or not hasattr(mesh, "points"):
        return None
    triangles, cell = _triangles_of_pyvista(mesh)

    def make(vertices: FloatArray, faces: IntArray, carried: Carried | None) -> tuple[Any, list[str]]:
        lost: list[str] = []
        if carried is None:
            made, new_cell = mesh.copy(), cell
            made.points = vertices
            now = vertices, faces
        else:
            made, now = _pyvista_with_less(mesh, carried, cell, lost)
            new_cell = np.arange(len(carried.origin))
        before = np.asarray(mesh.points, float), triangles
        for old, new, of_cells in ((mesh.point_data, made.point_data, False), (mesh.cell_data, made.cell_data, True)):
            active = old.active_normals_name
            for name in [name for name in old if name == active or str(name).lower() in NORMALS]:
                values = np.asarray(old[name])
                if of_cells:
                    new[name] = renewed_cell_normals(now, before, values[cell], new_cell, np.array(new[name]))
                else:
                    new[name] = renewed_vertex_normals(*now, *before, values)
            if active is not None:
                new.active_normals_name = active
        return made, lost

    return mesh.points, triangles, make


def _triangles_of_pyvista(mesh: Any) -> tuple[IntArray, IntArray]:
    """Return the triangles (F, 3) of a mesh, and the cell that each is a part of, (F,)."""
    if mesh.is_all_triangles:
        triangles = np.asarray(mesh.regular_faces)
        # they are the last cells, after lines and single vertices
        return triangles, np.arange(mesh.n_cells - len(triangles), mesh.n_cells)
    tagged = mesh.copy(deep=False)
    tagged.cell_data["_cell"] = np.arange(mesh.n_cells)
    cut = tagged.triangulate()
    triangles = np.asarray(cut.regular_faces)
    return triangles, np.asarray(cut.cell_data["_cell"])[cut.n_cells - len(triangles) :]


def _pyvista_with_less(
    mesh: Any, carried: Carried, cell: IntArray, lost: list[str]
) -> tuple[Any, tuple[FloatArray, IntArray]]:
    points = {name: np.asarray(mesh.point_data[name]) for name in mesh.point_data}
    normals = {name for name in points if name.lower() in NORMALS} | {mesh.point_data.active_normals_name}
    split = carried.split([x for name, x in points.items() if name not in normals])
    made = type(mesh).from_regular_faces(split.vertices, split.faces)
    for name, values in points.items():
        made.point_data[name] = split.of_vertices(values)
    for name in mesh.cell_data:
        made.cell_data[name] = np.asarray(mesh.cell_data[name])[cell[carried.origin]]
    for name in mesh.field_data:
        made.field_data[name] = mesh.field_data[name]
    known, count = np.unique(cell, return_counts=True)
    if len(known) < mesh.n_cells:
        lost.append(f"{mesh.n_cells - len(known)} lines and vertex cells")
    if (count > 1).any():
        lost.append(f"{(count > 1).sum()} polygons of more than three corners, which are triangles now")
    for of, data in ((mesh.point_data, made.point_data), (mesh.cell_data, made.cell_data)):
        data.active_scalars_name = of.active_scalars_name
    if mesh.point_data.active_texture_coordinates_name is not None:
        made.point_data.active_texture_coordinates_name = mesh.point_data.active_texture_coordinates_name
    return made, (split.vertices, split.faces)


def of_open3d(mesh: Any) -> Found | None:
    """Take an open3d.geometry.TriangleMesh apart."""
    if not hasattr(mesh, "triangles") or not hasattr(mesh, "vertices"):
        return None

    def make(vertices: FloatArray, faces: IntArray, carried: Carried | None) -> tuple[Any, list[str]]:
        made = type(mesh)(mesh)
        if carried is not None:
            colours = [np.asarray(mesh.vertex_colors)] if mesh.has_vertex_colors() else []
            split = carried.split(colours)
            vertices, faces = split.vertices, split.faces
            for name in ("vertex_colors",) if colours else ():
                setattr(made, name, type(getattr(mesh, name))(split.of_vertices(getattr(mesh, name))))
            _less_of_open3d(mesh, made, split)
        made.vertices = type(mesh.vertices)(vertices)
        made.triangles = type(mesh.triangles)(faces.astype(np.int32))
        before = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
        for has, name, renewed in (
            (mesh.has_vertex_normals(), "vertex_normals", renewed_vertex_normals),
            (mesh.has_triangle_normals(), "triangle_normals", renewed_face_normals),
        ):
            if has:
                old = getattr(mesh, name)
                setattr(made, name, type(old)(renewed(vertices, faces, *before, np.asarray(old))))
        if mesh.has_adjacency_list():
            made.compute_adjacency_list()
        return made, []

    return np.asarray(mesh.vertices), np.asarray(mesh.triangles), make


def _less_of_open3d(mesh: Any, made: Any, split: Split) -> None:
    """Give the triangles that are left their places in the texture and their materials."""
    carried = split.carried
    if mesh.has_triangle_uvs():
        uv = carried.of_corners(np.asarray(mesh.triangle_uvs).reshape(-1, 3, 2))
        made.triangle_uvs = type(mesh.triangle_uvs)(uv.reshape(-1, 2))
    if mesh.has_triangle_material_ids():
        ids = carried.of_faces(np.asarray(mesh.triangle_material_ids))
        made.triangle_material_ids = type(mesh.triangle_material_ids)(ids)
