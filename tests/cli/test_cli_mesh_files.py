"""gpureg mesh on files of many kinds, and on many files: what is kept, what is named, what a failure leaves."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from commands import call, done, failed

from gpureg.meshes.beside import KEY
from gpureg.meshes.reading import read_mesh
from gpureg.meshes.writing import write_mesh

SPHERE = trimesh.creation.icosphere(2)
NOISY = SPHERE.vertices * (1 + 0.04 * np.random.default_rng(2).normal(0, 1, (len(SPHERE.vertices), 1)))
QUADS = "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nv 1 1 0.1\nv 2 1 0\nv 0 2 0\nv 1 2 0\nv 2 2 0\n"
QUADS = f"mtllib a.mtl\n{QUADS}vn 0 0 1\nusemtl red\nf 1//1 2//1 5//1 4//1\nf 2//1 3//1 6//1 5//1\n"
QUADS += "usemtl blue\nf 4//1 5//1 8//1 7//1\nf 5//1 6//1 9//1 8//1\n"


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_mesh("a.ply", (NOISY, SPHERE.faces))
    write_mesh("b.ply", (2 * NOISY, SPHERE.faces))


def run(*arguments: object):
    return call("mesh", *arguments, "--backend", "numpy", "--filter", "positions")


def notes(*arguments: object) -> list[str]:
    result = run(*arguments, "--json")
    done(result)
    return json.loads(result.stdout)["notes"]


def test_many_files_go_to_a_folder():
    Path("broken.ply").write_text("ply\n")
    result = run("a.ply", "broken.ply", "b.ply", "out", "--reference", "a.ply")
    assert result.exit_code == 1
    assert "1 of 3 files failed:\n  broken.ply is damaged" in result.stderr
    assert "done     2 of 3 files" in result.stdout
    assert sorted(path.name for path in Path("out").iterdir()) == ["a.ply", "b.ply"]
    run("a.ply", "alone.ply")
    assert Path("alone.ply").read_bytes() == Path("out/a.ply").read_bytes()
    done(run("[ab].ply", "new"))
    assert sorted(path.name for path in Path("new").iterdir()) == ["a.ply", "b.ply"]
    told = json.loads(run("a.ply", "b.ply", "out", "--json").stdout)
    assert [one["input"] for one in told["files"]] == ["a.ply", "b.ply"] and told["failed"] == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["a.ply"], "Missing OUT: where to write a.ply?"),
        (["a.ply", "b.ply", "c.ply"], "need a folder as OUT"),
        (["a.ply", "b.ply", "."], "would overwrite"),
        (["a.ply", "b.ply", "out", "--p", "0"], "p must be finite and > 0, got 0.0"),
        (["a.ply", "b.ply", "out", "--picture", "a.png"], "--picture is one file: it needs a single IN"),
    ],
)
def test_wrong_calls_for_many_files(arguments, words):
    before = sorted(path.name for path in Path().iterdir())
    failed(run(*arguments), 2, words)
    assert sorted(path.name for path in Path().iterdir()) == before


def test_quads_materials_and_normals_stay():
    Path("in.obj").write_text(QUADS)
    assert notes("in.obj", "out.obj", "--lam", 1) == []
    lines = Path("out.obj").read_text().splitlines()
    assert [line for line in lines if line.startswith(("mtllib", "usemtl"))] == [
        "mtllib a.mtl", "usemtl red", "usemtl blue"
    ]  # fmt: skip
    assert [len(line.split()) for line in lines if line.startswith("f")] == [5] * 4
    # computed again, one at each vertex: they lean away from the middle, which is a little lower now
    beside = read_mesh("out.obj").mesh.metadata[KEY]
    assert len(np.unique(beside.normal_of)) == 9 and beside.normals[:, 2].max() <= 1
    assert (beside.normals[:, 2] < 0.99999).sum() == 8
    assert any("4 polygons are cut" in note for note in notes("in.obj", "out.stl", "--lam", 1))
    Path("folder").mkdir()
    assert notes("in.obj", "folder/out.obj", "--lam", 1) == ["OUT needs a.mtl beside it: copy what lies beside IN"]


def test_simplified_files_name_what_is_gone():
    Path("in.obj").write_text(QUADS)
    result = call("mesh", "in.obj", "out.obj", "--n-vertices", 4, "--backend", "numpy")
    assert "note     the new mesh lost 4 polygons of more than three corners, which are triangles now" in done(result)
    assert read_mesh("out.obj").mesh.metadata[KEY].names["material"] == ("red", "blue")


def test_digits_beside_what_was_changed():
    """In metres on a map: STL holds float32, and so would a PLY like IN."""
    far = 20 * NOISY + np.array([4.5e6, 5e5, 0])
    write_mesh("far.ply", (far, SPHERE.faces))
    (note,) = notes("far.ply", "far.stl")
    assert "of what was changed" in note and "of the mean edge" in note
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write_mesh("far32.ply", (far, SPHERE.faces), dtype=np.float32)
    (note,) = notes("far32.ply", "out.ply")
    assert "float64 now" in note
    assert read_mesh("out.ply").dtype == np.float64
    assert notes("a.ply", "a.stl") == []


def test_a_texture_that_is_not_there():
    data = Path("a.ply").read_bytes().replace(b"element vertex", b"comment TextureFile skin.png\nelement vertex", 1)
    Path("in.ply").write_bytes(data)
    result = run("in.ply", "out.ply")
    assert "Traceback" not in done(result)
    assert b"\ncomment TextureFile skin.png\n" in Path("out.ply").read_bytes()


def test_values_leave_the_normals_of_the_file():
    sphere = trimesh.Trimesh(NOISY, SPHERE.faces, process=False)
    sphere.vertex_attributes["heat"] = NOISY[:, 2]
    write_mesh("plain.ply", sphere)
    found = read_mesh("plain.ply").mesh
    text = ["ply", "format ascii 1.0", f"element vertex {len(NOISY)}"]
    text += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz", "heat")]
    text += [f"element face {len(found.faces)}", "property list uchar int vertex_indices", "end_header"]
    rows = np.column_stack([NOISY, np.tile([0, 0.6, 0.8], (len(NOISY), 1)), NOISY[:, 2]])
    text += [" ".join(map(str, row)) for row in rows] + ["3 {} {} {}".format(*face) for face in found.faces]
    Path("in.ply").write_text("\n".join(text))
    done(call("mesh", "in.ply", "out.ply", "--values", "heat", "--backend", "numpy"))
    normals = read_mesh("out.ply").mesh.metadata[KEY]
    assert np.abs(normals.normals - [0, 0.6, 0.8]).max() < 1e-7


def test_a_failure_keeps_the_old_file():
    Path("out.glb").write_bytes(b"old")
    failed(run("a.ply", "out.glb", "--p", 0), 2, "p must be")
    assert Path("out.glb").read_bytes() == b"old"
    Path("nan.obj").write_text("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n")
    failed(run("nan.obj", "out.glb"), 1, "nan.obj: vertices must be finite, row 1 is", "belongs to 1 faces")
    assert Path("out.glb").read_bytes() == b"old"


def test_vertices_that_are_not_finite_and_not_used():
    Path("in.obj").write_text(QUADS.replace("vn 0 0 1", "v nan 0 0\nvn 0 0 1"))
    assert notes("in.obj", "out.obj", "--lam", 1) == [
        "1 vertices are not finite; they belong to no face, and are left out"
    ]
