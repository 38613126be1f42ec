"""What mesh files hold beside the geometry: it is kept, computed again, or named."""

from __future__ import annotations

import json
import re
import struct
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

import gpureg as gr
from gpureg.meshes.beside import KEY
from gpureg.meshes.polygons import triangulated
from gpureg.meshes.reading import read_mesh
from gpureg.meshes.writing import write_mesh
from gpureg.shapes.surface import surface_of

N = 7
RNG = np.random.default_rng(4)


def text_of_quads() -> str:
    """An OBJ: a rough sheet of quads and triangles, two objects, two materials, a texture with a seam, a crease."""
    y, x = np.mgrid[:N, :N] / (N - 1)
    points = np.stack([x, y, 0.02 * RNG.normal(0, 1, (N, N))], axis=-1).reshape(-1, 3)
    lines = ["# a sheet", "mtllib skin.mtl", *("v {} {} {}".format(*row) for row in points)]
    lines += [f"vt {u} {v}" for u, v, _ in points] + ["vt 0.5 0.25", "vn 0 0 1", "vn 0 1 0"]
    for k in range((N - 1) ** 2):
        a = k // (N - 1) * N + k % (N - 1) + 1
        if k % 18 == 0:
            lines += [f"o half{k // 18}", f"g part{k}", f"usemtl {'red' if k else 'blue'}"]
        # the last quad has another place in the texture at its first corner, and another normal everywhere
        last = k == (N - 1) ** 2 - 1
        corners = [(v, N * N + 1 if last and v == a else v, 2 if last else 1) for v in (a, a + 1, a + N + 1, a + N)]
        words = ["{}/{}/{}".format(*corner) for corner in corners]
        lines += ["f " + " ".join(words)] if k % 5 else [f"f {' '.join(words[:3])}", "f {0} {2} {3}".format(*words)]
    return "\n".join([*lines, ""])


SHEET = text_of_quads()


@pytest.fixture
def sheet(tmp_path) -> Path:
    (tmp_path / "in.obj").write_text(SHEET)
    return tmp_path / "in.obj"


