"""The checks can fail: a wrong sign, a missing factor, an off-by-one, a lost eps in a kernel must be noticed."""

from __future__ import annotations

import dataclasses

import cases
import mutations
import numpy as np
import pytest
import rows  # noqa: F401, fills ROWS
from checking import check
from guards import guarded
from mutations import Mutation
from primitives import ROWS, assert_within
from problems import CLASSES, Kind, PatchCase, PatchKind
from test_primitives import PAIRS

from gpureg import backends

GRID, FORM = Kind(cases.SETUPS[0]), Kind(cases.Setup("grid"))
CSR, VOLUME = Kind(cases.Setup("csr", full=True, wide=True)), Kind(cases.Setup("volume", wide=True))
EDGE = Kind(cases.Setup("grid"), edge_norm=True)
# a few of the classes of p that there are
BALL, SMOOTH_BALL, NEWTON = (Kind(cases.Setup("grid"), classes=(CLASSES[i],)) for i in (0, 4, 5))
PATCHES = PatchKind(PatchCase("grid", scale=0.5, spatial=True, shift=0.125, wide=True))
STEP = PatchKind(PatchCase("narrow", radius=4, scale=0.01))
MASKED = PatchKind(PatchCase("masked", radius=0, scale=2.0, spatial=True), lam="array")
AVERAGED, ZONES = Kind(cases.Setup("volume")), Kind(cases.Setup("csr"))

OPENCL = [
    (Mutation("jacobi_step", "jacobi_step", "total[c] += HOLD", "total[c] -= HOLD"), GRID),
    (Mutation("jacobi_step", "jacobi_step", "isinf(lam) || !(denominator", "!(denominator"), GRID),
    (Mutation("jacobi_step", "jacobi_step", "here[c] + theta *", "here[c] + (real)1.00001f * theta *"), GRID),
    (
        Mutation(
            "jacobi_step",
            "conductance",
            "LOAD(g, AT(u, c, G)) + LOAD(g, AT(v, c, G))",
            "LOAD(g, AT(u, c, G)) + LOAD(g, AT(u, c, G))",
        ),
        GRID,
    ),
    (Mutation("jacobi_step", "conductance", "raise(conductance[c], power)", "raise(conductance[c], -power)"), EDGE),
    (Mutation("gradient_norm", "squared_gradient", "sum[c] += eps2", "sum[c] += 0"), GRID),
    (Mutation("p_laplacian", "grid", "k < WINDOW; ++k) {", "k < WINDOW - 1; ++k) {"), GRID),
    (Mutation("degree", "grid", "used = (x) + LANES < width", "used = (x) + LANES < width - 1"), GRID),
    (Mutation("energy", "energy", "fidelity += d * d", "fidelity += d"), GRID),
    (Mutation("energy", "squared_gradient", "WHERE(PRESENT, raise", "WHERE(true, raise"), EDGE),
    (Mutation("difference", "difference", "USED(DERIVED(d))", "USED(d)"), FORM),
    (Mutation("difference", "difference", "CLEAR_EDGES(out, M)\n", "\n"), FORM),
    (Mutation("adjoint", "adjoint", "OWN *", "PULL *"), FORM),
    (Mutation("euler_step", "euler_step", "lam * (data - here[c])", "lam * (data + here[c])"), FORM),
    (Mutation("dot", "dot", "USED(OVER_OF(product, c))", "USED(product)"), BALL),
    (Mutation("combine", "combine", "+ TERM(b, OVER_OF", "- TERM(b, OVER_OF"), BALL),
    (Mutation("dual_step", "dual_step", "sigma * DERIVED(d)", "sigma * d"), BALL),
    (Mutation("dual_step", "prox", "r * inverse, 1 - part * less", "inverse, 1 - part * less"), NEWTON),
    (Mutation("duality_gap", "duality_gap", "derivative[c] + eps * eps, p / 2", "derivative[c], p / 2"), SMOOTH_BALL),
    (Mutation("duality_gap", "duality_gap", "/ (2 * lam);", "/ lam;"), BALL),
    (Mutation("sweep", "sweep", "total[c] += HOLD * conductance[c]", "total[c] += conductance[c]"), GRID),
    (Mutation("patch_distance", "strip", "fmax(rho - shift, (realN)", "fmax(rho + shift, (realN)"), PATCHES),
    (Mutation("similarity_step", "similarity_step", "LOAD(slot, to) + far", "far"), STEP),
    (Mutation("aggregate", "aggregate", "j <= 2 * R", "j < 2 * R"), AVERAGED),
    (Mutation("influence_zones", "influence_zones", "tag[v]) + hop", "tag[v])"), ZONES),
]

