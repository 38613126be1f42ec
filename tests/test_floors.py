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
FLOORS: dict[str, float] = {
    "kernels": 0,
    "graph": 1,
    "result": 1,
    "picture": 0.5,
    "tiff": 0.7,
    "io": 1,
    "layout": 1.2,
    "noise": 1.5,
    "graph_io": 1.5,
    "reorder": 1.5,
    "backends": 2,
    "build": 1.5,
    "surface": 1.6,
    "collapse": 1.7,
    "mesh_noise": 1.7,
    "metrics": 1.7,
    "vertex_values": 1.7,
    "point_cloud": 1.6,
    "point_normals": 1.7,
    "point_patches": 1.8,
    "point_denoising": 4.7,
    "pieces": 4.6,
    "cluster": 5,
    "segment": 5,
    "normals": 4.6,
    "mesh_denoising": 4.7,
    "weights": 3,
    "operators": 4.5,
    "bipartite": 3,
    "memory": 3.5,
    "problem": 3.5,
    "assembly": 3.7,
    "multigrid": 3.5,
    "region_values": 3,
    "region_graph": 3.2,
    "partition": 3,
    "sources": 3.2,
    "harmonic": 4,
    "solvers": 4,
    "spectral": 4,
    "tiles": 4.2,
    "regularization": 4.5,
    "sweep": 4.55,
    "rule": 4,
    "pixels": 4,
    "nearest": 4.6,
    "paths": 4.55,
    "tuning": 4.6,
    "plan": 4.7,
    "planning": 4.8,
    "borders": 1,
    "image": 5,
    "filters": 5.2,
    "presets": 5.4,
    "skimage": 5.5,
    "inpaint": 5,
    "labels": 5,
    "mesh": 5,
    "mesh_simplify": 5,
    "skeleton": 5.1,
    "curve": 5,
    "curve_simplify": 5.1,
    "points": 5,
    "regions": 5.52,
    "simplify": 5.53,
    "plot": 5.5,
    "report": 5.5,
    "settings": 5.55,
    "files": 5.6,
    "mesh_io": 1.7,
    "text_table": 1.1,
    "points_io": 1.7,
    "curve_documents": 1.3,
    "curve_io": 1.7,
    "curve_report": 5.6,
    "curve_file": 5.65,
    "points_report": 5.6,
    "points_file": 5.65,
    "mesh_report": 5.6,
    "mesh_file": 5.65,
    "simplify_report": 5.6,
    "simplify_file": 5.65,
    "batch": 5.7,
    "figures": 5.8,
    "cli": 6,
    "__main__": 6.5,
}

# Who may import a library that is heavy, optional, or both; names of files below gpureg/, and kernels/ for itself.
OWNERS: dict[str, tuple[str, ...]] = {
    "pyopencl": ("backends/opencl.py", "backends/opencl_graph.py", "backends/opencl_queue.py"),
    "warp": (
        "backends/warp.py",
        "backends/warp_graph.py",
        "backends/warp_layout.py",
        "backends/warp_optimize.py",
        "backends/warp_zones.py",
        "kernels/warp/",
    ),
    "matplotlib": ("plot/", "figures/sheet.py", "cli/figures.py"),
    "skimage": ("plot/", "cli/demo.py", "cli/figures.py", "figures/"),
    "trimesh": ("metrics.py", "mesh_io.py", "points_io.py"),
    "PIL": ("io.py",),
    "tifffile": ("tiff.py",),
    "imagecodecs": ("io.py",),
    "networkx": ("graph_io.py",),
    "pyamg": ("multigrid.py",),
    "rich": ("cli/backends.py", "solvers/loop.py"),
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
        if target == "__version__":
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
    assert {"graph.py", "backends/numpy.py", "kernels.py"} <= set(FILES)


WRONG = [
    ("graph.py", "from .backends import get", "only lower ones"),
    ("graph.py", "import gpureg.solvers.loop", "only lower ones"),
    ("graph.py", "def f():\n    from gpureg.weights import patch", "only lower ones"),
    ("graph.py", "from . import result", "only lower ones"),
    ("backends/opencl.py", "from ..weights import patch", "only lower ones"),
    ("backends/opencl.py", "from .. import problem", "only lower ones"),
    ("solvers/loop.py", "from ..regularization import regularize", "only lower ones"),
    ("mesh.py", "from .image import denoise_image", "only lower ones"),
    ("weights.py", "import gpureg", "has no floor"),
    ("weights.py", "from gpureg import GridGraph", "has no floor"),
    ("helpers.py", "import math", "helpers.py has no floor"),
    ("helpers/things.py", "import math", "has no floor"),
    ("kernels/warp/grid.py", "from gpureg.graph import Graph", "only lower ones"),
    ("kernels/warp/grid.py", "import pyopencl", "belongs to backends/opencl.py"),
    ("image.py", "import pyopencl as cl", "belongs to backends/opencl.py"),
    ("image.py", "import warp", "belongs to"),
    ("__init__.py", "import matplotlib.pyplot as plt", "belongs to plot/ and"),
    ("image.py", "def f():\n    from skimage import data", "belongs to plot/ and cli/demo.py and"),
    ("image.py", "from PIL import Image", "belongs to io.py"),
    ("image.py", "import cv2", "belongs to nobody"),
    ("regularization.py", "from rich.progress import Progress", "belongs to"),
    ("backends/warp_other.py", "import warp", "belongs to"),
]

RIGHT = [
    ("weights.py", "from .backends import get\nfrom .graph import Graph"),
    ("backends/opencl.py", "import pyopencl\nfrom .base import Backend\nfrom .. import kernels\nfrom . import numpy"),
    ("backends/warp.py", "import warp as wp\nfrom ..kernels.warp import grid"),
    ("kernels/warp/grid.py", "import warp as wp\nfrom .csr import Access\nfrom . import reals"),
    ("cli/group.py", "import click\nfrom .. import __version__, image\nfrom ..image import denoise_image"),
    ("__init__.py", "from .cli import main"),
    ("solvers/loop.py", "import rich.progress\nimport warpless"),
]


@pytest.mark.parametrize(("file", "source", "message"), WRONG)
def test_a_wrong_import_is_caught(file, source, message):
    found = faults(file, source)
    assert found
    assert message in found[0]


@pytest.mark.parametrize(("file", "source"), RIGHT)
def test_a_right_import_is_not(file, source):
    assert faults(file, source) == []
