"""gpureg mesh, from the outside: a mesh file in, one with less noise or fewer vertices out, words, exit codes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from commands import call, done, environment, failed, on_terminal, process

import gpureg as gr
from gpureg.cli.mesh import mesh as command
from gpureg.meshes.reading import FORMATS, read_mesh
from gpureg.meshes.writing import write_mesh

SPHERE = trimesh.creation.icosphere(2)
FACES = np.array(SPHERE.faces)
EDGE = SPHERE.edges_unique_length.mean()
RNG = np.random.default_rng(3)
# in float32, so that every format holds them
CLEAN = np.array(SPHERE.vertices).astype(np.float32).astype(np.float64)
NOISY = (CLEAN * (1 + RNG.normal(0, 0.2 * EDGE, (len(CLEAN), 1)))).astype(np.float32).astype(np.float64)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def noisy() -> str:
    write_mesh("noisy.ply", (NOISY, FACES))
    return "noisy.ply"


def run(source: object, target: object, *options: object):
    backend = [] if "--backend" in options else ["--backend", "numpy"]
    return call("mesh", source, target, *backend, *options)


def report(source: object, target: object, *options: object) -> dict:
    result = run(source, target, "--json", *options)
    done(result)
    return json.loads(result.stdout, parse_constant=pytest.fail)


def files() -> set[str]:
    return {path.name for path in Path.cwd().iterdir()}


@pytest.mark.parametrize("extension", FORMATS)
def test_every_kind_of_file(extension):
    write_mesh(f"in{extension}", (NOISY, FACES))
    told = report(f"in{extension}", f"out{extension}")
    found, before = read_mesh(f"out{extension}"), read_mesh(f"in{extension}")
    expected = gr.denoise_mesh((before.vertices, before.faces), backend="numpy")[0]
    # as text to 16 digits, in a PLY or STL to the type of IN, which is float32 here
    off = 1e-15 if extension in (".obj", ".off") else 1e-7
    triangles = expected[before.faces]
    assert np.abs(found.vertices[found.faces] - triangles).max() <= off
    assert found.dtype == before.dtype
    # STL repeats vertices, which count once
    assert (told["vertices"], told["faces"]) == (len(NOISY), len(FACES))
    assert told["sigma"] == pytest.approx(gr.estimate_mesh_noise((NOISY, FACES)))
    assert told["sigma_estimated"] and told["closed"] == {"before": True, "after": True}
    assert told["volume"]["after"] == pytest.approx(gr.metrics.volume((expected, before.faces)))
    assert told["area"]["before"] == pytest.approx(gr.metrics.area((NOISY, FACES)))
    moved = np.linalg.norm(triangles - before.vertices[before.faces], axis=2)
    assert told["displacement"]["largest"] == pytest.approx(moved.max())


def test_one_format_becomes_another():
    """An STL's vertices, one to each corner, become one to each point."""
    write_mesh("in.stl", (NOISY, FACES))
    write_mesh("clean.stl", (CLEAN, FACES))
    told = report("in.stl", "out.ply", "--reference", "clean.stl")
    assert len(read_mesh("out.ply").vertices) == len(NOISY)
    # vertices correspond whatever their coordinates; 1e-5 is float32's share in normals that differ by degrees
    after = gr.denoise_mesh((NOISY, FACES), backend="numpy")[0]
    meshes = {"before": NOISY, "after": after}
    expected = {which: gr.metrics.normal_angle_error((x, FACES), (CLEAN, FACES)) for which, x in meshes.items()}
    angles = told["reference"]["normal_angle"]
    assert {which: angles[which] for which in meshes} == pytest.approx(expected, rel=1e-5)


