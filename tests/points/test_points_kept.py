"""What files of points hold beside the positions: kept, computed again, or named; PCD files."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import gpureg as gr
from gpureg.points.files import POINT_FORMATS, lost_in

RNG = np.random.default_rng(8)
POINTS = RNG.normal(size=(40, 3))
NORMALS = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
HEADER = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z rgb normal_x normal_y normal_z _ index
SIZE 4 4 4 4 4 4 4 1 8
TYPE F F F F F F F U U
COUNT 1 1 1 1 1 1 1 4 1
WIDTH 20
HEIGHT 2
VIEWPOINT 1 2 3 1 0 0 0
POINTS 40
"""


def pcd_of(how: str) -> bytes:
    """A raster of points with colours, normals, padding and integers of 64 bits, as PCL writes them."""
    axes = [(name, "<f4") for name in ("x", "y", "z", "rgb", "a", "b", "c")]
    rows = np.zeros(40, [*axes, ("pad", "u1", 4), ("index", "<u8")])
    for k, axis in enumerate("xyz"):
        rows[axis], rows["abc"[k]] = POINTS[:, k], NORMALS[:, k]
    rows["index"] = 2**60 + np.arange(40)
    rows["rgb"] = (255 << 16) * 1e-40
    if how == "binary":
        return HEADER.encode() + b"DATA binary\n" + rows.tobytes()
    lines = []
    for row in rows:
        words = [repr(float(row[name])) for name, _ in axes] + ["0"] * 4 + [str(int(row["index"]))]
        lines.append(" ".join(words))
    return HEADER.encode() + b"DATA ascii\n" + "\n".join(lines).encode()


@pytest.mark.parametrize("how", ["ascii", "binary"])
def test_pcd_of_others(tmp_path, how):
    path = tmp_path / "a.pcd"
    path.write_bytes(pcd_of(how))
    found = gr.read_points(path)
    assert np.array_equal(found.points, POINTS.astype(np.float32)) and found.dtype == np.float32
    assert list(found.columns) == ["rgb", "normal_x", "normal_y", "normal_z", "index"]
    assert found.columns["index"].tolist() == [2**60 + k for k in range(40)]
    assert found.normals == ["normal_x", "normal_y", "normal_z"]
    assert lost_in("b.pcd", found) == ["the 20 x 2 raster of the points, which are a list now"]
    gr.write_points(tmp_path / "b.pcd", found.points, found.columns, like=found)
    again = gr.read_points(tmp_path / "b.pcd")
    assert np.array_equal(again.points, found.points) and again.comments == found.comments
    assert b"VIEWPOINT 1 2 3 1 0 0 0\n" in (tmp_path / "b.pcd").read_bytes()
    # the bits of colours that are packed into a float
    assert again.columns["rgb"].tobytes() == found.columns["rgb"].tobytes()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (pcd_of("binary")[:-9], "truncated: it announces 40 points, and has 39"),
        (pcd_of("ascii").rsplit(b"\n", 1)[0], "truncated: it announces 40 points, and has 39"),
        (pcd_of("binary").replace(b"DATA binary\n", b"DATA binary_compressed\n"), "is compressed"),
        (pcd_of("ascii").replace(b"FIELDS x", b"FIELDS u"), "holds no points x, y, z"),
        (pcd_of("ascii").replace(b"POINTS 40\n", b""), "no PCD file"),
        (b"P6 1 1\n", "no PCD file"),
        (HEADER.encode() + b"DATA ascii\n" + b"1 2 3 x 0 0 0 0 0 0 0 0\n" * 40, "damaged: could not convert"),
    ],
)
def test_broken_pcd(tmp_path, content, words):
    (tmp_path / "a.pcd").write_bytes(content)
    with pytest.raises(gr.PointsError, match=words):
        gr.read_points(tmp_path / "a.pcd")


def test_what_ply_holds_beside(tmp_path):
    """Comments stay; other elements, lists and properties of faces are named."""
    text = """ply
format ascii 1.0
comment made by hand
comment TextureFile none.png
obj_info scanned in May
element vertex 4
property float x
property float y
property float z
property uchar red
element face 2
property list uchar int vertex_indices
property int part
element edge 1
property int vertex1
property int vertex2
end_header
0 0 0 1
1 0 0 2
1 1 0 3
0 1 0 4
3 0 1 2 7
3 0 2 3 8
0 1
"""
    path = tmp_path / "a.ply"
    path.write_text(text, "ascii")
    found = gr.read_points(path)
    assert found.columns["red"].tolist() == [1, 2, 3, 4] and found.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert lost_in("b.ply", found) == ["the 1 elements 'edge'", "the property 'part' of faces"]
    gr.write_points(path, found.points, found.columns, like=found)
    again = gr.read_points(path)
    assert again.comments == ("comment made by hand", "comment TextureFile none.png", "obj_info scanned in May")
    assert lost_in("b.xyz", again) == ["2 triangles", "the names of the columns red"]
    assert np.array_equal(trimesh.load(path, process=False).faces, found.faces)


def test_comments_and_arrays(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# from the garden\nx,y\n1,2\n3,4 # the tree\n", "utf-8")
    found = gr.read_points(path)
    assert lost_in(path, found) == ["comments behind numbers"]
    gr.write_points(path, found.points, like=found)
    assert path.read_text("utf-8") == "# from the garden\nx,y\n1.0,2.0\n3.0,4.0\n"
    np.savez(tmp_path / "a.npz", points=POINTS, camera=np.eye(3))
    found = gr.read_points(tmp_path / "a.npz")
    assert list(found.others) == ["camera"] and lost_in("b.csv", found) == ["the array 'camera'"]
    gr.write_points(tmp_path / "b.npz", found.points, like=found)
    with np.load(tmp_path / "b.npz") as file:
        assert np.array_equal(file["camera"], np.eye(3))


@pytest.mark.parametrize("kind", POINT_FORMATS)
def test_normals_are_known(tmp_path, kind):
    columns = dict(zip(("nx", "ny", "nz"), NORMALS.T, strict=True))
    gr.write_points(tmp_path / f"a{kind}", POINTS, columns)
    found = gr.read_points(tmp_path / f"a{kind}")
    expected = ["column_4", "column_5", "column_6"] if kind == ".xyz" else ["nx", "ny", "nz"]
    assert found.normals == expected
    # intensities and colours are none
    gr.write_points(tmp_path / f"b{kind}", POINTS, dict(zip("abc", RNG.random((3, 40)), strict=True)))
    assert gr.read_points(tmp_path / f"b{kind}").normals == []


def test_normals_as_an_array(tmp_path):
    np.savez(tmp_path / "a.npz", points=POINTS, Normals=NORMALS)
    assert gr.read_points(tmp_path / "a.npz").normals == ["Normals"]
