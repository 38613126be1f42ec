"""Derivatives of sweeps against central differences of :func:`gpureg.regularize` with as many sweeps."""

from __future__ import annotations

import numpy as np
import pytest

import gpureg as gr

GRID = gr.GridGraph(
    (3, 4), radius=1, metric="cityblock", mask=np.array([[1, 1, 1, 0], [1, 1, 1, 1], [0, 1, 1, 1]], bool)
)
SCALE = 50.0
SWEEPS = 7


def sweeps(f0, graph, **model):
    """The result of a few sweeps in float64."""
    return gr.regularize(f0, graph, max_iter=SWEEPS, backend="numpy", dtype=float, **model)


def difference(value, step):
    """The derivative at 0 by central differences of two steps, whose errors cancel up to the fourth power."""
    coarse, fine = ((value(h) - value(-h)) / (2 * h) for h in (step, step / 2))
    return (4 * fine - coarse) / 3


@pytest.mark.parametrize(
    ("p", "norm", "eps", "gamma", "coupled", "kind"),
    [
        (0.6, "vertex", 10.0, "sqrt", True, "map"),
        (1, "edge", 5.0, "combinatorial", True, "number"),
        (1, "vertex", 5.0, "degree", True, "number"),
        (1.5, "vertex", 5.0, "sqrt", False, "map"),
        (2, "vertex", 5.0, "normalized", True, "map"),
        (2, "edge", 5.0, "sqrt", False, "number"),
        (3, "vertex", 5.0, "normalized", True, "map"),
        (3, "edge", 5.0, "sqrt", True, "number"),
    ],
)
def test_sweeps(p, norm, eps, gamma, coupled, kind):
    """All derivatives of K sweeps on a grid with a mask; with p > 2 the damping depends on p."""
    rng = np.random.default_rng(2)
    shape = (*GRID.shape, 2)
    f0, slope = 300.0 + SCALE * rng.random(shape), rng.normal(size=shape)
    unit = SCALE ** (p - 2)
    lam = 0.7 * unit if kind == "number" else unit * rng.random(GRID.shape)
    if kind == "map":
        lam[1, :2], lam[2, 3] = 0, np.inf
    half = 0.5 + rng.random((GRID.half_window, *GRID.shape))
    w, dw = GRID.edges.gather_half(half), GRID.edges.gather_half(half**2)
    model = {"f0": f0, "graph": GRID, "p": p, "lam": lam, "eps": eps, "norm": norm, "gamma": gamma, "weights": w}
    # the damping by default changes at p = 2
    damping = 1.0 if p == 2 else None
    model |= {"coupled": coupled, "solver": gr.Jacobi(damping=damping)}
    result = sweeps(**model)
    found = gr.derivatives(result, slope, unrolled=SWEEPS, damping=damping)
    assert found.distance < 1e-10 * SCALE
    df0 = SCALE * rng.normal(size=shape)
    dlam = np.where((lam > 0) & np.isfinite(lam), unit, 0) * (0.5 if kind == "number" else rng.random(GRID.shape))
    planes = GRID.edges.scatter(dw[:, None])[..., 0]
    changes = {
        "f0": (lambda h: {"f0": f0 + h * df0}, (found.f0 * df0).sum()),
        "lam": (lambda h: {"lam": lam + h * dlam}, (found.lam * dlam).sum()),
        "weights": (lambda h: {"weights": w + h * dw}, (found.weights * np.moveaxis(planes, 0, -1)).sum()),
        "p": (lambda h: {"p": p + h}, found.p),
        "eps": (lambda h: {"eps": eps + h * SCALE}, found.eps * SCALE),
    }
    for name, (change, derivative) in changes.items():

        def value(h, change=change):
            return float((slope * sweeps(**{**model, **change(h)}).value).sum())

        assert derivative == pytest.approx(difference(value, 1e-3), rel=1e-6, abs=1e-8 * SCALE), name
    assert found.f0[0, 3].tolist() == slope[0, 3].tolist()
