"""The package as a stranger gets it: built, installed where nothing else is, and run from another folder.

A checkout finds ``kernels/`` beside the package whatever the wheel holds, so that only an installed wheel can show that
the kernels ship.
"""

from __future__ import annotations

import email
import importlib.metadata as metadata
import json
import os
import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ("gpureg", "kernels", "tests", "bench", "pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE", "Makefile")
EXTRAS = ("pocl", "warp")

pytest.importorskip("hatchling", reason="hatchling, which builds the package, is not installed (extra 'dev')")
pytestmark = pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="the tests run outside a checkout")


def outside() -> dict[str, str]:
    """An environment in which nothing points at the checkout or chooses a backend."""
    return {
        name: value for name, value in os.environ.items() if not name.startswith("PYTHON") and name != "GPUREG_BACKEND"
    }


def run(*command: object, cwd: Path) -> str:
    got = subprocess.run([str(part) for part in command], cwd=cwd, env=outside(), capture_output=True, text=True)
    assert got.returncode == 0, f"{command} ended with {got.returncode}:\n{got.stdout}\n{got.stderr}"
    return got.stdout


def build(source: Path, kind: str) -> Path:
    """Build with the backend that pyproject.toml names, as pip would; a folder above must not matter."""
    run(sys.executable, "-I", "-m", "hatchling", "build", "-t", kind, "-d", "dist", cwd=source)
    (made,) = (source / "dist").glob({"wheel": "*.whl", "sdist": "*.tar.gz"}[kind])
    return made


@pytest.fixture(scope="module")
def project(tmp_path_factory) -> Path:
    """A copy of the checkout, so that building leaves nothing in it; a space in its path on purpose."""
    folder = tmp_path_factory.mktemp("wheel") / "a copy"
    folder.mkdir()
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "results"))
        elif (ROOT / name).is_file():
            shutil.copy(ROOT / name, folder / name)
    return folder


@pytest.fixture(scope="module")
def wheel(project) -> Path:
    return build(project, "wheel")


@pytest.fixture(scope="module")
def sdist(project) -> Path:
    return build(project, "sdist")


