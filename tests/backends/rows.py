"""The rows: what every primitive of the protocol is called with, and what it gives."""

from __future__ import annotations

import calls
import calls_dual
import calls_patches
from primitives import (
    COLUMN,
    EDGES,
    FUNCTION,
    GUIDE,
    HOST,
    LABELS,
    LENGTHS,
    NORMS,
    NUMBER,
    ROWS,
    SCRATCH,
    SETTING,
    WEIGHTS,
    ZONES,
    Primitive,
)

F, F0, LAM = {"f": FUNCTION}, {"f0": FUNCTION}, {"lam": COLUMN}
STEP = {**F, **F0, "g": NORMS, **LAM}
MODEL = {"model": SETTING}

for row in (
    Primitive("degree", {}, COLUMN, calls.degree, out=False),
    Primitive("largest_weight", {}, COLUMN, calls.largest, out=False),
    Primitive("difference", F, EDGES, calls.difference),
    Primitive("adjoint", {"H": EDGES}, FUNCTION, calls.adjoint),
    Primitive(
        "gradient_norm",
        {**F, "power": SETTING, "eps": SETTING, "coupled": SETTING, "edge_power": SETTING},
        NORMS,
        calls.gradient_norm,
    ),
    Primitive("p_laplacian", {**F, "g": NORMS}, FUNCTION, calls.p_laplacian),
    Primitive("jacobi_step", {**STEP, "theta": SETTING}, FUNCTION, calls.jacobi_step),
    Primitive("euler_step", {**STEP, "tau": COLUMN}, FUNCTION, calls.euler_step),
    Primitive("energy", {**F, **F0, **LAM, **MODEL}, NUMBER, calls.energy, out=False),
    Primitive(
        "sweep",
        {**F, **F0, **LAM, **MODEL, "theta": SETTING, "g": SCRATCH},
        FUNCTION,
        calls.sweep,
        parts=("gradient_norm", "jacobi_step"),
    ),
    Primitive("max_change", {"a": FUNCTION, "b": FUNCTION}, NUMBER, calls.max_change, weights=False, out=False),
    Primitive("dot", {"a": FUNCTION, "b": FUNCTION, "over": COLUMN}, NUMBER, calls_dual.dot, weights=False, out=False),
    Primitive(
        "combine",
        {"a": SETTING, "x": FUNCTION, "b": SETTING, "y": FUNCTION, "over": COLUMN},
        FUNCTION,
        calls_dual.combine,
        weights=False,
    ),
    Primitive("gradient", STEP, FUNCTION, calls_dual.gradient),
    Primitive(
        "dual_step",
        {
            "y": EDGES, "previous": EDGES, **F, "f_previous": FUNCTION, **MODEL, "beta": SETTING, "sigma": COLUMN,
        },
        EDGES,
        calls_dual.dual_step,
    ),
    Primitive(
        "proximal", {**F, "y": EDGES, **F0, **LAM, "tau": COLUMN, "box": SETTING}, FUNCTION, calls_dual.proximal
    ),
    Primitive("primal", {"y": EDGES, **F0, **LAM}, FUNCTION, calls_dual.primal),
    Primitive(
        "duality_gap",
        {**F, "y": EDGES, **F0, **LAM, **MODEL, "box": SETTING},
        NUMBER,
        calls_dual.duality_gap,
        out=False,
    ),
    Primitive(
        "patch_distance", {"f": HOST, "form": SETTING}, WEIGHTS, calls_patches.patch_distance, weights=False, out=False
    ),
    Primitive(
        "similarity_step",
        {"f": HOST, "form": SETTING, **F0, **LAM, "guide": GUIDE},
        FUNCTION,
        calls_patches.similarity_step,
        weights=False,
        graphs=("grid",),
    ),
    Primitive(
        "aggregate",
        {**F, "share": COLUMN, "centre": COLUMN, "radius": SETTING},
        FUNCTION,
        calls_patches.aggregate,
        columns=("share", "centre"),
        graphs=("grid",),
    ),
    Primitive(
        "influence_zones",
        {"lengths": LENGTHS, "sources": LABELS},
        ZONES,
        calls_patches.influence_zones,
        weights=False,
        out=False,
    ),
    Primitive("flat_zones", {"lengths": LENGTHS}, LABELS, calls_patches.flat_zones, weights=False, out=False),
):  # fmt: skip
    ROWS[row.name] = row
