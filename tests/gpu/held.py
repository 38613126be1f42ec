"""The primitives and problems that are held on a pretended GPU: each option of the kernels once, on small graphs."""

from __future__ import annotations

from collections.abc import Iterator

import cases
import rows  # noqa: F401, fills ROWS
from checking import check, on
from primitives import ROWS
from problems import CLASSES, GENERAL, HOT, Kind, PatchCase, PatchKind

GRID, MASKED = cases.Setup("small grid"), cases.Setup("small masked", 3, coupled=False)
STORED, STORED_3 = cases.Setup("small csr"), cases.Setup("small csr of grid", 3)
# More vertices than a work group has items, and than a sum has segments.
LARGE = [cases.Setup("grid"), cases.Setup("csr"), cases.Setup("long row"), cases.Setup("csr of long row")]

PLAIN = ("degree", "largest_weight", "gradient_norm", "p_laplacian", "jacobi_step", "energy", "max_change", "sweep")
EDGES = ("gradient_norm", "p_laplacian", "jacobi_step", "euler_step", "energy", "difference", "adjoint")
DUAL = ("dot", "combine", "gradient", "dual_step", "proximal", "primal", "duality_gap")
PATCHES = [
    PatchKind(PatchCase("small grid", radius=2, scale=0.5, shift=0.125, spatial=True)),
    PatchKind(PatchCase("small masked", channels=3, radius=1, gaussian=True, scale=0.5, maps=True)),
    PatchKind(PatchCase("small volume", radius=1, scale=4.0), "float64"),
]

FAMILIES = [
    ([Kind(s, t) for s in (GRID, STORED) for t in ("float32", "float64")], PLAIN),
    ([Kind(s) for s in (MASKED, STORED_3)], PLAIN),
    ([Kind(s) for s in LARGE], ("sweep", "energy", "max_change")),
    ([Kind(s, directed=True, edge_norm=True) for s in (GRID, STORED)], EDGES),
    ([Kind(GRID, classes=CLASSES), Kind(STORED, classes=GENERAL)], DUAL),
    ([Kind(GRID, "float64", edge_norm=True, classes=GENERAL), Kind(MASKED, classes=HOT)], ("dual_step", "duality_gap")),
    ([Kind(s) for s in (GRID, MASKED)], ("aggregate",)),
    ([Kind(s) for s in (GRID, STORED)], ("influence_zones", "flat_zones")),
    (PATCHES, ("patch_distance", "similarity_step")),
    ([PatchKind(PatchCase("grid", radius=3, scale=0.5, spatial=True), lam="array")], ("similarity_step",)),
    ([PatchKind(PatchCase("small csr of grid", radius=1, scale=0.5))], ("patch_distance",)),
]
PAIRS = [(kind, name) for kinds, names in FAMILIES for kind in kinds for name in names]
IDS = [f"{name}-{kind.id}" for kind, name in PAIRS]


def hold(device: str, kind: Kind | PatchKind, name: str) -> None:
    """Within the bound, the same bits on a second run, and nothing written outside of an array."""
    backend = on(device, kind.dtype)
    assert backend.device.kind == "gpu"
    check(backend, ROWS[name], kind.make())


def smallest() -> Iterator[tuple[Kind | PatchKind, str]]:
    """One problem of fewer than 30 vertices a primitive and kind of graph."""
    seen = set()
    for kind, name in PAIRS:
        graph = kind.case.graph if isinstance(kind, PatchKind) else kind.setup.graph
        key = name, isinstance(cases.graph(graph), cases.Graph)
        if key not in seen and graph in cases.SMALL and kind.dtype == "float32":
            seen.add(key)
            yield kind, name