WARP = [
    (
        Mutation("degree", "grid", "inside = wp.uint32(v[1]) < wp.uint32(graph.width)", "inside = v[1] < graph.width"),
        VOLUME,
    ),
    (Mutation("jacobi_step", "conductance", "g_at(g, u[0], u[1]) + g_at(g, v", "g_at(g, v[0], v[1]) + g_at(g, v"), CSR),
    (Mutation("sweep", "gradient_norm", "total += eps2;", ""), GRID),
    (Mutation("energy", "energy", "wp.dot(d, d) / real(2.0)", "wp.dot(d, d)"), GRID),
    (Mutation("adjoint", "adjoint", "there[2]) - value_at", "there[2]) + value_at"), FORM),
    (Mutation("dot", "dot", "wp.dot(at(a, row, x)", "wp.dot(-at(a, row, x)"), BALL),
    (Mutation("combine", "combine", "+ b * quotient(at(y, row, k), over, row, k)", "+ b * at(y, row, k)"), BALL),
    (Mutation("dual_step", "dual_step", "derived(e, difference(", "(difference("), BALL),
    (Mutation("dual_step", "prox", "r * inverse, one - part * less", "inverse, one - part * less"), NEWTON),
    (Mutation("duality_gap", "prox", "raise_(square + eps * eps, p / two)", "raise_(square, p / two)"), SMOOTH_BALL),
    (Mutation("duality_gap", "duality_gap", "(real(2.0) * lam_u)", "lam_u"), BALL),
    (Mutation("patch_distance", "patch_distance", "from <= y && y < until;", "from < y && y < until;"), PATCHES),
    (Mutation("similarity_step", "similarity_step", "T(2) * ((const T*)&total", "((const T*)&total"), MASKED),
    (Mutation("aggregate", "aggregate", "if exists(graph, u) and exists(graph, v):", "if exists(graph, u):"), AVERAGED),
    (Mutation("influence_zones", "influence_zones", "t += z.hop", "t += wp.int64(0)"), ZONES),
]


def passes_unchanged(kind, name):
    """Whether tests/backends/test_primitives.py makes this comparison with the right kernels."""
    every_class = dataclasses.replace(kind, classes=CLASSES) if isinstance(kind, Kind) and kind.classes else kind
    return {(kind, name), (every_class, name)} & set(PAIRS)


@pytest.mark.parametrize(("mutation", "kind"), OPENCL, ids=[mutation.id for mutation, _ in OPENCL])
def test_a_broken_opencl_kernel_is_noticed(monkeypatch, mutation, kind):
    """One wrong term in a kernel breaks the comparison that passes without it, in tests/backends/test_primitives.py."""
    assert passes_unchanged(kind, mutation.primitive)
    backend = mutations.opencl(mutation, monkeypatch)
    with pytest.raises(AssertionError, match="out of bounds"):
        check(backend, ROWS[mutation.primitive], kind.make(), first=True)


@pytest.mark.parametrize(("mutation", "kind"), WARP, ids=[mutation.id for mutation, _ in WARP])
def test_a_broken_warp_kernel_is_noticed(monkeypatch, tmp_path, mutation, kind):
    assert passes_unchanged(kind, mutation.primitive)
    backend = mutations.warp(mutation, monkeypatch, tmp_path)
    with pytest.raises(AssertionError, match="out of bounds"):
        check(backend, ROWS[mutation.primitive], kind.make(), first=True)


def test_an_output_left_unwritten_is_noticed():
    with pytest.raises(AssertionError, match="1 of 2 numbers are out of bounds"):
        assert_within([1.0, float("nan")], [1.0, 1.0], float("inf"), "a primitive")


# Writes outside of an array. The guards notice.

STORED = Kind(cases.Setup("csr"), classes=CLASSES[:1])
OUTSIDE = [
    ("opencl", Mutation("combine", "csr", "if (u >= n) return;", "if (u > n) return;"), STORED),
    ("warp", Mutation("combine", "combine", "put(out, row, k, a *", "put(out, row, k + 1, a *"), BALL),
]


@pytest.mark.parametrize(("language", "mutation", "kind"), OUTSIDE, ids=[language for language, *_ in OUTSIDE])
def test_a_write_outside_is_noticed(monkeypatch, tmp_path, language, mutation, kind):
    folder = (tmp_path,) if language == "warp" else ()
    backend = getattr(mutations, language)(mutation, monkeypatch, *folder)
    with pytest.raises(AssertionError, match="bytes written outside of an array, behind it"):
        check(backend, ROWS[mutation.primitive], kind.make(), first=True)


def test_a_write_outside_is_noticed_in_numpy():
    """Through a view that reaches further than the array."""
    backend, one = guarded(backends.get("numpy", "float32")), GRID.make()
    out = backend.empty(one.graph, 1)
    backend.check_guards()
    out = backend.empty(one.graph, 1)
    np.lib.stride_tricks.as_strided(out, (len(out) + 1, 1))[-1] = 0
    with pytest.raises(AssertionError, match="4 bytes written outside of an array, behind it"):
        backend.check_guards()