def test_all_that_can_be_asked_for(noisy):
    told = report(
        noisy, "out.ply",
        "--filter", "positions", "--p", 1.5, "--lam", 2, "--weights", "inverse-square", "--norm", "edge",
        "--fix-border", "--max-displacement", 0.02, "--max-iter", 7, "--eps", 0.01, "--tol", 1e-9, "--dtype", "float64",
        "--sigma", 0.1,
    )  # fmt: skip
    expected = gr.denoise_mesh(
        (NOISY, FACES), filter="positions", p=1.5, lam=2, weights=gr.weights.inverse_distance(2), norm="edge",
        fix_border=True, max_displacement=0.02, max_iter=7, eps=0.01, tol=1e-9, dtype="float64", backend="numpy",
    )[0]  # fmt: skip
    assert np.array_equal(read_mesh("out.ply").vertices, expected.astype(np.float32))
    assert (told["p"], told["lam"], told["iterations"], told["sigma"]) == (1.5, 2.0, 7, 0.1)
    assert told["displacement"]["largest"] == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--weights", "cotangent"], {"weights": "cotangent"}),
        (["--weights", "inverse-distance"], {"weights": gr.weights.inverse_distance(1)}),
        (["--weights", "constant"], {}),
        (["--taubin"], {"taubin": True}),
    ],
    ids=str,
)
def test_positions_in_other_ways(noisy, options, named):
    assert run(noisy, "out.ply", "--filter", "positions", *options, "--quiet").output == ""
    expected = gr.denoise_mesh((NOISY, FACES), filter="positions", backend="numpy", **named)[0]
    assert np.array_equal(read_mesh("out.ply").vertices, expected.astype(np.float32))


def test_the_words(noisy):
    write_mesh("clean.ply", (CLEAN, FACES))
    words = done(run(noisy, "out.ply", "--reference", "clean.ply")).splitlines()
    assert [line.split()[0] for line in words] == ["noise", "filter", "quality", "errors", "done"]
    after = read_mesh("out.ply")
    before, now = (gr.metrics.normal_angle_error((v, FACES), (CLEAN, FACES)) for v in (NOISY, after.vertices))
    assert f"normals {before:.2f} -> {now:.2f} degrees" in words[3]
    distance = gr.metrics.hausdorff((after.vertices, FACES), (CLEAN, FACES))
    assert words[3].endswith(f"Hausdorff distance {distance:.3g}")
    assert words[2].startswith("quality  volume ") and "largest displacement" in words[2]
    assert words[4].endswith(f"{len(NOISY)} vertices, {len(FACES)} faces -> out.ply")
    write_mesh("open.ply", (NOISY, FACES[40:]))
    assert "\nquality  open; volume inside " in done(run("open.ply", "out.ply"))
    write_mesh("box.ply", trimesh.creation.box().subdivide().subdivide())
    words = done(run("box.ply", "out.ply"))
    assert "there is no noise to remove" in words and " on " not in words.splitlines()[-1]


def test_fewer_vertices(noisy):
    write_mesh("clean.ply", (CLEAN, FACES))
    told = report("clean.ply", "out.ply", "--n-vertices", 40, "--reference", noisy)
    found = read_mesh("out.ply")
    vertices, faces = gr.simplify_mesh((CLEAN, FACES), n_vertices=40, backend="numpy")
    assert np.array_equal(found.vertices, vertices.astype(np.float32)) and np.array_equal(found.faces, faces)
    assert told["vertices"] == {"before": len(CLEAN), "after": 40}
    assert told["faces"]["after"] == len(faces)
    assert told["hausdorff"] == pytest.approx(gr.metrics.hausdorff((vertices, faces), (CLEAN, FACES)))
    assert set(told["reference"]) == {"file", "hausdorff"}  # its faces are others
    words = done(run("clean.ply", "out.ply", "--simplify", "--p", 0.5, "--lam", 0.01, "--max-iter", 100))
    vertices, faces = gr.simplify_mesh((CLEAN, FACES), p=0.5, lam=0.01, max_iter=100, backend="numpy")
    assert f"\nleft     {len(vertices)} of {len(CLEAN)} vertices" in words
    assert len(read_mesh("out.ply").vertices) == len(vertices)


