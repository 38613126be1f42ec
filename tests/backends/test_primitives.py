"""Every primitive on every device against the numpy backend in float64, within the bounds of tests/bounds.py.

From outputs full of NaN, between guards, and the same bits on a second run. Every variant is a kernel that each device
compiles, so each family of problems has the primitives that are worth it there.
"""

from __future__ import annotations

import cases
import pytest
import rows  # noqa: F401, fills ROWS
from checking import check, on
from primitives import ROWS
from problems import CLASSES, GENERAL, HOT, Kind, PatchCase, PatchKind

# All variants of the vertex norm with gamma = sqrt(w).
PLAIN = [Kind(s, t) for t in ("float32", "float64") for s in cases.SETUPS if t == "float32" or s.wide]

# Both forms of gamma. The second list is a dozen kernels that every device compiles, so not all of them.
FORMS = [
    (cases.Setup("grid"), "float32"),
    (cases.Setup("masked", 3), "float32"),
    (cases.Setup("csr", 3, coupled=False), "float32"),
    (cases.Setup("csr", 3, coupled=False), "float64"),
    (cases.Setup("pixel"), "float32"),
]
EDGE_FORMS = [*FORMS, (cases.Setup("grid"), "float64"), (cases.Setup("volume"), "float32")]
BOTH = (False, True)

# The certified solvers': the classes of p meet all of them on two graphs, and one or two on the others.
DUAL = [
    Kind(cases.Setup("grid"), classes=CLASSES),
    Kind(cases.Setup("grid"), "float64", edge_norm=True, classes=GENERAL),
    Kind(cases.Setup("masked", 3), directed=True, edge_norm=True, classes=GENERAL),
    Kind(cases.Setup("volume", 3, coupled=False), classes=HOT),
    Kind(cases.Setup("csr", 3, coupled=False), "float64", directed=True, classes=CLASSES),
    Kind(cases.Setup("csr", 3), edge_norm=True, classes=GENERAL),
    Kind(cases.Setup("disk"), directed=True, classes=HOT),
    Kind(cases.Setup("pixel"), classes=HOT),
    Kind(cases.Setup("csr, one vertex"), classes=HOT),
]

AVERAGED = [
    Kind(cases.Setup("grid", 2)),
    Kind(cases.Setup("grid"), "float64"),
    *(Kind(cases.Setup(name)) for name in ("disk", "narrow", "volume", "four axes", "pixel")),
    Kind(cases.Setup("masked", 3)),
    Kind(cases.Setup("row", 2)),
]
STORED = [Kind(cases.Setup(name)) for name in ("csr", "small csr, unweighted", "csr, one vertex")]

# tests/test_partition.py has all other graphs, and blocks of several sizes
ZONES = [Kind(cases.Setup(name)) for name in ("grid", "csr")]

# Seven compilations a device and type. A radius of 4 reaches over both ends of a row of 3.
PATCHES = (
    PatchCase("grid", radius=2),
    PatchCase("grid", scale=0.5, spatial=True, shift=0.125, wide=True),
    PatchCase("grid", channels=3, radius=3, gaussian=True, shift=0.03, scale=8.0),
    PatchCase("narrow", radius=4, scale=0.01),
    PatchCase("masked", radius=1, scale=0.5),
    PatchCase("row", radius=2, scale=1.0, wide=True),
    PatchCase("volume", radius=1, gaussian=True, scale=4.0),
    PatchCase("pixel", radius=2, scale=1.0),
    PatchCase("csr", channels=3, radius=0, scale=2.0, spatial=True, wide=True),
    PatchCase("csr of grid", radius=2),
    PatchCase("csr of grid", radius=1, shift=0.125, scale=0.5),
    PatchCase("masked", channels=2, radius=1, shift=0.125, scale=0.5, spatial=True, maps=True, wide=True),
    PatchCase("volume", radius=1, gaussian=True, scale=0.5, maps=True),
    PatchCase("csr of grid", radius=1, shift=0.125, scale=0.5, maps=True, cut=0.5, wide=True),
    PatchCase("grid", scale=0.5, spatial=True, cut=0.75),
)
WEIGHTS = [PatchKind(case, t) for t in ("float32", "float64") for case in PATCHES if t == "float32" or case.wide]

