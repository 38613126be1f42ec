"""Points in and out of files, and tables of numbers in text."""

from __future__ import annotations

import gzip
import io

import numpy as np
import pytest
import trimesh

import gpureg as gr
from gpureg.files.table import encode_table, read_table
from gpureg.points.files import POINT_FORMATS, encode_points

RNG = np.random.default_rng(4)
POINTS = RNG.normal(size=(50, 3))
COLUMNS = {
    "red": RNG.integers(0, 256, 50).astype(np.uint8),
    "label": np.arange(50),
    "intensity": RNG.random(50),
    "single": RNG.random(50).astype(np.float32),
}


@pytest.mark.parametrize("kind", POINT_FORMATS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_there_and_back(tmp_path, kind, dtype):
    """To the bit, in every format, and again from what was read."""
    path = tmp_path / f"a{kind}"
    given = POINTS.astype(dtype)
    gr.write_points(path, given, COLUMNS)
    found = gr.read_points(path)
    assert np.array_equal(found.points.astype(dtype), given)
    told = list(found.columns.values())
    assert len(told) == 4
    pairs = zip(COLUMNS.items(), told, strict=True)
    assert [name for (name, column), values in pairs if not np.array_equal(values.astype(column.dtype), column)] == []
    if kind != ".xyz":
        assert list(found.columns) == list(COLUMNS)
    if kind in (".ply", ".npz"):
        assert found.dtype == dtype
        # integers of 64 bits are none of a PLY
        assert [v.dtype for v in told] == [np.uint8, np.int32 if kind == ".ply" else np.int64, np.float64, np.float32]
    again = tmp_path / f"b{kind}"
    gr.write_points(again, found.points, found.columns, like=found)
    second = gr.read_points(again)
    assert np.array_equal(second.points, found.points)
    assert encode_points(path, found.points, found.columns, like=found) == encode_points(
        path, second.points, second.columns, like=second
    )


@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_ply_of_others(tmp_path, encoding):
    """What trimesh and PCL write, in text and binary."""
    cloud = trimesh.PointCloud(POINTS, colors=RNG.integers(0, 256, (50, 4), np.uint8))
    path = tmp_path / "cloud.ply"
    path.write_bytes(trimesh.exchange.ply.export_ply(cloud, encoding=encoding))
    found = gr.read_points(path)
    assert np.allclose(found.points, POINTS, atol=1e-6)
    assert list(found.columns)[:3] == ["red", "green", "blue"]
    assert np.array_equal(np.stack(list(found.columns.values()), 1)[:, :3], cloud.colors[:, :3])


def test_faces_of_a_mesh_go_along(tmp_path):
    gr.write_mesh(tmp_path / "mesh.ply", trimesh.creation.icosphere(1))
    found = gr.read_points(tmp_path / "mesh.ply")
    assert found.faces.shape == (80, 3)
    gr.write_points(tmp_path / "again.ply", found.points + 1, like=found)
    mesh = gr.read_mesh(tmp_path / "again.ply")
    assert np.array_equal(mesh.faces, found.faces) and np.allclose(mesh.vertices, found.points + 1)


@pytest.mark.parametrize(
    ("text", "points", "columns"),
    [
        ("x,y\n1,2\n3,4\n", [[1, 2], [3, 4]], {}),
        ("1 2 3\n4 5 6\n", [[1, 2, 3], [4, 5, 6]], {}),
        ("# a comment\n1;2\n\n3;4 # another\n", [[1, 2], [3, 4]], {}),
        ("label\tY\tX\n7\t2\t1\n", [[1, 2]], {"label": [7]}),
        ("\ufeffx,y,z,w\r\n1,2,3,4.5\r\n", [[1, 2, 3]], {"w": [4.5]}),
        ("a,b,class\n1,2,0\n", [[1, 2]], {"class": [0]}),
        ('"x","y"\n1e3,-2.5\n', [[1000, -2.5]], {}),
    ],
)
def test_text(tmp_path, text, points, columns):
    path = tmp_path / "a.csv"
    path.write_text(text, "utf-8", newline="")
    found = gr.read_points(path)
    assert found.points.tolist() == points
    assert {name: values.tolist() for name, values in found.columns.items()} == columns
    packed = tmp_path / "a.csv.gz"
    packed.write_bytes(gzip.compress(text.encode()))
    assert gr.read_points(packed).points.tolist() == points


def test_columns_are_chosen(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,u,v\n1,2,3\n4,5,6\n", "utf-8")
    assert gr.read_points(path).points.shape == (2, 3)
    found = gr.read_points(path, columns=("v", "t"))
    assert found.points.tolist() == [[3, 1], [6, 4]] and found.columns["u"].tolist() == [2, 5]
    gr.write_points(tmp_path / "b.csv", found.points, found.columns, like=found)
    assert (tmp_path / "b.csv").read_text("utf-8") == "v,t,u\n3.0,1.0,2\n6.0,4.0,5\n"


def test_xyz_with_more(tmp_path):
    path = tmp_path / "a.xyz"
    path.write_text("0 0 1 255 0 0.5\n1 0 0 0 255 0.25\n", "utf-8")
    found = gr.read_points(path)
    assert found.points.tolist() == [[0, 0, 1], [1, 0, 0]]
    assert {name: values.tolist() for name, values in found.columns.items()} == {
        "column_4": [255, 0],
        "column_5": [0, 255],
        "column_6": [0.5, 0.25],
    }
    gr.write_points(path, found.points, found.columns, like=found)
    assert path.read_text("utf-8") == "0.0 0.0 1.0 255 0 0.5\n1.0 0.0 0.0 0 255 0.25\n"


def test_npz(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, features=POINTS, labels=np.arange(50), about=np.array([1, 2]))
    found = gr.read_points(path)
    assert np.array_equal(found.points, POINTS) and list(found.columns) == ["labels"]
    gr.write_points(path, found.points, found.columns | {"colour": RNG.random((50, 3))}, like=found)
    with np.load(path) as file:
        assert sorted(file.files) == ["about", "colour", "features", "labels"]


def test_tables(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("x y\n1 2\n3 4\n\n\n5 6.5\n", "utf-8")
    table = read_table(path)
    assert table.names == ("x", "y") and table.delimiter == " "
    assert table.blocks.tolist() == [0, 0, 1] and table.whole.tolist() == [True, False]
    columns = [np.array([1, 2]), np.array([0.1, 1 / 3]), np.array([0.1, 0.2], np.float32)]
    assert encode_table(columns, ["a", "b", "c"], ",", [1]) == b"a,b,c\n1,0.1,0.1\n\n2,0.3333333333333333,0.2\n"


def _npz(**arrays) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", b"", "is empty"),
        ("a.csv", b"x,y\n", "holds no numbers"),
        ("a.csv", b"x,y\n1,2\n3\n", "line 3: 1 numbers where the first line has 2"),
        ("a.csv", b"x,y\n1,2\n3,east\n", "line 3: 'east' is not a number"),
        ("a.csv", b"x,y,z\n1,2\n", "its header names 3 columns, and its lines have 2"),
        ("a.csv", b"x,y\n1,nan\n", "point 0 is not finite"),
        ("a.csv", b"label\n1\n", "no column of coordinates"),
        ("a.csv", b"\xff\xfe\x00", "is not text in UTF-8"),
        ("a.csv.gz", b"x,y\n1,2\n", "not a gzip file"),
        ("a.npz", b"x,y\n", "damaged, or no NPZ"),
        ("a.npz", _npz(a=np.ones((2, 2)), b=np.ones((2, 2))), "needs an array 'points'"),
        ("a.npz", _npz(points=np.ones(3)), "needs an array 'points'"),
        ("a.ply", b"ply\nnothing", "damaged, truncated or no PLY"),
        ("a.ply", encode_points("a.ply", POINTS)[:-40], "truncated"),
        ("a.las", b"LASF", "the extension of points must be one of"),
        (".csv", b"1,2\n", "the extension of points must be one of"),
    ],
)
def test_broken_files(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(gr.PointsError, match=words):
        gr.read_points(path)


def test_files_that_are_not_there(tmp_path):
    for kind in POINT_FORMATS:
        with pytest.raises(gr.PointsError, match="no such file"):
            gr.read_points(tmp_path / f"a{kind}")
    (tmp_path / "b.ply").mkdir()
    with pytest.raises(gr.PointsError, match="is a folder"):
        gr.read_points(tmp_path / "b.ply")


@pytest.mark.parametrize(
    ("name", "points", "columns", "words"),
    [
        ("a.ply", POINTS[:, :2], {}, "three coordinates, got 2"),
        ("a.xyz", POINTS[:, :1], {}, "three coordinates, got 1"),
        ("a.csv", POINTS[0], {}, "must be numbers of shape"),
        ("a.csv", POINTS, {"a": np.ones(3)}, "must have 50 rows"),
        ("a.csv", POINTS, {"a": np.ones((50, 2))}, "one number per point and column"),
        ("a.ply", POINTS, {"two words": np.ones(50)}, "must be one word"),
        ("a.txt", POINTS, {}, "the extension of points"),
    ],
)
def test_what_cannot_be_written(tmp_path, name, points, columns, words):
    with pytest.raises(gr.PointsError, match=words):
        gr.write_points(tmp_path / name, points, columns)
    assert not list(tmp_path.iterdir())


def test_columns_are_of_text(tmp_path):
    gr.write_points(tmp_path / "a.ply", POINTS)
    with pytest.raises(gr.PointsError, match="columns are chosen in text"):
        gr.read_points(tmp_path / "a.ply", columns=("x",))
    (tmp_path / "a.csv").write_text("1,2\n", "utf-8")
    with pytest.raises(gr.PointsError, match="no header"):
        gr.read_points(tmp_path / "a.csv", columns=("x",))
    (tmp_path / "a.csv").write_text("a,b\n1,2\n", "utf-8")
    with pytest.raises(gr.PointsError, match="no column 'x'; it has a, b"):
        gr.read_points(tmp_path / "a.csv", columns=("x",))