@pytest.fixture
def valued():
    """A file with noisy values at its vertices, and the mesh in it."""
    mesh = trimesh.Trimesh(CLEAN, FACES, process=False)
    height = CLEAN[:, 2]
    mesh.visual.vertex_colors = np.clip(128 + 80 * height[:, None] + RNG.normal(0, 10, (len(CLEAN), 4)), 0, 255)
    mesh.vertex_attributes["depth"] = (height + RNG.normal(0, 0.1, len(CLEAN))).astype(np.float32)
    mesh.vertex_attributes["count"] = np.rint(100 * height + RNG.normal(0, 9, len(CLEAN))).astype(np.int16)
    write_mesh("in.ply", mesh)
    return "in.ply", read_mesh("in.ply").mesh


@pytest.mark.parametrize("name", ["depth", "count", "colours"])
def test_values_at_the_vertices(valued, name):
    path, kept = valued
    told = report(path, "out.ply", "--values", name)
    found = read_mesh("out.ply").mesh
    assert np.array_equal(found.vertices, CLEAN)
    before = kept.visual.vertex_colors[:, :3] if name == "colours" else kept.vertex_attributes[name]
    after = found.visual.vertex_colors[:, :3] if name == "colours" else found.vertex_attributes[name]
    expected = gr.denoise_mesh((CLEAN, FACES), values=before.astype(float), backend="numpy")
    expected = np.rint(expected) if name != "depth" else expected.astype(np.float32)
    assert np.array_equal(after, expected) and after.dtype == before.dtype
    assert np.array_equal(found.visual.vertex_colors[:, 3], kept.visual.vertex_colors[:, 3])
    others = {"depth", "count"} - {name}
    assert all(np.array_equal(found.vertex_attributes[x], kept.vertex_attributes[x]) for x in others)
    assert told["method"] == "values" and "displacement" not in told


def test_values_that_are_not_there(valued):
    failed(run("in.ply", "no.ply", "--values", "heat"), 1, "no values 'heat'", "colours, depth, count")
    assert "no.ply" not in files()


def test_a_picture_of_both(noisy):
    pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")
    told = report(noisy, "out.ply", "--picture", "a.png", "--view", "30,20", "--up", "z")
    assert told["picture"] == "a.png"
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")
    assert "\npicture  b.png" in done(run(noisy, "out.ply", "--simplify", "--picture", "b.png", "--reference", noisy))


def test_a_picture_without_matplotlib(noisy):
    """Said before any work, and without a trace."""
    code = "import sys; sys.modules['matplotlib'] = None; from gpureg.cli import main; main()"
    result = process("mesh", noisy, "out.ply", "--picture", "a.png", code=code)
    assert result.returncode == 1
    assert "pip install 'gpureg[plot]'" in result.stderr and "Traceback" not in result.stderr
    assert files() == {noisy}


