"""The certified solver where lam is 0 at some vertices and infinite at others: gaps, bounds, components without data.

The truth: a conic solver on eq. 19, 20 and 30 as they stand, and energies in float64 from the definition.
"""

from __future__ import annotations

import functools
import warnings
from typing import Any

import cases
import closed_forms
import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_certified import ORACLE, directed
from test_processes import draw

import gpureg as gr
from gpureg.arrays import FloatArray

GRAPH = cases.irregular(13, 40, isolated=5)
# 0 at vertices 0, 5 and 10, of which no edge reaches 5; infinite at 3
LAM = cases.fidelity(GRAPH)[:, 0]
F0 = np.where(LAM[:, None] > 0, cases.function(GRAPH, 2), 50)
TOL = {"float64": 1e-5, "float32": 1e-4}
both_norms = pytest.mark.parametrize("norm", ["vertex", "edge"])


def solve(f0=F0, graph=GRAPH, method: str = "auto", **given) -> gr.Result:
    """Run without the warning that some vertices have no data."""
    model = {**ORACLE, "tol": 1e-6, "lam": LAM, **given}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "[0-9]+ vert.*without data", RuntimeWarning)
        return gr.regularize(f0, graph, solver=gr.Certified(method=method), **model)


def gamma_of(kind: str, graph: gr.Graph) -> FloatArray | None:
    """gamma(u, v) of each directed edge, from its definition."""
    rows = graph.edge_rows()
    w = np.ones(len(rows)) if graph.weights is None else graph.weights.astype(float)
    degree = np.bincount(rows, w, minlength=graph.n_vertices)
    if kind in ("normalized", "degree"):
        share = np.sqrt((2 if kind == "normalized" else 1) * np.where(degree > 0, degree, 1))
        return np.sqrt(w) / share[rows]
    return cases.rng(31).random(graph.n_edges) if kind == "array" else np.sqrt(w)


def energy_of(f, f0, graph, *, p: float, lam, norm: str = "vertex", gamma=None, eps: float = 0.0) -> float:
    """The energy in float64, from eq. 19, 20 and 30; the data at pinned vertices."""
    D, rows = directed(graph, gamma)
    lam = np.broadcast_to(np.asarray(lam, float), len(f0))
    f = np.where(np.isinf(lam)[:, None], f0, f).astype(float)
    square = ((D @ f) ** 2).sum(axis=1)
    if norm == "vertex":
        square = np.bincount(rows, square, minlength=len(f0))
    smooth = (1.0 if norm == "vertex" else 0.5) * ((square + eps**2) ** (p / 2)).sum() / p
    weight = np.where(np.isinf(lam), 0, lam)[:, None]
    return float(smooth + (weight * (f - f0) ** 2).sum() / 2)


@functools.cache
def minimum(p: float, norm: str = "vertex", kind: str = "sqrt") -> float:
    """The minimum of the energy on GRAPH, by cvxpy with Clarabel."""
    gamma = gamma_of(kind, GRAPH)
    D, rows = directed(GRAPH, gamma)
    f, pinned = cp.Variable(F0.shape), np.isinf(LAM)
    if norm == "edge":
        groups, share = [[k] for k in range(len(rows))], 0.5
    else:
        groups, share = [np.flatnonzero(rows == u).tolist() for u in range(len(F0))], 1.0
    lengths = cp.hstack([cp.norm(cp.vec((D @ f)[e], order="F")) for e in groups if e])
    smooth = cp.sum(lengths) if p == 1 else cp.sum(cp.power(lengths, p)) / p
    weight = np.sqrt(np.where(pinned, 0, LAM))[:, None]
    energy = share * smooth + cp.sum_squares(cp.multiply(weight, f - F0)) / 2
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Solution may be inaccurate", UserWarning)
        cp.Problem(cp.Minimize(energy), [f[pinned] == F0[pinned]]).solve(solver=cp.CLARABEL)
    # of what it found, which has 1e-7 of accuracy or more
    return energy_of(f.value, F0, GRAPH, p=p, lam=LAM, norm=norm, gamma=gamma)


