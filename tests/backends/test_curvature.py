"""Newton's primitives: against sums over lists of edges, and against differences of the gradient."""

from __future__ import annotations

from typing import Any

import cases
import numpy as np
import pytest
from checking import on
from guards import guarded
from problems import Kind
from second_order import Setting, compare

from gpureg.backends import Smoothness
from gpureg.backends.curvature import Bend

# p, eps, and whether there is a dual variable
PRIMAL_DUAL, BALL, CONVEX = (1.5, 0.125, True), (1.0, 0.125, True), (3.0, 2.0**-7, False)

PROBLEMS = [
    (Kind(cases.Setup("grid")), (PRIMAL_DUAL, CONVEX)),
    (Kind(cases.Setup("masked", 3), "float64", edge_norm=True), (PRIMAL_DUAL, CONVEX)),
    (Kind(cases.Setup("csr", 3), directed=True), (PRIMAL_DUAL, CONVEX)),
    (Kind(cases.Setup("csr", 3), edge_norm=True), (PRIMAL_DUAL, BALL, CONVEX)),
    (Kind(cases.Setup("volume"), directed=True, edge_norm=True), (BALL,)),
]
IDS = [kind.id for kind, _ in PROBLEMS]
MARKS = [() if at in (0, 3) else pytest.mark.one_driver for at in range(len(PROBLEMS))]


@pytest.mark.parametrize(
    ("kind", "models"), [pytest.param(*x, marks=m, id=i) for x, m, i in zip(PROBLEMS, MARKS, IDS, strict=True)]
)
def test_primitives(device, kind, models):
    """Within a counted bound, the same bits twice, and nothing written outside of an array."""
    backend = guarded(on(device, kind.dtype))
    with backend.framing():
        for model in models:
            compare(backend, Setting(kind.make(), *model))
    backend.check_guards()


def differentiated(oracle: Any, one: Any, p: float, eps: float, f: Any) -> Any:
    """The gradient of the energy of f."""
    model = Smoothness(p, eps, True, one.edge_norm)
    return oracle.gradient(one.on_oracle, f, one.f, oracle.conductances(one.on_oracle, f, model), one.lam)


def bend(oracle: Any, one: Any, p: float, eps: float, f: Any, h: Any, y: Any) -> Bend:
    """As a solver makes it."""
    model, g, products = Smoothness(p, eps, True, one.edge_norm), None, None
    if not one.edge_norm:
        q = oracle.gradient_norm(one.on_oracle, f, power=1, eps=eps, coupled=True)
        g, by = q ** ((p - 2) / 2), (2 - p) * (q ** ((p - 4) / 2) if y is None else 1 / q)
        products = oracle.gradient_product(one.on_oracle, f, h, by, y=y)
    return Bend(f, model, y, g, products)


def slopes(oracle: Any, one: Any, p: float, eps: float, f: Any) -> Any:
    """y = share q^((p-2)/2) df, a host function on the edges."""
    df = one.dual.difference(f)[0]
    q = one.dual.norms(df**2) + eps**2
    return one.host(one.dual.share * (q if one.edge_norm else q[one.rows]) ** ((p - 2) / 2) * df)


@pytest.mark.parametrize("edge_norm", [False, True])
@pytest.mark.parametrize("p", [1.0, 1.5, 3.0])
@pytest.mark.parametrize(("graph", "directed"), [("small masked", False), ("small csr", True)])
def test_second_derivative(oracle, graph, directed, edge_norm, p):
    """The Hessian is the derivative of the gradient, and Newton's step of y that of the slopes.

    By central differences of step t = 1e-4: the third derivative enters with t^2 = 1e-8, rounding with 1e-16/t. y has
    one-sided ones, of an error of t times the second derivative: it falls by 16 from t to t/4.
    """
    one, eps = Kind(cases.Setup(graph, 3), "float64", directed=directed, edge_norm=edge_norm).make(), 0.25
    f, h, t = one.f, one.f_before - 0.5, 1e-4
    ahead, behind = (differentiated(oracle, one, p, eps, f + step * h) for step in (t, -t))
    expected = (ahead - behind) / (2 * t)
    y = slopes(oracle, one, p, eps, f)
    for dual in (None, y):
        found = oracle.hessian(one.on_oracle, h, bend(oracle, one, p, eps, f, h, dual), one.lam)
        assert np.abs(found - expected).max() <= 1e-6 * np.abs(expected).max(), "with y" if dual is y else "without y"
    left = []
    for step in (t, t / 4):
        moved = step * h
        after = oracle.dual_newton(one.on_oracle, moved, bend(oracle, one, p, eps, f, moved, y.copy()))
        left.append(np.abs(after - slopes(oracle, one, p, eps, f + moved)).max())
    assert left[1] < left[0] / 12


def test_shortened_y_makes_the_matrix_positive(oracle):
    """For a y no longer than the slopes can be, as Chan, Golub and Mulet show; a longer one can turn its sign."""
    one, p, eps = Kind(cases.Setup("small masked", 3), "float64").make(), 1.0, 2.0**-7
    q = oracle.gradient_norm(one.on_oracle, one.f, power=1, eps=eps, coupled=True)
    model, rng = Smoothness(p, eps), cases.rng(5)
    least = []
    for shortened in (True, False):
        y = 100 * one.host(one.y)
        if shortened:
            y = oracle.shorten(one.on_oracle, y, one.f, model, q ** ((p - 1) / 2))
        energies = []
        for _ in range(50):
            h = rng.random(one.f.shape) - 0.5
            product = oracle.hessian(one.on_oracle, h, bend(oracle, one, p, eps, one.f, h, y), 0.0)
            energies.append((h * product).sum())
        least.append(min(energies))
    assert least[0] >= 0 > least[1]
