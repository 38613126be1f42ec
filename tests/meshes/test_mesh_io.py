"""Mesh files: what is read is what was written, in its order and type; broken ones get a sentence."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from users import needs_users, no_root

import gpureg as gr
from gpureg.files.pictures import PictureError
from gpureg.meshes.reading import FORMATS, MeshError, read_mesh
from gpureg.meshes.writing import encode_mesh, write_mesh

SPHERE = trimesh.creation.icosphere(1)
RNG = np.random.default_rng(8)
VERTICES = RNG.normal(0, 1, (len(SPHERE.vertices) + 2, 3)) * [1e-3, 1, 100]
FACES = np.array(SPHERE.faces)  # the last two vertices are in none

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty {} x\nproperty {} y\nproperty {} z\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
)


def put(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("extension", FORMATS)
@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_what_is_written_is_read(tmp_path, extension, offset):
    path = tmp_path / f"a{extension}"
    vertices = VERTICES + offset
    write_mesh(path, (vertices, FACES))
    found = read_mesh(path)
    assert found.vertices.dtype == np.float64 and found.faces.dtype == np.int64
    if extension in (".stl", ".glb", ".gltf"):
        assert found.dtype == np.float32
        assert np.array_equal(found.vertices[found.faces], vertices[FACES].astype(np.float32))
        return
    assert found.dtype == np.float64
    assert np.array_equal(found.faces, FACES)
    # a PLY and a 3MF hold every bit, other text 16 digits of the largest coordinate
    off = 0 if extension in (".ply", ".3mf") else 10.0 ** (np.floor(np.log10(np.abs(vertices).max())) - 15)
    assert found.vertices.shape == vertices.shape
    assert np.abs(found.vertices - vertices).max() <= off


@pytest.mark.parametrize(
    ("given", "asked", "kind"),
    [
        (np.float32, None, np.float32),
        (np.float64, None, np.float64),
        (np.float64, np.float32, np.float32),
        (np.float32, np.float64, np.float64),
    ],
)
def test_the_type_of_a_ply_is_the_least_that_loses_nothing(tmp_path, given, asked, kind):
    vertices = VERTICES.astype(given)
    write_mesh(tmp_path / "a.ply", (vertices, FACES), dtype=asked)
    found = read_mesh(tmp_path / "a.ply")
    assert found.dtype == kind
    assert np.array_equal(found.vertices, vertices.astype(kind))


def test_a_ply_is_of_no_other_type(tmp_path):
    with pytest.raises(ValueError, match="float32 or float64, got int64"):
        write_mesh(tmp_path / "a.ply", (VERTICES, FACES), dtype=np.int64)


@pytest.mark.parametrize("extension", [name for name in FORMATS if name != ".3mf"])  # trimesh needs lxml for it
def test_others_read_what_is_written(tmp_path, extension):
    write_mesh(tmp_path / f"a{extension}", (VERTICES, FACES))
    theirs = trimesh.load_mesh(tmp_path / f"a{extension}", process=False, maintain_order=True)
    assert np.array_equal(np.asarray(theirs.triangles), read_mesh(tmp_path / f"a{extension}").mesh.triangles)


def test_colours_and_numbers_go_along(tmp_path):
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False)
    mesh.visual.vertex_colors = RNG.integers(0, 256, (len(VERTICES), 4), np.uint8)
    mesh.vertex_attributes["quality"] = RNG.random(len(VERTICES), np.float32)
    mesh.vertex_attributes["label"] = np.arange(len(VERTICES))  # int64, which PLY has not
    mesh.vertex_attributes["flag"] = np.arange(len(VERTICES)) % 2 == 0
    mesh.vertex_attributes["pair"] = np.zeros((len(VERTICES), 2))  # more than a number each
    mesh.face_attributes["part"] = np.arange(len(FACES), dtype=np.int16)
    with pytest.warns(UserWarning, match="PLY has no place for the data 'pair' at vertices$"):
        write_mesh(tmp_path / "a.ply", mesh)
    found = read_mesh(tmp_path / "a.ply").mesh
    assert np.array_equal(found.visual.vertex_colors, mesh.visual.vertex_colors)
    assert set(found.vertex_attributes) == {"quality", "label", "flag"}
    told = found.vertex_attributes.items()
    assert [name for name, values in told if not np.array_equal(values, mesh.vertex_attributes[name])] == []
    assert found.vertex_attributes["quality"].dtype == np.float32
    assert np.array_equal(found.face_attributes["part"], mesh.face_attributes["part"])
    mesh.visual.vertex_colors[:, 3] = 255  # OBJ has no alpha
    with pytest.warns(UserWarning, match="OBJ has no place for the data 'quality' at vertices, .*'part' of faces"):
        write_mesh(tmp_path / "a.obj", mesh)
    seen = read_mesh(tmp_path / "a.obj").mesh.visual.vertex_colors
    assert np.array_equal(seen, mesh.visual.vertex_colors)
    by_face = trimesh.Trimesh(VERTICES, FACES, face_colors=RNG.integers(0, 256, (len(FACES), 4)), process=False)
    write_mesh(tmp_path / "a.ply", by_face)
    assert np.array_equal(read_mesh(tmp_path / "a.ply").mesh.visual.face_colors, by_face.visual.face_colors)


def test_numbers_of_a_text_ply(tmp_path):
    text = PLY.format("float", "float", "float").replace("property float z\n", "property float z\nproperty int q\n")
    path = put(tmp_path, "a.ply", text + "0 0 0 5\n1 0 0 6\n1 1 0 7\n0 1 0 8\n3 0 1 2\n3 0 2 3\n")
    assert read_mesh(path).mesh.vertex_attributes["q"].tolist() == [5, 6, 7, 8]


def test_normals_of_an_obj_do_not_tear_it(tmp_path):
    """Vertices with a normal on each side of a crease are one, in the order of the file."""
    text = SQUARE + "vn 0 0 1\nvn 0 1 0\nf 1//1 2//2 3//1\nf 1//2 3//2 4//2\n"
    found = read_mesh(put(tmp_path, "a.obj", text))
    assert found.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert found.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def corners_of(found):
    """The places of all corners of faces, in space and in the texture."""
    return found.vertices[found.faces].tolist(), np.asarray(found.mesh.visual.uv)[found.faces].tolist()


def test_textures_of_an_obj_go_along(tmp_path):
    text = "# caf\xe9\nmtllib skin.mtl\r\n" + SQUARE + "vt 0 1\nvt 0 0.25\nusemtl skin\nf 1/1 2/2 3/1\nf 1/2 3/1 4/2\n"
    found = read_mesh(put(tmp_path, "a.obj", text.encode("latin-1")))
    assert len(found.vertices) == 5  # the first has two places in the texture
    uv = np.asarray(found.mesh.visual.uv)[found.faces]
    assert uv.tolist() == [[[0, 1], [0, 0.25], [0, 1]], [[0, 0.25], [0, 1], [0, 0.25]]]
    write_mesh(tmp_path / "b.obj", found.mesh)
    lines = (tmp_path / "b.obj").read_text("utf-8").splitlines()
    assert [line for line in lines if line.startswith(("mtllib", "usemtl"))] == ["mtllib skin.mtl", "usemtl skin"]
    write_mesh(tmp_path / "b.ply", found.mesh)
    corners = {name: corners_of(read_mesh(tmp_path / name)) for name in ("b.obj", "b.ply")}
    assert corners == dict.fromkeys(corners, (found.vertices[found.faces].tolist(), uv.tolist()))


POLYGONS = {
    "quads.obj": (SQUARE + "f 1 2 3 4\n", 2),
    "mixed.obj": (SQUARE + "v -1 0.5 0\nf 1 2 3 4 5\nf 1 2 3\n", 4),
    "backwards.obj": (SQUARE + "f -4 -3 -2\n", 1),
    "groups.obj": (SQUARE + "g a\nf 1 2 3\ng b\nf 1 3 4\n", 2),
    "quad.off": ("# OFF in a comment\nOFF # here too\n\n4 1 0\n0 0 0\n1 0 0\n1 1 0 # c\n0 1 0\n4 0 1 2 3\n", 2),
    "line.off": ("OFF 4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n", 2),
    "mixed.ply": (PLY.format(*3 * ["double"]) + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n3 0 1 2\n", 3),
}  # fmt: skip


@pytest.mark.parametrize("name", POLYGONS)
def test_polygons_become_triangles(tmp_path, name):
    text, count = POLYGONS[name]
    found = read_mesh(put(tmp_path, name, text))
    assert found.faces.shape == (count, 3)
    assert found.vertices[:4].tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


WHOLE = {extension: encode_mesh(f"a{extension}", SPHERE) for extension in FORMATS}
POINTS = trimesh.PointCloud(VERTICES).export(file_type="ply")
MIXED = PLY.format(*3 * ["float"]).replace("ascii", "binary_little_endian").encode() + bytes(48)

BROKEN = {
    **{f"empty{extension}": (b" \n", "is empty") for extension in FORMATS},
    "noise.ply": (RNG.bytes(300), "no PLY file: its header does not end"),
    "noise.obj": (RNG.bytes(300), "has no face"),
    "noise.off": (RNG.bytes(300), "does not begin with OFF"),
    "noise.stl": (RNG.bytes(300), "triangles, and has bytes for 4.32"),
    "header.ply": (WHOLE[".ply"][:100], "its header does not end"),
    "cut.ply": (WHOLE[".ply"][:-7], "damaged, truncated or no PLY"),
    "cut-text.ply": (PLY.format(*3 * ["float"]) + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n", "it announces 2"),
    "mixed.ply": (MIXED + struct.pack("<B4iB2i", 4, 0, 1, 2, 3, 3, 0, 1), "announces 2 of its element face"),
    "far.ply": (MIXED + struct.pack("<B3iB3i", 3, 0, 1, 7, 3, 0, 1, 2), r"faces must name vertices 0\.\.3, got 7"),
    "points.ply": (POINTS, "has no face"),
    "cut.obj": (WHOLE[".obj"][:-7], "fewer than three corners"),
    "far.obj": (SQUARE + "f 1 2 9\n", "damaged, truncated or no OBJ"),
    "nan.obj": (SQUARE.replace("1 1 0", "1 nan 0") + "f 1 2 3\n", "must be finite, row 2"),
    "points.obj": (SQUARE, "has no face"),
    "zero.obj": (SQUARE + "f 1 2 3\nf 0 1 2\n", "'f 0 1 2' names 0"),
    "zero-texture.obj": (SQUARE + "vt 0 0\nf 1/1 2/0 3/1\n", "names 0"),
    "early.obj": ("v 0 0 0\nf -1 -2 -3\n" + SQUARE, "number -2 of the lines 'v', and the file has 1 of them before it"),
    "cut.off": (WHOLE[".off"][:-7], "its last face is"),
    "lines.off": (WHOLE[".off"][:1000], "announces 42 vertices and 80 faces, and has"),
    "points.off": ("OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "has no face"),
    "cut.stl": (WHOLE[".stl"][:-7], "announces 80 triangles, and has bytes for 79.86"),
    "short.stl": (WHOLE[".stl"][:20], "shorter than a header"),
    "cut-text.stl": (trimesh.exchange.stl.export_stl_ascii(SPHERE)[:-400], "does not end with endsolid"),
    "cut.glb": (WHOLE[".glb"][:-9], "shorter than announced"),
    "cut.3mf": (WHOLE[".3mf"][:-9], "no archive of models"),
    "text.gltf": (b"{", "not JSON"),
    "alone.gltf": (b'{"asset": {"version": "2.0"}, "buffers": [{"uri": "a.bin"}]}', "a.bin, which holds its numbers"),
    "strips.ply": (PLY.format(*3 * ["int"]).replace("face 2", "tristrips 0") + 4 * "0 0 1\n", "triangles are strips"),
    "mesh.dae": (b"<", "one of .ply, .obj, .off, .stl, .glb, .gltf, .3mf"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_get_a_sentence(tmp_path, name):
    content, words = BROKEN[name]
    path = put(tmp_path, name, content)
    with pytest.raises(MeshError, match=words) as caught:
        read_mesh(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_no_file_and_a_folder(tmp_path):
    with pytest.raises(MeshError, match="no such file"):
        read_mesh(tmp_path / "none.ply")
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(MeshError, match="is a folder, not a mesh"):
        read_mesh(tmp_path / "folder.ply")


def test_a_failed_write_leaves_what_was_there(tmp_path, monkeypatch):
    path = put(tmp_path, "a.ply", "old")
    with pytest.raises(MeshError, match="one of"):
        write_mesh(tmp_path / "a.vtk", SPHERE)
    with pytest.raises(PictureError, match="does not exist"):
        write_mesh(tmp_path / "nowhere" / "a.ply", SPHERE)
    with pytest.raises(TypeError, match="a mesh must be"):
        write_mesh(path, "a mesh")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(PictureError, match="No space left"):
        write_mesh(path, SPHERE)
    monkeypatch.undo()
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["a.ply"]


@needs_users
def test_files_that_may_not_be_read_or_written():
    with no_root() as folder:
        path = put(folder, "a.ply", WHOLE[".ply"])
        path.chmod(0)
        with pytest.raises(MeshError, match="cannot be read: Permission denied"):
            read_mesh(path)
        folder.chmod(0o500)
        with pytest.raises(PictureError, match="no permission"):
            write_mesh(folder / "b.ply", SPHERE)


def faults_of(path: Path) -> list[str]:
    """What is wrong with how a file is read, beside trimesh, and with how it is written again."""
    found, theirs = read_mesh(path), trimesh.load(path, process=False)
    again = encode_mesh("a.ply", found.mesh, found.dtype)
    right = {
        "vertices": np.array_equal(found.vertices, theirs.vertices),
        "faces": np.array_equal(found.faces, theirs.faces),
        "length": len(again) <= path.stat().st_size + 200,  # the same numbers; headers differ
        "area": gr.metrics.area(found.mesh) > 0,
    }
    return [what for what, holds in right.items() if not holds]


def test_the_meshes_of_the_test_data(data_folder):
    faults = {path.name: faults_of(path) for path in (data_folder / "meshes").glob("*.ply")}
    assert {name: found for name, found in faults.items() if found} == {}