@both_norms
@pytest.mark.parametrize("p", closed_forms.P)
@pytest.mark.parametrize("dtype", TOL)
def test_every_gap_encloses_the_optimum(device: str, dtype: str, p: float, norm: str) -> None:
    """lam with zeros and infinities, an isolated vertex without data, and f0 = 50 where lam is 0."""
    result = solve(p=p, norm=norm, backend=device, dtype=dtype, tol=TOL[dtype])
    best = minimum(p, norm)
    assert result.stop is gr.Stop.GAP_NO_DATA
    # the minimum is that of a function; Clarabel's tolerance is 1e-8
    assert result.lower_bound <= best
    assert best <= result.energy[-1] * (1 + 1e-6)
    # the rounding of the energy is not part of what `tol` is compared with
    assert result.gap <= (TOL[dtype] + 400 * np.finfo(dtype).eps) * result.energy[-1]
    assert energy_of(result.value, F0, GRAPH, p=p, lam=LAM, norm=norm) == pytest.approx(result.energy[-1], rel=1e-5)


@both_norms
@pytest.mark.parametrize(
    ("p", "method"),
    [
        *((p, method) for p in (1.0, 1.5, 2.0) for method in ("primal-dual", "newton")),
        (2.0, "linear"),
        (3.0, "newton"),
    ],
)
def test_every_method(p: float, norm: str, method: str) -> None:
    result = solve(method=method, p=p, norm=norm)
    assert result.stop is gr.Stop.GAP_NO_DATA
    assert result.lower_bound <= minimum(p, norm) <= result.energy[-1] * (1 + 1e-6)


@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("kind", ["normalized", "degree", "array"])
def test_every_gamma(kind: str, p: float) -> None:
    """The box holds s f; that of an array is wider than the data's range, which minimisers leave."""
    gamma = gamma_of(kind, GRAPH)
    result = solve(p=p, gamma=gamma if kind == "array" else kind)
    best = minimum(p, "vertex", kind)
    assert result.stop in (gr.Stop.GAP, gr.Stop.GAP_NO_DATA)
    assert result.lower_bound <= best <= result.energy[-1] * (1 + 1e-6)
    reached = energy_of(result.value, F0, GRAPH, p=p, lam=LAM, gamma=gamma)
    assert reached == pytest.approx(result.energy[-1], rel=1e-9)


# Any problem


@given(st.data())
@settings(max_examples=40, deadline=None)
def test_no_energy_is_below_the_lower_bound(data: st.DataObject) -> None:
    """Any graph, p, gamma, norm and lam, in float32 of data that it does not hold: no function of a sharper run."""
    graph, f0 = draw(data)
    f0 = f0 * data.draw(st.sampled_from([1.0, 0.1, 1e3])) + data.draw(st.sampled_from([0.0, 100.0]))
    lam = np.array(data.draw(st.lists(st.sampled_from([0, 0, 0.1, 1, 10, np.inf]), min_size=len(f0), max_size=len(f0))))
    p = data.draw(st.one_of(st.sampled_from([1.0, 1.5, 2.0, 3.0]), st.floats(1, 6)))
    kind = data.draw(st.sampled_from(["sqrt", "normalized", "degree", "array"]))
    gamma = gamma_of(kind, graph)
    model: dict[str, Any] = {"p": p, "lam": lam, "norm": data.draw(st.sampled_from(["vertex", "edge"]))}
    model["eps"] = data.draw(st.sampled_from([0.0, 0.0, 0.1]))
    given = {**model, "gamma": gamma if kind == "array" else kind, "max_iter": 300}
    loose = solve(f0, graph, dtype="float32", tol=data.draw(st.sampled_from([1e-2, 1e-6])), **given)
    sharp = solve(f0, graph, tol=1e-10, **given)
    reached = energy_of(sharp.value, f0, graph, gamma=gamma, **model)
    slack = 1e-12 * reached
    assert loose.gap >= 0
    assert loose.lower_bound <= reached + slack
    assert sharp.lower_bound <= energy_of(loose.value, f0, graph, gamma=gamma, **model) + slack
    assert sharp.lower_bound <= reached + slack
    if loose.error_bound is not None and sharp.error_bound is not None:
        # roundings of the values
        apart = np.linalg.norm(loose.value - sharp.value)
        assert apart <= loose.error_bound + sharp.error_bound + 1e-6 * np.linalg.norm(f0)