def content(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_wheel_holds_the_kernels(wheel):
    held = content(wheel)
    kernels = [path for path in (ROOT / "kernels").rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    expected = {f"gpureg/_kernels/{path.relative_to(ROOT / 'kernels').as_posix()}": path for path in kernels}
    assert [name for name in sorted(expected) if held.get(name) != expected[name].read_bytes()] == []
    patterns = ("gpureg/_kernels/opencl/*.cl", "gpureg/_kernels/warp/*.py", "gpureg/_kernels/README.md")
    assert [pattern for pattern in patterns if not any(Path(name).match(pattern) for name in held)] == []


def test_wheel_holds_the_package_and_nothing_else(wheel):
    held = content(wheel)
    assert {path.relative_to(ROOT).as_posix() for path in (ROOT / "gpureg").rglob("*.py")} - set(held) == set()
    assert "gpureg/py.typed" in held
    top = {name.split("/")[0] for name in held}
    (info,) = (name for name in top if name.endswith(".dist-info"))
    assert top == {"gpureg", info}, "tests, benchmarks and kernels/ itself stay out"
    parts = {part for name in held for part in name.split("/")}
    assert not any(part in ("tests", "__pycache__") or part.startswith("test_") for part in parts)
    assert held[f"{info}/licenses/LICENSE"] == (ROOT / "LICENSE").read_bytes()
    assert b"gpureg = gpureg.cli:main" in held[f"{info}/entry_points.txt"]


def test_sdist_holds_what_its_tests_need(sdist):
    with tarfile.open(sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    needed = {"pyproject.toml", "LICENSE", "README.md", "gpureg/__init__.py", "tests/test_wheel.py"}
    assert needed - held == set()
    assert any(name.startswith("kernels/opencl/") for name in held)
    assert not any(name.startswith("gpureg/_kernels") for name in held), "kernels are there once"


def test_wheel_from_the_sdist_is_the_same(wheel, sdist, tmp_path):
    with tarfile.open(sdist) as archive:
        # Python 3.11 knows filters from its fourth patch release on
        safely = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
        archive.extractall(tmp_path, **safely)
    (unpacked,) = tmp_path.iterdir()
    assert content(build(unpacked, "wheel")) == content(wheel)


# --- installed --------------------------------------------------------------------------------------------------------


def needed(wheel: Path) -> Iterator[metadata.Distribution]:
    """The distributions that the wheel's own metadata asks for, and those that they ask for."""
    (text,) = (data for name, data in content(wheel).items() if name.endswith(".dist-info/METADATA"))
    todo = [(Requirement(line), EXTRAS) for line in email.message_from_bytes(text).get_all("Requires-Dist", [])]
    seen: set[tuple[str, str]] = set()
    while todo:
        requirement, extras = todo.pop()
        marker = requirement.marker
        plain = marker is None or marker.evaluate({"extra": ""})
        if not plain and not any(marker.evaluate({"extra": extra}) for extra in extras):
            continue
        key = (requirement.name.lower(), ",".join(sorted(requirement.extras)))
        if key in seen or requirement.name == "gpureg":
            continue
        seen.add(key)
        try:
            found = metadata.distribution(requirement.name)
        except metadata.PackageNotFoundError:
            if plain and extras == EXTRAS:
                pytest.fail(f"{requirement.name}, which gpureg requires, is not installed here")
            continue  # an extra that this machine does not have
        yield found
        todo += [(Requirement(line), tuple(requirement.extras)) for line in found.requires or ()]


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """The interpreter of a new environment that holds the wheel, and its declared dependencies, nothing more.

    The dependencies are links to those installed here, since fetching half a gigabyte again would show no more: what
    gpureg uses without declaring it is missing there.
    """
    folder = tmp_path_factory.mktemp("installed")
    environment, dependencies = folder / "environment", folder / "dependencies"
    venv.create(environment, with_pip=True)
    python = environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    run(python, "-I", "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", wheel, cwd=folder)
    dependencies.mkdir()
    for distribution in needed(wheel):
        for top in {file.parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
            link = dependencies / top
            if not link.exists():
                try:
                    link.symlink_to(Path(str(distribution.locate_file(top))).resolve())
                except OSError as error:
                    pytest.skip(f"this system makes no symbolic links: {error}")
    where = run(python, "-I", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder)
    Path(where.strip(), "dependencies.pth").write_text(f"{dependencies}\n", "utf-8")
    return python


def elsewhere(python: Path, program: str, cwd: Path) -> dict:
    """What a program prints as JSON, run by that interpreter alone (-I: no PYTHONPATH, no current folder)."""
    return json.loads(run(python, "-I", "-c", program, cwd=cwd).splitlines()[-1])


LOOK = """
import importlib.util, json, gpureg, gpureg.kernels
from gpureg import backends
print(json.dumps({
    "file": gpureg.__file__,
    "folder": str(gpureg.kernels.folder),
    "pytest": importlib.util.find_spec("pytest") is not None,
    "devices": [device.id for device in backends.devices()],
    "absent": backends.absent(),
}))
"""

# Two ways through the kernels: patch distances and grid sweeps, then gradient norms and energies on a stored graph.
WORK = """
import json, sys, numpy as np, gpureg as gr
image = np.random.default_rng(0).normal(100, 20, (37, 29)).astype(np.float32)
grid = gr.GridGraph((37, 29), 1, "cityblock")
def work(backend):
    patches = gr.denoise_image(image, sigma=20, backend=backend)
    flat = gr.regularize(image.ravel(), grid.to_graph(), p=1, lam=0.1, max_iter=20, backend=backend)
    return patches, flat.value, flat.backend
got, want = work(BACKEND), work("numpy")
print(json.dumps({
    "backend": got[2],
    "apart": [float(np.abs(a - b).max()) for a, b in zip(got[:2], want[:2])],
    "moved": [float(np.abs(a.ravel() - image.ravel()).max()) for a in got[:2]],
}))
"""


def test_the_installed_package_is_the_one_that_runs(installed, tmp_path):
    got = elsewhere(installed, LOOK, tmp_path)
    environment = installed.parent.parent.resolve()
    assert Path(got["file"]).resolve().is_relative_to(environment)
    assert Path(got["folder"]).name == "_kernels"
    assert Path(got["folder"]).resolve().is_relative_to(environment)
    assert not got["pytest"], "the environment sees more than the declared dependencies"
    assert "numpy" in got["devices"]


@pytest.mark.parametrize("backend", ["numpy", "opencl", "warp"])
def test_kernels_run_from_the_wheel(installed, tmp_path, backend):
    look = elsewhere(installed, LOOK, tmp_path)
    if backend in look["absent"]:
        required = os.environ.get("GPUREG_REQUIRE", "").split(",")
        assert backend not in required, look["absent"][backend]
        pytest.skip(f"{backend}: {look['absent'][backend]}")
    got = elsewhere(installed, WORK.replace("BACKEND", repr(backend)), tmp_path)
    assert got["backend"].startswith(backend)
    # Values of about 100 in float32; what is asked here is whether the kernels ran, and ran right.
    assert max(got["apart"]) < 0.01
    assert min(got["moved"]) > 10


def test_command_of_the_wheel(installed, tmp_path):
    command = installed.parent / ("gpureg.exe" if os.name == "nt" else "gpureg")
    table = run(command, "backends", cwd=tmp_path)
    assert "numpy" in table and "auto takes" in table
    pixels = np.random.default_rng(0).normal(128, 20, (40, 50)).clip(0, 255).astype(np.uint8)
    Image.fromarray(pixels).save(tmp_path / "in.png")
    assert len(run(command, "denoise", "in.png", "out.png", cwd=tmp_path).splitlines()) == 3
    with Image.open(tmp_path / "out.png") as opened:
        assert np.asarray(opened).std() < 0.7 * pixels.std()
    assert run(installed, "-I", "-m", "gpureg", "--version", cwd=tmp_path).startswith("gpureg, version")