def test_out_may_be_in(noisy):
    write_mesh("other.ply", (NOISY, FACES))
    done(run("other.ply", "other.ply"))
    done(run(noisy, "out.ply"))
    assert Path("other.ply").read_bytes() == Path("out.ply").read_bytes() != Path(noisy).read_bytes()


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--p", "0"], 2, "p must be"),
        (["--lam", "-1"], 2, "lam must be"),
        (["--sigma", "-1"], 2, "sigma must be finite and >= 0"),
        (["--filter", "edges"], 2, "'edges' is not one of"),
        (["--taubin"], 2, 'needs filter="positions"'),
        (["--taubin", "--filter", "positions", "--p", "1"], 2, "has no p"),
        (["--weights", "cotangent"], 2, "needs --filter positions"),
        (["--values", "colours"], 1, "it has none"),
        (["--values", "colours", "--filter", "positions"], 2, "leave --filter out"),
        (["--simplify", "--filter", "normals"], 2, "--filter is for denoising"),
        (["--n-vertices", "50", "--max-displacement", "1"], 2, "--max-displacement is for denoising"),
        (["--n-vertices", "3"], 2, "at least 4"),
        (["--view", "30,20"], 2, "give --picture too"),
        (["--view", "front", "--picture", "a.png"], 2, "neither auto nor two angles"),
        (["--view", "0,100", "--picture", "a.png"], 2, "in -90..90"),
        (["--picture", "a.txt"], 2, "the extension must be one of"),
        (["--picture", "nowhere/a.png"], 1, "nowhere"),
        (["--picture", "in.ply"], 2, "extension"),
        (["--reference", "none.ply"], 1, "none.ply: no such file"),
        (["--reference", "out.ply"], 2, "OUT out.ply would overwrite out.ply, which is read"),
        (["--backend", "abacus"], 2, "abacus"),
        (["--solver", "certified", "--p", "0.5"], 2, "p >= 1"),
    ],
)
def test_wrong_calls_leave_no_file(options, code, words):
    write_mesh("in.ply", (NOISY, FACES))
    Path("out.ply").write_bytes(b"old")
    failed(run("in.ply", "out.ply", *options), code, words)
    assert files() == {"in.ply", "out.ply"}
    assert Path("out.ply").read_bytes() == b"old"


def test_broken_files_get_a_sentence(noisy):
    Path("cut.ply").write_bytes(Path(noisy).read_bytes()[:-9])
    failed(run("cut.ply", "out.ply"), 1, "gpureg: cut.ply is damaged, truncated")
    failed(run("none.obj", "out.ply"), 1, "no such file")
    failed(run(noisy, "out.vtk"), 1, "one of .ply, .obj, .off, .stl")
    failed(run(noisy, "nowhere/out.ply"), 1, "does not exist")
    assert files() == {noisy, "cut.ply"}


def test_a_failure_at_the_last_file_leaves_none(noisy, monkeypatch):
    """The disk is full when the picture is written: the mesh is not there either."""
    figure = pytest.importorskip("matplotlib.figure", reason="matplotlib, of the extra 'plot', is not installed")

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(figure.Figure, "savefig", full)
    failed(run(noisy, "out.ply", "--picture", "a.png"), 1, "a.png cannot be written: No space left")
    assert files() == {noisy}


@pytest.mark.skipif(sys.platform == "win32", reason="sends a POSIX signal")
def test_an_interruption_writes_nothing(noisy):
    start = [sys.executable, "-m", "gpureg", "mesh", noisy, "out.ply", "--backend", "numpy", "--max-iter", "100000000"]
    with subprocess.Popen(start, env=environment(), stderr=subprocess.PIPE, text=True) as running:
        time.sleep(2.5)  # by then it iterates; before that an interrupt ends it as well
        assert running.poll() is None
        os.kill(running.pid, signal.SIGINT)
        try:
            _, said = running.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            # on a busy machine the first one comes while trimesh is imported, whose `except BaseException` swallow it
            os.kill(running.pid, signal.SIGINT)
            _, said = running.communicate(timeout=60)
    assert running.returncode == 130
    assert "interrupted, nothing was written" in said and "Traceback" not in said
    assert files() == {noisy}


@pytest.mark.parametrize("columns", [80, 50])
def test_lines_fit_a_terminal(noisy, columns):
    code, shown, _ = on_terminal(
        *("mesh", noisy, "out.ply", "--backend", "numpy", "--no-progress"), columns=columns, cwd=Path.cwd()
    )
    assert code == 0
    lines = shown.decode().splitlines()
    assert lines[0].startswith("noise    sigma = ")
    assert max(map(len, lines)) < columns


def test_help_names_every_option():
    words = done(call("mesh", "--help"))
    names = [(*parameter.opts, parameter.metavar or "-") for parameter in command.params]
    assert [options for options in names if not any(option in words for option in options)] == []
