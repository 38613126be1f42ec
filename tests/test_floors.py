"""The house has floors: a room of gpureg imports lower floors only, and each heavy library has one owner.

``house.py`` reads the structure from the sources; this file holds the rules.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from house import LONG_SIGNATURE, circles, files_of, floors, imported, imports_between_rooms, room_of, signatures

import gpureg
from gpureg import kernels

PACKAGE = Path(gpureg.__file__).parent

# The floor of each room; a folder is one room, whose files may import each other. Rooms of one floor do not know each
# other.
FLOORS: dict[str, int] = {
    "_version": 0,
    "arrays": 0,
    "checks": 0,
    "exchange": 0,
    "frame": 0,
    "kernels": 0,
    "progress": 0,
    "doors": 1,
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
    "gradients": 7,
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

# What may stand at the top of the package as a file: what everything rests on, and what a user imports.
GROUND = {"_version", "arrays", "checks", "doors", "frame", "kernels", "progress"}
PUBLIC = {"__init__", "__main__", "metrics", "presets", "skimage", "sources"}

# Rooms of one kind of data each. They do not know each other, and nothing below regularization knows one of them.
SUBJECTS = {"images", "meshes", "points", "curves"}

# Lines of a file at most.
LONGEST, LONGEST_TEST = 350, 400

# Who may import a library that is heavy, optional, or both; names of files below gpureg/, and kernels/ for itself.
OWNERS: dict[str, tuple[str, ...]] = {
    "pyopencl": ("backends/opencl/", "exchange/opencl.py"),
    "warp": ("backends/warp/", "kernels/warp/", "exchange/warp.py"),
    "torch": ("exchange/torch.py",),
    "cupy": ("exchange/cupy.py",),
    "jax": ("exchange/jax.py",),
    "matplotlib": ("plot/", "figures/sheet.py", "cli/figures.py"),
    "skimage": ("plot/", "cli/demo.py", "cli/figures.py", "figures/"),
    "trimesh": ("metrics.py", "meshes/contents.py", "meshes/scenes.py", "points/ply.py"),
    "PIL": ("files/with_pillow.py",),
    "tifffile": ("files/tiff.py", "files/tiff_writing.py", "files/slabs.py"),
    "imagecodecs": ("files/png.py", "files/jpeg2000.py"),
    "networkx": ("graphs/networkx.py",),
    "shapely": ("curves/shapely.py",),
    "pyamg": ("solvers/multigrid.py",),
    "rich": ("cli/backends.py", "progress.py"),
    "click": ("cli/",),
    "cv2": (),
}


def faults(file: str, source: str) -> list[str]:
    """What is wrong with the imports of a file, named by its path below gpureg/ (or kernels/...)."""
    path = Path(file)
    package, room = ("gpureg", *path.parent.parts), room_of(file)
    if file == "__init__.py":
        room = ""
    elif room not in FLOORS:
        return [f"{file} has no floor: give gpureg.{room} one in tests/test_floors.py"]
    wrong = []
    for name in imported(source, package):
        parts = name.split(".")
        owners = OWNERS.get(parts[0])
        if owners is not None and not any(file == o or (o.endswith("/") and file.startswith(o)) for o in owners):
            wrong.append(f"{file} imports {parts[0]}, which belongs to {' and '.join(owners) or 'nobody'}")
        if parts[0] != "gpureg" or not room:
            continue
        target = parts[1] if len(parts) > 1 else ""
        if target == room and len(path.parts) > 1:
            continue
        if target not in FLOORS:
            # also `import gpureg`, whose face shows every floor
            wrong.append(f"{file} imports {name}, which has no floor")
        elif {target, room} <= SUBJECTS:
            wrong.append(f"{file} imports gpureg.{target}: subjects do not know each other")
        elif FLOORS[target] >= FLOORS[room]:
            wrong.append(
                f"{file} (floor {FLOORS[room]}) imports gpureg.{target} (floor {FLOORS[target]}): only lower ones"
            )
    return wrong


def misplaced(file: str) -> bool:
    """Whether a file at the top of the package is neither public nor ground."""
    return "/" not in file and room_of(file) not in GROUND | PUBLIC


def hidden(folder: Path, source: str) -> set[str]:
    """Names that the face of a room, its ``__init__.py``, exports though a module of the room has them too."""
    modules = {path.stem for path in folder.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    exported = set()
    for node in ast.walk(ast.parse(source)):
        # `from . import a` exports the module itself
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            exported |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            exported.add(node.name)
    return exported & modules


KERNELS = {f"kernels/{path.relative_to(kernels.folder).as_posix()}": path for path in kernels.folder.rglob("*.py")}
FILES = {**files_of(PACKAGE), **KERNELS}
FACES = sorted(file for file in files_of(PACKAGE) if file.endswith("/__init__.py"))
TESTS = {path.relative_to(Path(__file__).parent).as_posix(): path for path in Path(__file__).parent.rglob("*.py")}


@pytest.mark.parametrize("file", sorted(FILES))
def test_floor(file):
    assert faults(file, FILES[file].read_text("utf-8")) == []


@pytest.mark.parametrize("file", sorted(FILES))
def test_a_file_is_in_its_place_and_not_long(file):
    assert not misplaced(file), f"{file} is neither public nor ground: move it to the room of its subject"
    if file not in KERNELS:
        assert len(FILES[file].read_text("utf-8").splitlines()) <= LONGEST


@pytest.mark.parametrize("file", sorted(TESTS))
def test_a_file_of_tests_is_not_long(file):
    assert len(TESTS[file].read_text("utf-8").splitlines()) <= LONGEST_TEST


@pytest.mark.parametrize("face", FACES)
def test_no_exported_name_hides_a_module(face):
    assert hidden(FILES[face].parent, FILES[face].read_text("utf-8")) == set()


def test_no_name_of_the_package_hides_a_room():
    modules = {room_of(file) for file in files_of(PACKAGE)}
    assert {name for name in gpureg.__all__ if name in modules} <= PUBLIC | {
        "operators", "plot", "spectral", "tuning", "weights"
    }  # fmt: skip


def test_there_is_no_circle():
    assert circles(imports_between_rooms(PACKAGE)) == []
    # nor among the files of a room, but for what only type checkers read
    modules = {"gpureg." + file.removesuffix(".py").replace("/", "."): file for file in files_of(PACKAGE)}
    graph: dict[str, set[str]] = {}
    for module, file in modules.items():
        source = FILES[file].read_text("utf-8")
        names = imported(source, ("gpureg", *Path(file).parent.parts), at_run_time=True)
        into = {name if name in modules else name.rpartition(".")[0] for name in names}
        graph[module] = {name for name in into if name in modules and name != module}
    assert circles(graph) == []


def test_floors_are_as_low_as_can_be():
    """The table says how the rooms stand, not how they could: a room that came down is seen here."""
    assert FLOORS == floors(imports_between_rooms(PACKAGE))


def test_no_long_list_of_parameters_stands_twice():
    """Options that several functions share are handed on as one."""
    long = [(f"{file}: {name}", set(names)) for file, name, names in signatures(PACKAGE) if len(names) > LONG_SIGNATURE]
    assert len(long) > 10
    assert [(a, b) for a, first in long for b, second in long if a != b and first <= second] == []


def test_the_package_is_found():
    assert {"solvers/loop.py", "graphs/csr.py", "backends/numpy/primitives.py", "kernels.py"} <= set(FILES)


WRONG = [
    ("graphs/csr.py", "from ..backends import get", "only lower ones"),
    ("graphs/csr.py", "import gpureg.solvers.loop", "only lower ones"),
    ("graphs/csr.py", "def f():\n    from gpureg.weights import patch", "only lower ones"),
    ("graphs/csr.py", "from .. import model", "only lower ones"),
    ("backends/opencl/primitives.py", "from ...weights import patch", "only lower ones"),
    ("backends/opencl/primitives.py", "from ... import model", "only lower ones"),
    ("solvers/loop.py", "from ..regularization import regularize", "only lower ones"),
    ("meshes/denoise.py", "from ..images.denoise import denoise_image", "subjects do not know each other"),
    ("points/denoise.py", "from ..meshes import noise", "subjects do not know each other"),
    ("regularization/regularize.py", "from ..images import raster", "only lower ones"),
    ("weights/base.py", "import gpureg", "has no floor"),
    ("weights/base.py", "from gpureg import GridGraph", "has no floor"),
    ("helpers.py", "import math", "helpers.py has no floor"),
    ("helpers/things.py", "import math", "has no floor"),
    ("kernels/warp/grid.py", "from gpureg.graphs.csr import Graph", "only lower ones"),
    ("kernels/warp/grid.py", "import pyopencl", "belongs to backends/opencl/"),
    ("images/denoise.py", "import pyopencl as cl", "belongs to backends/opencl/"),
    ("images/denoise.py", "import warp", "belongs to"),
    ("__init__.py", "import matplotlib.pyplot as plt", "belongs to plot/ and"),
    ("images/denoise.py", "def f():\n    from skimage import data", "belongs to plot/ and cli/demo.py and"),
    ("images/denoise.py", "from PIL import Image", "belongs to files/with_pillow.py"),
    ("images/denoise.py", "import cv2", "belongs to nobody"),
    ("regularization/regularize.py", "from rich.progress import Progress", "belongs to"),
]

RIGHT = [
    ("weights/base.py", "from ..backends import get\nfrom ..graphs.csr import Graph"),
    ("backends/opencl/primitives.py", "import pyopencl\nfrom ..protocol import Backend\nfrom ... import kernels"),
    ("backends/warp/primitives.py", "import warp as wp\nfrom ...kernels.warp import grid"),
    ("kernels/warp/grid.py", "import warp as wp\nfrom .csr import Access\nfrom . import reals"),
    ("cli/group.py", "import click\nfrom .._version import __version__\nfrom ..jobs.denoise import denoise_file"),
    ("__init__.py", "from .cli import main"),
    ("progress.py", "import rich.progress\nimport warpless"),
]


@pytest.mark.parametrize(("file", "source", "message"), WRONG)
def test_a_wrong_import_is_caught(file, source, message):
    found = faults(file, source)
    assert found
    assert message in found[0]


@pytest.mark.parametrize(("file", "source"), RIGHT)
def test_a_right_import_is_not(file, source):
    assert faults(file, source) == []


def test_wrong_places_names_and_circles_are_caught(tmp_path):
    assert misplaced("things.py") and not misplaced("arrays.py") and not misplaced("images/things.py")
    for name in ("__init__.py", "skeleton.py", "other.py"):
        (tmp_path / name).write_text("", "utf-8")
    assert hidden(tmp_path, "from .skeleton import skeleton") == {"skeleton"}
    assert hidden(tmp_path, "def other(): ...") == {"other"}
    assert hidden(tmp_path, "from . import other\nfrom .other import thing") == set()
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == [["b", "c", "b"]]
    assert floors({"a": {"b"}, "b": {"c"}, "c": set()}) == {"a": 2, "b": 1, "c": 0}
