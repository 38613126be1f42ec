"""Derivatives against central differences of minimisers that another program finds: scipy, from the equations alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import root

import gpureg as gr

GRAPH = gr.Graph.from_edges(
    [[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 6], [6, 7], [0, 3], [1, 4], [2, 6], [5, 7]],
    [1.0, 0.6, 1.3, 0.8, 1.1, 0.5, 0.9, 0.7, 1.2, 0.4, 1.5],
)
GRID = gr.GridGraph((2, 4))
# in far and large units, so that the frame has an offset and a scale
SCALE, OFFSET = 37.0, 900.0
DEGREES = (1, 1.2, 1.5, 2, 3, 6)
FEW = {"solver": gr.Jacobi(damping=1), "max_iter": 1, "backend": "numpy", "dtype": float}


def dense(graph, values):
    """The matrix of a number per directed edge of a stored graph."""
    found = np.zeros((graph.n_vertices,) * 2)
    found[np.repeat(np.arange(graph.n_vertices), np.diff(graph.indptr)), graph.indices] = values
    return found


def gamma_of(name, W):
    """Gamma as a matrix."""
    degree = W.sum(axis=1, keepdims=True)
    factor = {"sqrt": 1.0, "combinatorial": 0.5, "normalized": 0.5 / degree, "degree": 1 / degree}[name]
    return np.sqrt(W * factor)


def gradient(f, model):
    """The gradient of eq. 19 with eq. 20 or 30, as sums over all pairs, (n, m)."""
    G = model["G"]
    d = G.T[:, :, None] * f[None] - G[:, :, None] * f[:, None]
    square = d**2
    if model["coupled"]:
        square = square.sum(axis=2, keepdims=True)
    if model["norm"] == "vertex":
        square = square.sum(axis=1, keepdims=True)
    q, share = square + model["eps"] ** 2, 0.5 if model["norm"] == "edge" else 1.0
    with np.errstate(divide="ignore"):
        c = np.where(q > 0, q ** ((model["p"] - 2) / 2), 0)
    flux = share * c * d
    smooth = (G[:, :, None] * (flux.transpose(1, 0, 2) - flux)).sum(axis=1)
    return np.where(np.isfinite(model["lam"]), model["lam"], 0) * (f - model["f0"]) + smooth


def minimiser(model, start):
    """The minimiser, from a start near it, (n, m)."""
    free = np.isfinite(model["lam"])[:, 0]
    f = np.where(free[:, None], start, model["f0"])

    def residual(x):
        f[free] = x.reshape(-1, f.shape[1])
        return gradient(f, model)[free].ravel() / weight

    weight = 1.0
    weight = np.abs(residual(start[free].ravel() + 0.01 * SCALE)).max()
    x = start[free].ravel()
    for _ in range(3):
        x = root(residual, x, options={"xtol": 1e-15, "factor": 0.1}).x
    f[free] = x.reshape(-1, f.shape[1])
    return f.copy()


def difference(value, step):
    """The derivative at 0 by central differences of two steps, whose errors cancel up to the fourth power."""
    coarse, fine = ((value(h) - value(-h)) / (2 * h) for h in (step, step / 2))
    return (4 * fine - coarse) / 3


def check(found, model, changes, slope, start):
    """Compare the derivatives `found`, by name, with differences along `changes`."""
    for name, (change, step, tolerance) in changes.items():

        def value(h, change=change, name=name):
            moved = {**model, **change(h)}
            return float((slope * minimiser(moved, start)).sum())

        expected = difference(value, step)
        assert found[name][0] == pytest.approx(expected, abs=tolerance * found[name][1] + 1e-9 * SCALE), name


def along(derivative, change):
    """A derivative along a change, and the sum of the sizes of its terms."""
    return float((derivative * change).sum()), float(np.abs(derivative * change).sum())


@pytest.mark.parametrize("norm", ["vertex", "edge"])
@pytest.mark.parametrize("p", DEGREES)
@pytest.mark.parametrize(
    ("graph", "gamma", "coupled"),
    [(GRAPH, "sqrt", True), (GRID, "combinatorial", False), (GRAPH, "normalized", True)],
    ids=["graph", "grid", "degrees"],
)
def test_derivatives(p, norm, graph, gamma, coupled):
    """f0, lam with zeros and infinities, weights, p and eps, of two channels."""
    rng = np.random.default_rng(5)
    stored = graph if isinstance(graph, gr.Graph) else graph.to_graph()
    n, m, shape = graph.n_vertices, 2, getattr(graph, "shape", (graph.n_vertices,))
    f0 = OFFSET * (gamma != "normalized") + SCALE * rng.random((n, m))
    eps = 0.1 * SCALE if p < 4 else 0.4 * SCALE  # where the curvature at lam = 0 is too small for steps of lam
    # of the order of the smoothness
    lam = SCALE ** (p - 2) * np.array([0, 0.5, np.inf, 2, 0, 1, 0, np.inf])
    once = dense(stored, rng.random(stored.n_edges))
    both, rows = once + once.T, stored.edge_rows()
    W = dense(stored, graph.weights) if graph is stored else both.T @ both * (both > 0)
    given = None if graph is stored else W[rows, stored.indices]
    result = gr.regularize(
        f0.reshape(*shape, m), graph, p=p, lam=lam.reshape(shape), weights=given, norm=norm, gamma=gamma,
        coupled=coupled, eps=eps, **FEW,
    )  # fmt: skip
    slope = rng.normal(size=(n, m))
    found = gr.derivatives(result, lambda _: slope.reshape(*shape, m))
    value, by_f0, by_lam = found.value.reshape(n, m), found.f0.reshape(n, m), found.lam.ravel()
    by_weights = found.weights if graph is stored else graph.edges.listed(found.weights, "weights")
    model = {"f0": f0, "lam": lam[:, None], "p": p, "eps": eps, "norm": norm, "coupled": coupled}
    model["G"] = gamma_of(gamma, W)
    df0, dlam = SCALE * rng.normal(size=(n, m)), np.where(np.isfinite(lam), SCALE ** (p - 2) * rng.random(n), 0)
    assert np.abs(gradient(value, model)[np.isfinite(lam)]).max() < 1e-9 * SCALE ** (p - 1)
    # at a lam of 0 a step back would leave the problem: the equation still has a solution near
    changes = {
        "f0": (lambda h: {"f0": f0 + h * df0}, 1e-3, 1e-6),
        "lam": (lambda h: {"lam": (lam + h * dlam)[:, None]}, 2e-4, 1e-6),
        "weights": (lambda h: {"G": gamma_of(gamma, W + h * both)}, 1e-3, 1e-6),
        "p": (lambda h: {"p": p + h}, 1e-3, 1e-5),
        "eps": (lambda h: {"eps": eps + h * SCALE}, 1e-3, 1e-5),
    }
    derivatives = {
        "f0": along(by_f0, df0),
        "lam": along(by_lam, dlam),
        "weights": along(by_weights, both[rows, stored.indices]),
        "p": (found.p, abs(found.p)),
        "eps": (found.eps * SCALE, abs(found.eps * SCALE)),
    }
    check(derivatives, model, changes, slope, value)
    assert by_lam[np.isinf(lam)].tolist() == [0, 0] and not by_f0[lam == 0].any()


@pytest.mark.parametrize(("p", "norm", "eps"), [(1.3, "vertex", 0.1), (3, "edge", 0.0), (2, "edge", 0.0)])
def test_gamma_of_each_direction(p, norm, eps):
    """A gamma that is not symmetric; with eps = 0 for p >= 2."""
    rng = np.random.default_rng(3)
    graph, n = GRAPH, GRAPH.n_vertices
    f0, lam = 1 + rng.random((n, 1)), np.array([0.5, 0.8, np.inf, 2, 0.3, 1, 1, np.inf])
    gamma, dgamma = 0.5 + rng.random(graph.n_edges), rng.normal(size=graph.n_edges)
    result = gr.regularize(f0, graph, p=p, lam=lam, norm=norm, gamma=gamma, eps=eps, **FEW)
    slope = rng.normal(size=(n, 1))
    found = gr.derivatives(result, lambda _: slope)
    assert found.weights is None and "gamma" in found.notes[0]
    model = {"f0": f0, "lam": lam[:, None], "p": p, "eps": eps, "norm": norm, "coupled": True}
    model["G"] = dense(graph, gamma)
    change = {"gamma": (lambda h: {"G": dense(graph, gamma + h * dgamma)}, 1e-3, 1e-6)}
    change["p"] = (lambda h: {"p": p + h}, 1e-3, 1e-5)
    derivatives = {"gamma": along(found.gamma, dgamma), "p": (found.p, abs(found.p))}
    check(derivatives, model, change, slope, found.value)
    assert found.eps == 0 or eps > 0
