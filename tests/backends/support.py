"""What each device supports: every primitive on a grid and on a stored graph, tried once.

Run it by `python tests/backends/support.py`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import cases
import rows  # noqa: F401, fills ROWS
from checking import On, check_call
from primitives import ROWS, Primitive
from problems import HOT, Kind, PatchCase, PatchKind

from gpureg import backends
from gpureg.backends import BackendUnavailable

GRAPHS = {"grid": "small grid", "stored": "small csr of grid"}
PATCHES = ("patch_distance", "similarity_step")


def kind(row: Primitive, graph: str, dtype: str = "float32") -> Kind | PatchKind:
    """A small problem for a primitive."""
    if row.name in PATCHES:
        return PatchKind(PatchCase(GRAPHS[graph], radius=1, scale=0.5), dtype)
    return Kind(cases.Setup(GRAPHS[graph]), dtype, classes=HOT)


def verdict(backend: Any, row: Primitive, graph: str) -> str:
    """ "yes", or why not."""
    if graph not in row.graphs:
        return "not asked for"
    problem = kind(row, graph, backend.dtype.name).make()
    try:
        check_call(On(backend, problem), row, next(row.calls(problem)))
    except BackendUnavailable as error:
        return f"no: {error}"
    except AssertionError as error:
        return f"WRONG: {error}"
    return "yes"


def table(devices: list[str], dtype: str = "float32") -> Iterator[str]:
    """Lines of Markdown: a row a primitive, a column a device with a kind of graph."""
    columns = [(device, graph) for device in devices for graph in GRAPHS]
    yield "| primitive | " + " | ".join(f"{device}, {graph}" for device, graph in columns) + " |"
    yield "|---" * (len(columns) + 1) + "|"
    for name, row in ROWS.items():
        found = [verdict(backends.get(device, dtype), row, graph) for device, graph in columns]
        yield f"| `{name}` | " + " | ".join(found) + " |"
    held = [", ".join(backends.get(device, dtype).storages) for device, _ in columns]
    yield "| weights held | " + " | ".join(held) + " |"


if __name__ == "__main__":
    print(*table(sys.argv[1:] or [device.id for device in backends.devices()]), sep="\n")