STEPS = [
    PatchKind(PatchCase("grid", radius=2, scale=0.5, shift=0.125, spatial=True)),
    PatchKind(PatchCase("grid", channels=3, radius=3, gaussian=True, shift=0.03, scale=8.0), lam="array"),
    PatchKind(PatchCase("grid", radius=2, scale=0.5), "float64", "array"),
    PatchKind(PatchCase("masked", radius=0, scale=2.0, spatial=True), lam="array"),
    PatchKind(PatchCase("narrow", radius=4, scale=0.01)),
    PatchKind(PatchCase("row", radius=2, scale=1.0), lam="array"),
    PatchKind(PatchCase("volume", radius=1, gaussian=True, scale=4.0), lam="array"),
    PatchKind(PatchCase("four axes", channels=2, radius=1, scale=0.01)),
    PatchKind(PatchCase("pixel", radius=2, scale=1.0)),
    PatchKind(PatchCase("masked", channels=2, shift=0.125, scale=0.5, spatial=True, maps=True), lam="array"),
    PatchKind(PatchCase("grid", radius=2, scale=0.5, shift=0.125, spatial=True), guided=True),
    PatchKind(PatchCase("grid", channels=3, radius=3, gaussian=True, shift=0.03, scale=8.0), guided=True),
]

FAMILIES = [
    (PLAIN, ("degree", "gradient_norm", "p_laplacian", "jacobi_step", "energy", "max_change", "sweep")),
    ([Kind(s) for s in cases.LONG], ("energy", "max_change")),
    ([Kind(s, t) for s, t in FORMS], ("euler_step",)),
    (
        [Kind(s, t, directed=True) for s, t in FORMS],
        ("degree", "p_laplacian", "jacobi_step", "euler_step", "energy"),
    ),
    (
        [Kind(s, t, directed, edge_norm=True) for s, t in FORMS for directed in BOTH],
        ("gradient_norm", "p_laplacian", "jacobi_step", "euler_step", "energy"),
    ),
    ([Kind(s, t, directed) for s, t in EDGE_FORMS for directed in BOTH], ("difference", "adjoint")),
    (DUAL, ("dot", "combine", "gradient", "dual_step", "proximal", "primal", "duality_gap")),
    (AVERAGED, ("aggregate", "largest_weight")),
    (STORED, ("largest_weight",)),
    (WEIGHTS, ("patch_distance",)),
    (STEPS, ("similarity_step",)),
    (ZONES, ("influence_zones", "flat_zones")),
]
# each once, where families meet
PAIRS = list(dict.fromkeys((kind, name) for kinds, names in FAMILIES for kind in kinds for name in names))

# What every driver of a backend builds: each kernel on a grid, a volume and a stored graph, in both types. The others
# are on the first: a driver takes a minute for all of them.
EVERY_DRIVER = {
    *(Kind(s, t) for t in ("float32", "float64") for s in cases.SETUPS if s.wide),
    *(Kind(s) for s in cases.LONG),
    *(Kind(s, directed=True) for s, t in FORMS[:1]),
    *(Kind(s, t, directed=True, edge_norm=True) for s, t in FORMS[3:4]),
    *(Kind(s, t, directed) for s, t, directed in ((*FORMS[0], False), (*FORMS[3], True))),
    *(kind for kind in DUAL if kind.setup.graph == "volume" or (kind.setup.graph == "csr" and kind.edge_norm)),
    *(kind for kind in AVERAGED if kind.setup.graph in ("grid", "masked")),
    *STORED,
    *ZONES,
    *(PatchKind(case) for case in PATCHES if case.wide),
    *STEPS[:3],
}


def test_every_primitive_has_its_problems():
    assert {name for _, name in PAIRS} == set(ROWS)


def pair(kind, name):
    marks = () if kind in EVERY_DRIVER else pytest.mark.one_driver
    return pytest.param(kind, name, marks=marks, id=f"{name}-{kind.id}")


def test_every_primitive_is_on_every_driver():
    assert {name for kind, name in PAIRS if kind in EVERY_DRIVER} == set(ROWS)


@pytest.mark.parametrize(("kind", "name"), [pair(*each) for each in PAIRS])
def test_primitive(device, kind, name):
    """Within the bound, the same bits on a second run, and nothing written outside of an array."""
    check(on(device, kind.dtype), ROWS[name], kind.make())
