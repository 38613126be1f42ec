"""The structure of the package, read from its sources: rooms, floors, imports, sizes, long signatures.

A room is a folder of ``gpureg/``, or a file at its top. ``test_floors.py`` holds the rules; run by itself,
``python tests/house.py [FOLDER]``, this prints the numbers of a checkout.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

# A list of parameters is long beyond this.
LONG_SIGNATURE = 8


def imported(source: str, package: tuple[str, ...], *, at_run_time: bool = False) -> list[str]:
    """Dotted names of all modules that a source imports, anywhere in it; `package` is where it lives.

    With `at_run_time` those that only type checkers read are left out.
    """
    tree = ast.parse(source)
    skipped = set()
    if at_run_time:
        for node in ast.walk(tree):
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
                skipped |= set(ast.walk(node))
    found = []
    for node in ast.walk(tree):
        if node in skipped:
            continue
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = list(package[: len(package) - node.level + 1]) if node.level else []
            base += node.module.split(".") if node.module else []
            # `from . import a` may name a module or something in the package: the longer name serves for both
            found += [".".join([*base, alias.name]) for alias in node.names]
    return found


def room_of(file: str) -> str:
    """The room of a file, named by its path below gpureg/."""
    return Path(file).parts[0].removesuffix(".py")


def files_of(package: Path) -> dict[str, Path]:
    """The sources of the package by their paths below it."""
    paths = (path for path in sorted(package.rglob("*.py")) if "_kernels" not in path.parts)
    return {path.relative_to(package).as_posix(): path for path in paths}


def imports_between_rooms(package: Path) -> dict[str, set[str]]:
    """The rooms that each room imports, but for the face of the package, which imports all."""
    files = files_of(package)
    rooms: dict[str, set[str]] = {room_of(file): set() for file in files if file != "__init__.py"}
    for file, path in files.items():
        if file == "__init__.py":
            continue
        for name in imported(path.read_text("utf-8"), ("gpureg", *Path(file).parent.parts)):
            parts = name.split(".")
            if parts[0] == "gpureg" and len(parts) > 1 and parts[1] in rooms and parts[1] != room_of(file):
                rooms[room_of(file)].add(parts[1])
    return rooms


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Ways from a room back to itself, one of each."""
    found, done = [], set()

    def visit(at: str, way: list[str]) -> None:
        if at in way:
            found.append([*way[way.index(at) :], at])
            return
        if at in done:
            return
        for to in sorted(graph.get(at, ())):
            visit(to, [*way, at])
        done.add(at)

    for start in sorted(graph):
        visit(start, [])
    return found


def floors(graph: dict[str, set[str]]) -> dict[str, int]:
    """The lowest floor that each room can stand on, if it imports lower ones only."""
    known: dict[str, int] = {}

    def floor(room: str) -> int:
        if room not in known:
            known[room] = 0  # a circle has no floor: test_floors.py refuses it
            known[room] = 1 + max((floor(below) for below in graph[room]), default=-1)
        return known[room]

    return {room: floor(room) for room in graph}


def signatures(package: Path) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """File, function and names of the parameters of every function."""
    for file, path in files_of(package).items():
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.FunctionDef):
                arguments = node.args
                names = [one.arg for one in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
                yield file, node.name, tuple(name for name in names if name not in ("self", "cls"))


def main(folder: str = ".") -> None:
    """Print the numbers of a checkout."""
    package = Path(folder) / "gpureg"
    graph = imports_between_rooms(package)
    lines = {file: len(path.read_text("utf-8").splitlines()) for file, path in files_of(package).items()}
    long = [name for _, name, names in signatures(package) if len(names) > LONG_SIGNATURE]
    print(f"rooms {len(graph)}, floors {max(floors(graph).values()) + 1}, circles {len(circles(graph))}")
    print(f"imports between rooms {sum(map(len, graph.values()))}")
    print(f"files {len(lines)}, lines {sum(lines.values())}, longest file {max(lines.values())}")
    print(f"signatures of more than {LONG_SIGNATURE} parameters {len(long)}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
