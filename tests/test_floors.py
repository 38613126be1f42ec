"""The house has floors: a file of gpureg imports lower floors only, and each heavy library has one owner."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import gpureg
from gpureg import kernels

PACKAGE = Path(gpureg.__file__).parent

# The floor of each module or sub-package of gpureg, whether it is built yet or not. A sub-package is one room: its
# files may import each other. `problem`, `regularization` and `plan` stand half a floor above their neighbours, on whom
# they rest.
FLOORS: dict[str, int] = {
    "_version": 0,
    "arrays": 0,
    "checks": 0,
    "kernels": 0,
    "progress": 0,
    "files": 1,
    "graphs": 2,
    "backends": 3,
    "noise": 3,
    "shapes": 3,
    "metrics": 4,
    "weights": 4,
    "model": 5,
    "solvers": 6,
    "spectral": 6,
    "operators": 7,
    "regularization": 7,
    "curves": 8,
    "meshes": 8,
    "points": 8,
    "tuning": 8,
    "images": 9,
    "plot": 9,
    "presets": 10,
    "regions": 10,
    "figures": 11,
    "jobs": 11,
    "skimage": 11,
    "sources": 11,
    "cli": 12,
    "__main__": 13,
}

# Who may import a library that is heavy, optional, or both; names of files below gpureg/, and kernels/ for itself.
OWNERS: dict[str, tuple[str, ...]] = {
    "pyopencl": ("backends/opencl/",),
    "warp": ("backends/warp/", "kernels/warp/"),
    "matplotlib": ("plot/", "figures/sheet.py", "cli/figures.py"),
    "skimage": ("plot/", "cli/demo.py", "cli/figures.py", "figures/"),
    "trimesh": ("metrics.py", "meshes/reading.py", "meshes/writing.py", "points/files.py"),
    "PIL": ("files/pictures.py",),
    "tifffile": ("files/tiff.py",),
    "imagecodecs": ("files/pictures.py",),
    "networkx": ("graphs/networkx.py",),
    "pyamg": ("solvers/multigrid.py",),
    "rich": ("cli/backends.py", "progress.py"),
    "click": ("cli/",),
    "cv2": (),
}


def imports(source: str, package: tuple[str, ...]) -> list[str]:
    """Dotted names of all modules that a source imports, anywhere in it; `package` is where it lives."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = list(package[: len(package) - node.level + 1]) if node.level else []
            base += node.module.split(".") if node.module else []
            # `from . import a` may name a module or something in the package: the longer name serves for both
            found += [".".join([*base, alias.name]) for alias in node.names]
    return found


def faults(file: str, source: str) -> list[str]:
    """What is wrong with the imports of a file, named by its path below gpureg/ (or kernels/...)."""
    path = Path(file)
    if path.parts[0] == "kernels" and len(path.parts) > 1:
        package, room = ("gpureg", *path.parent.parts), "kernels"
    else:
        package = ("gpureg", *path.parent.parts)
        room = path.parts[0].removesuffix(".py")
    wrong = []
    if room not in FLOORS and file != "__init__.py":
        wrong.append(f"{file} has no floor: give gpureg.{room} one in tests/test_floors.py")
    for name in imports(source, package):
        parts = name.split(".")
        owners = OWNERS.get(parts[0])
        if owners is not None and not any(file == o or (o.endswith("/") and file.startswith(o)) for o in owners):
            wrong.append(f"{file} imports {parts[0]}, which belongs to {' and '.join(owners) or 'nobody'}")
        if parts[0] != "gpureg" or file == "__init__.py" or room not in FLOORS:
            continue
        target = parts[1] if len(parts) > 1 else ""
        if target == room and len(path.parts) > 1:
            continue
        if target not in FLOORS:
            # also `import gpureg`, whose __init__ holds every floor
            wrong.append(f"{file} imports {name}, which has no floor")
        elif FLOORS[target] >= FLOORS[room]:
            wrong.append(
                f"{file} (floor {FLOORS[room]:g}) imports gpureg.{target} (floor {FLOORS[target]:g}): only lower ones"
            )
    return wrong


FILES = {
    **{path.relative_to(PACKAGE).as_posix(): path for path in PACKAGE.rglob("*.py") if "_kernels" not in path.parts},
    **{f"kernels/{path.relative_to(kernels.folder).as_posix()}": path for path in kernels.folder.rglob("*.py")},
}


@pytest.mark.parametrize("file", sorted(FILES))
def test_floor(file):
    assert faults(file, FILES[file].read_text("utf-8")) == []


def test_the_package_is_found():
    assert {"solvers/loop.py", "kernels.py"} <= set(FILES)


WRONG = [
    ("kernels.py", "from .backends import get", "only lower ones"),
    ("kernels.py", "import gpureg.solvers.loop", "only lower ones"),
    ("weights/base.py", "def f():\n    from gpureg.solvers import Jacobi", "only lower ones"),
    ("backends/types.py", "from .. import solvers", "only lower ones"),
    ("backends/opencl/primitives.py", "from ...weights import patch", "only lower ones"),
    ("solvers/loop.py", "from ..tuning import discrepancy", "only lower ones"),
    ("weights/base.py", "import gpureg", "has no floor"),
    ("weights/base.py", "from gpureg import GridGraph", "has no floor"),
    ("helpers.py", "import math", "helpers.py has no floor"),
    ("helpers/things.py", "import math", "has no floor"),
    ("kernels/warp/grid.py", "from gpureg.weights import patch", "only lower ones"),
    ("kernels/warp/grid.py", "import pyopencl", "belongs to"),
    ("tuning/risk.py", "import pyopencl as cl", "belongs to"),
    ("tuning/risk.py", "import warp", "belongs to"),
    ("__init__.py", "import matplotlib.pyplot as plt", "belongs to plot/ and"),
    ("tuning/risk.py", "def f():\n    from skimage import data", "belongs to plot/ and cli/demo.py and"),
    ("tuning/risk.py", "from PIL import Image", "belongs to"),
    ("tuning/risk.py", "import cv2", "belongs to nobody"),
    ("tuning/risk.py", "from rich.progress import Progress", "belongs to"),
]

RIGHT = [
    ("weights/guide.py", "from ..backends import get\nfrom .base import Weights"),
    ("cli/group.py", "import click\nfrom .. import tuning\nfrom ..tuning import discrepancy"),
    ("__init__.py", "from .cli import main"),
    ("kernels/warp/grid.py", "import warp as wp\nfrom .csr import Access\nfrom . import reals"),
    ("solvers/loop.py", "import warpless"),
]


@pytest.mark.parametrize(("file", "source", "message"), WRONG)
def test_a_wrong_import_is_caught(file, source, message):
    found = faults(file, source)
    assert found
    assert message in found[0]


@pytest.mark.parametrize(("file", "source"), RIGHT)
def test_a_right_import_is_not(file, source):
    assert faults(file, source) == []