def silent(work):
    """Call without warnings; return the result and what was warned."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = work()
    return found, [str(one.message) for one in caught]


def lines_of(path: Path, *words: str) -> list[str]:
    return [line for line in path.read_text().splitlines() if line.split(" ")[0] in words]


def test_an_obj_comes_back_as_it_was(sheet, tmp_path):
    found = read_mesh(sheet)
    assert len(found.vertices) == N * N + 1  # the seam
    write_mesh(tmp_path / "out.obj", found.mesh)
    words = ("#", "mtllib", "o", "g", "usemtl", "f")
    assert lines_of(tmp_path / "out.obj", *words) == [
        line for name in ("#", "mtllib") for line in lines_of(sheet, name)
    ] + lines_of(sheet, *words[2:])
    assert len(lines_of(tmp_path / "out.obj", "v")) == N * N


def test_denoising_keeps_all_but_the_positions_and_normals(sheet, tmp_path):
    smooth, said = silent(lambda: gr.denoise_mesh(read_mesh(sheet).mesh, filter="positions", backend="numpy"))
    write_mesh(tmp_path / "out.obj", smooth)
    assert said == [] and len(lines_of(tmp_path / "out.obj", "v")) == N * N
    old, new = ([line.split() for line in lines_of(path, "f")] for path in (sheet, tmp_path / "out.obj"))
    assert [[c.split("/")[0] for c in face] for face in old] == [[c.split("/")[0] for c in face] for face in new]
    # normals of one side of a crease are those of the faces there
    again = read_mesh(tmp_path / "out.obj").mesh.metadata[KEY]
    at, faces = again.normal_of[again.at], again.corners[again.at]
    v = again.vertices
    area = np.cross(v[faces[:, 1]] - v[faces[:, 0]], v[faces[:, 2]] - v[faces[:, 0]])
    last = at[-1]
    assert np.allclose(again.normals[last[1]], (area[-1] + area[-2]) / np.linalg.norm(area[-1] + area[-2]), atol=1e-6)
    # all but one of the last quad's corners are at other faces too
    assert len(np.unique(again.normal_of)) == N * N + 3


@pytest.mark.parametrize(
    ("extension", "words"),
    [
        (".ply", "vertices have several normals"),
        (".off", "OFF has no place for the data 'object' of faces, .* the places in a texture"),
        (".stl", "STL has no place for .* the materials in skin.mtl"),
        (".glb", "GLB has no place for the comments"),
        (".3mf", "3MF has no place for .*'material' of faces, the places in a texture"),
    ],
)
def test_each_format_keeps_or_names(sheet, tmp_path, extension, words):
    given, path = read_mesh(sheet), tmp_path / f"out{extension}"
    assert re.search(words, "\n".join(silent(lambda: write_mesh(path, given.mesh))[1]))
    found, said = silent(lambda: read_mesh(path))
    corners = [mesh.vertices[mesh.faces] for mesh in (given, found)]
    assert np.abs(np.sort(corners[0], axis=0) - np.sort(corners[1], axis=0)).max() < 1e-6
    beside = found.mesh.metadata[KEY]
    if extension in (".ply", ".off"):
        assert np.array_equal(beside.sizes, given.mesh.metadata[KEY].sizes)
    if extension == ".ply":
        assert beside.names == given.mesh.metadata[KEY].names and beside.libraries == ("skin.mtl",)
        assert np.allclose(found.mesh.visual.uv[found.faces], given.mesh.visual.uv[given.faces])
    if extension in (".glb", ".3mf"):
        assert set(beside.names["object"]) == {"half0", "half1"} and "2 objects are one mesh" in said[0]


def test_normals_of_a_ply(tmp_path):
    """Those of the file while nothing moved, otherwise computed again, on the side of the old ones."""
    sphere = trimesh.creation.icosphere(2)
    path, rough = tmp_path / "in.ply", sphere.vertices * (1 + 0.03 * RNG.normal(0, 1, (162, 1)))
    kind = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 162\n"
    header += "".join(f"property float {name}\n" for name, _ in kind)
    header += "element face 320\nproperty list uchar int vertex_index\nend_header\n"
    rows = np.concatenate([rough, -sphere.vertices], axis=1).astype("<f4")
    faces = np.zeros(320, [("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, sphere.faces
    path.write_bytes(header.encode() + rows.tobytes() + faces.tobytes())
    given = read_mesh(path).mesh
    write_mesh(tmp_path / "same.ply", given)
    assert (tmp_path / "same.ply").read_bytes().endswith(rows.tobytes() + faces.tobytes())
    smooth = gr.denoise_mesh(given, backend="numpy")
    write_mesh(tmp_path / "smooth.ply", smooth)
    normals = read_mesh(tmp_path / "smooth.ply").mesh.metadata[KEY]
    at = normals.normals[normals.normal_of][np.unique(normals.corners, return_index=True)[1]]
    assert np.abs(np.linalg.norm(at, axis=1) - 1).max() < 1e-6
    # inwards, as in the file; of the moved surface, which differs from that of the sphere
    assert (at * smooth.vertices).sum(axis=1).max() < -0.9
    least = gr.simplify_mesh(given, n_vertices=40, backend="numpy").metadata[KEY]
    at = least.normals[least.normal_of].reshape(-1, 3, 3)
    assert (at.mean(axis=1) * least.vertices[least.corners.reshape(-1, 3)].mean(axis=1)).sum(axis=1).max() < -0.5


def test_normals_of_the_faces_of_a_ply(tmp_path):
    text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    text += "element face 1\nproperty list uchar int vertex_indices\n"
    text += "".join(f"property float n{axis}\n" for axis in "xyz") + "end_header\n"
    (tmp_path / "a.ply").write_text(text + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3 0 0 -1\n")
    given = read_mesh(tmp_path / "a.ply").mesh
    assert given.face_attributes["normals"].tolist() == [[0, 0, -1]] * 2
    turned = surface_of(given).like(given.vertices[:, [2, 0, 1]])
    write_mesh(tmp_path / "b.ply", turned)
    again = read_mesh(tmp_path / "b.ply").mesh
    assert again.face_attributes["normals"].tolist() == [[-1, 0, 0]] * 2
    assert again.metadata[KEY].sizes.tolist() == [4]


def mixed_ply(order: str = "<") -> bytes:
    """As Blender writes polygons: of several sizes, in binary, with a number and a colour each."""
    header = f"ply\nformat binary_{'little' if order == '<' else 'big'}_endian 1.0\ncomment TextureFile skin.png\n"
    header += "element vertex 5\nproperty double x\nproperty double y\nproperty double z\nproperty uchar red\n"
    header += "property uchar green\nproperty uchar blue\nelement face 3\nproperty list uchar uint vertex_indices\n"
    header += "property short part\nelement edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n"
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (-1, 0.5, 0)]
    body = b"".join(struct.pack(f"{order}3d3B", *p, 7 * k, 0, 255) for k, p in enumerate(points))
    body += struct.pack(f"{order}B4Ih", 4, 0, 1, 2, 3, 5) + struct.pack(f"{order}B3Ih", 3, 0, 3, 4, -6)
    return header.encode() + body + struct.pack(f"{order}B5Ih2i", 5, 0, 4, 3, 2, 1, 7, 0, 1)


@pytest.mark.parametrize("order", "<>")
def test_binary_polygons_of_several_sizes(tmp_path, order):
    (tmp_path / "in.ply").write_bytes(mixed_ply(order))
    with pytest.warns(UserWarning, match="not read: the 1 rows of its element 'edge'"):
        found = read_mesh(tmp_path / "in.ply")
    assert found.mesh.face_attributes["part"].tolist() == [5, 5, -6, 7, 7, 7]
    assert found.mesh.visual.vertex_colors[:, 0].tolist() == [0, 7, 14, 21, 28]
    write_mesh(tmp_path / "out.ply", found.mesh)
    again = read_mesh(tmp_path / "out.ply").mesh
    assert again.metadata[KEY].sizes.tolist() == [4, 3, 5]
    assert again.metadata[KEY].comments == ("comment TextureFile skin.png",)
    assert np.array_equal(again.faces, found.faces)


def test_concave_polygons_do_not_turn_over():
    arrow = np.array([[0, 0, 0], [2, 1, 0], [0, 2, 0], [0.5, 1, 0]])
    star = np.array([[np.cos(t), np.sin(t), 0] for t in np.arange(10) * np.pi / 5]) * ([[1], [0.4]] * 5)
    points = np.concatenate([arrow, star])
    at = triangulated(points, np.array([4, 10]), np.arange(14))
    area = np.cross(points[at[:, 1]] - points[at[:, 0]], points[at[:, 2]] - points[at[:, 0]])[:, 2] / 2
    assert area.min() > 0
    assert area.sum() == pytest.approx(1.5 + 10 * 0.5 * 0.4 * np.sin(np.pi / 5))


def test_relative_indices_count_from_what_was_read(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 1\nv 1 0 1\nv 0 1 1\nf -3 -2 -1\n"
    (tmp_path / "a.obj").write_text(text)
    assert read_mesh(tmp_path / "a.obj").faces.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_objects_of_a_scene_are_moved_and_joined(tmp_path):
    box, ball = trimesh.creation.box(), trimesh.creation.icosphere(1)
    box.visual.vertex_colors = [255, 0, 0, 255]
    scene = trimesh.Scene()
    scene.add_geometry(box, node_name="box", geom_name="box")
    mirrored = np.diag([-2.0, 2, 2, 1]) + np.array([[0, 0, 0, 5.0]] + 3 * [[0] * 4])
    scene.add_geometry(ball, node_name="ball", geom_name="ball", transform=mirrored)
    (tmp_path / "a.glb").write_bytes(scene.export(file_type="glb"))
    found, said = silent(lambda: read_mesh(tmp_path / "a.glb"))
    assert "2 objects are one mesh" in said[0] and "positions of its objects" in said[1]
    assert found.mesh.volume == pytest.approx(box.volume + 8 * ball.volume, rel=1e-5)
    names = np.array(found.mesh.metadata[KEY].names["object"])[found.mesh.face_attributes["object"]]
    assert (names == np.where(found.vertices[found.faces].mean(axis=1)[:, 0] > 2, "ball", "box")).all()
    assert (found.mesh.visual.vertex_colors[found.vertices[:, 0] < 2, 1] == 0).all()


def test_components_of_a_3mf_are_moved(tmp_path):
    write_mesh(tmp_path / "a.3mf", trimesh.creation.box())
    with zipfile.ZipFile(tmp_path / "a.3mf") as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    model = parts["3D/3dmodel.model"].decode()
    more = '<component objectid="1" transform="1 0 0 0 1 0 0 0 1 3 0 0"/>'
    more = f'<object id="2"><components>{more}</components></object>'
    model = model.replace("</resources>", f"{more}</resources>")
    model = model.replace("</build>", '<item objectid="2" transform="2 0 0 0 2 0 0 0 2 0 0 0"/></build>')
    with zipfile.ZipFile(tmp_path / "b.3mf", "w") as archive:
        for name, data in (parts | {"3D/3dmodel.model": model.encode()}).items():
            archive.writestr(name, data)
    found, said = silent(lambda: read_mesh(tmp_path / "b.3mf"))
    assert found.mesh.volume == pytest.approx(9) and found.vertices[:, 0].max() == 7
    assert len(said) == 2


def test_rounding_to_float32_is_said(tmp_path):
    far = trimesh.creation.icosphere(2)
    far.apply_translation([4.5e6, 5e5, 0])
    with pytest.warns(UserWarning, match=r"STL holds float32.* at coordinates of 4\.5e\+06, .* % of the mean edge"):
        write_mesh(tmp_path / "a.stl", far)
    with pytest.warns(UserWarning, match="the file holds float32"):
        write_mesh(tmp_path / "a.ply", far, dtype=np.float32)
    write_mesh(tmp_path / "b.ply", far)
    write_mesh(tmp_path / "b.stl", trimesh.creation.icosphere(2))


def test_data_of_pyvista_are_written(tmp_path):
    pv = pytest.importorskip("pyvista", reason="pyvista is not installed")
    sphere = pv.Sphere(theta_resolution=12, phi_resolution=12)
    sphere.point_data["heat"] = sphere.points[:, 2]
    sphere.cell_data["part"] = np.arange(sphere.n_cells) % 3
    sphere.field_data["unit"] = ["mm"]
    with pytest.warns(UserWarning, match="the field data 'unit'$"):
        write_mesh(tmp_path / "a.ply", sphere)
    found = read_mesh(tmp_path / "a.ply").mesh
    assert np.array_equal(found.vertex_attributes["heat"], sphere.point_data["heat"])
    assert np.array_equal(found.face_attributes["part"], sphere.cell_data["part"])
    assert found.metadata[KEY].normals is not None


def test_metadata_of_a_trimesh_are_named(tmp_path):
    box = trimesh.creation.box()
    box.metadata = {"owner": json.dumps("me")}
    with pytest.warns(UserWarning, match="PLY has no place for the metadata owner"):
        write_mesh(tmp_path / "a.ply", box)
