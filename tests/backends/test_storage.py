"""Weights on a grid in float16, and weights that are computed at each use instead of stored."""

from __future__ import annotations

import dataclasses

import cases
import numpy as np
import pytest
from checking import nan
from numpy.testing import assert_array_equal
from problems import PatchCase, oracle

import gpureg as gr
from gpureg import backends
from gpureg.backends import BackendUnavailable, PatchForm, Smoothness

# Masks, a spatial factor, channels, a wide window, one and three axes, float64.
BILATERAL = (
    PatchCase("grid", radius=0, scale=2.0, spatial=True, wide=True),
    PatchCase("masked", channels=3, radius=0, scale=2.0, spatial=True),
    PatchCase("narrow", radius=0, scale=0.5),
    PatchCase("volume", radius=0, scale=2.0, shift=0.01),
    PatchCase("row", radius=0, scale=2.0),
)
PATCHES = (*BILATERAL[:3], PatchCase("grid", radius=2, scale=0.5), PatchCase("volume", radius=1, scale=4.0))

# What Warp is tried on: a mask and channels, float64.
ON_WARP = BILATERAL[:2]

# Of a weight rounded to float16: relative, and absolute where it is below the normal numbers (README of the kernels).
RELATIVE, ABSOLUTE = 2.0**-11, 2.0**-25


def made(name, storage, case, dtype="float32"):
    """The backend and the case's weights on it."""
    backend = backends.get(name, dtype)
    if backend.name == "warp" and case not in ON_WARP:
        pytest.skip("a few are enough: Warp's programs take seconds")
    graph = cases.graph(case.graph)
    f = cases.function(graph, case.channels)
    return backend, graph, f, backend.patch_distance(graph, f, case.form(graph), storage=storage)


def everything(backend, graph, weighted, channels, few=False):
    """What the primitives that read weights make of them, on the host, in float64; a few: the sweep alone.

    Each is a compilation of its own for every kind of grid.
    """
    f, f0 = (backend.put(graph, cases.function(graph, channels, seed=seed)) for seed in (11, 13))
    lam, g = backend.put(graph, cases.fidelity(graph)), nan(backend, graph, 1)
    settings = {"model": Smoothness(1.0, cases.EPS), "theta": 0.625}
    if few:
        swept = backend.sweep(weighted, f, f0, lam, g=g, out=nan(backend, graph, channels), **settings)
        return {"sweep": backend.get(graph, swept).astype(np.float64)}
    found = {
        "degree": backend.degree(weighted),
        "gradient_norm": backend.gradient_norm(weighted, f, power=-0.5, eps=cases.EPS, coupled=True, out=g),
        "p_laplacian": backend.p_laplacian(weighted, f, g, out=nan(backend, graph, channels)),
        "jacobi_step": backend.jacobi_step(weighted, f, f0, g, lam, out=nan(backend, graph, channels)),
        "euler_step": backend.euler_step(weighted, f, f0, Smoothness(1.5, cases.EPS, True, edge=True), lam, 0.125),
        "sweep": backend.sweep(
            weighted, f, f0, lam, g=nan(backend, graph, 1), out=nan(backend, graph, channels), **settings
        ),
    }
    hosts = {name: backend.get(graph, x).astype(np.float64) for name, x in found.items()}
    hosts["difference"] = backend.get_edges(graph, backend.difference(weighted, f)).astype(np.float64)
    hosts["energy"] = np.array(backend.energy(weighted, f, f0, lam, Smoothness(1.0, cases.EPS)))
    return hosts


def far(found, expected, dtype):
    """The primitives whose results are too far from what they should be, and by how much of the largest value."""
    off = {name: np.abs(found[name] - x).max() / max(np.abs(x).max(initial=0), 1e-300) for name, x in expected.items()}
    return {name: share for name, share in off.items() if not share <= cases.TOLERANCES[dtype]}


def on_a_driver(case):
    """Every driver converts to float16 by itself, which one case shows."""
    return pytest.param(case, id=case.id, marks=() if case is PATCHES[0] else pytest.mark.one_driver)


@pytest.mark.parametrize("case", [on_a_driver(case) for case in PATCHES])
def test_weights_in_float16(device, case):
    """Rounded to the nearest, zeros where they were; what is made of them is what the rounded weights give."""
    dtype = "float64" if case.wide else "float32"
    backend, graph, f, weighted = made(device, "half", case, dtype)
    actual = backend.get_weights(weighted).astype(np.float64)
    full = backend.get_weights(backend.patch_distance(graph, f, case.form(graph))).astype(np.float64)
    # rounding of a float32 on the way adds 2^-24 of its size
    assert (np.abs(actual - full) <= (RELATIVE + 2.0**-23) * full + ABSOLUTE).all()
    assert_array_equal(actual, actual.astype(np.float16).astype(np.float64))
    assert not actual[full == 0].any()
    exact = oracle()
    few = case is not PATCHES[0] or backend.name == "warp"
    expected = everything(exact, graph, exact.prepare(graph, actual), case.channels, few)
    assert not far(everything(backend, graph, weighted, case.channels, few), expected, dtype)


@pytest.mark.one_driver
@pytest.mark.parametrize("case", BILATERAL, ids=lambda case: case.id)
def test_weights_that_are_computed_at_each_use(device, case):
    """What is made of them is what the stored weights give."""
    dtype = "float64" if case.wide else "float32"
    backend, graph, f, weighted = made(device, "none", case, dtype)
    stored = backend.patch_distance(graph, f, case.form(graph))
    assert_array_equal(backend.get_weights(weighted), backend.get_weights(stored))
    few = case not in BILATERAL[:2] or backend.name == "warp"
    exact = oracle().patch_distance(graph, f, case.form(graph))
    expected = everything(oracle(), graph, exact, case.channels, few)
    assert not far(everything(backend, graph, weighted, case.channels, few), expected, dtype)


@pytest.mark.one_driver
@pytest.mark.parametrize("p", [1.0, 1.5, 2.0])
def test_the_stated_error_of_a_sweep(device, p):
    """(2 + |p - 2|) 2^-11 of the range at most: the docstring of gpureg.weights.half."""
    grid = cases.graph("grid")
    f0 = cases.function(grid)
    weights = gr.weights.bilateral(2.0, 0.7)
    run = dict(p=p, lam=0.5, max_iter=1, backend=device, solver=gr.Jacobi(damping=1))
    full, half = (gr.regularize(f0, grid, weights=w, **run).value for w in (weights, gr.weights.half(weights)))
    off = np.abs(full - half).max()
    assert 0 < off <= ((2 + abs(p - 2)) * RELATIVE + cases.TOLERANCES["float32"]) * np.ptp(f0)


both_ways = pytest.mark.parametrize("held", ["half", "recomputed"])


@pytest.mark.one_driver
@pytest.mark.parametrize(("held", "limit"), [("half", 1e-2), ("recomputed", 1e-5)])
def test_through_the_doors(device, held, limit):
    """regularize with a guide, in tiles, and denoise_image take such weights."""
    plain = gr.weights.bilateral(2.0, 0.7)
    weights = getattr(gr.weights, held)(plain)
    image = cases.function(gr.GridGraph((40, 33))).reshape(40, 33)
    grid = gr.GridGraph(image.shape, 2)
    run = dict(p=1, lam=2.0, max_iter=3, backend=device)
    whole = gr.regularize(image, grid, weights=weights, **run)
    assert np.abs(whole.value - gr.regularize(image, grid, weights=plain, **run).value).max() <= limit
    guided = gr.regularize(image, grid, weights=gr.weights.guided(weights, image.ravel()), **run)
    assert_array_equal(guided.value, whole.value)
    needed = gr.memory_needed(grid, p=1, weights=weights, backend=device)
    tiled = gr.regularize(image, grid, weights=weights, memory=int(0.8 * needed), **run)
    assert "tiles" in tiled.method
    assert_array_equal(tiled.value, whole.value)
    assert np.isfinite(gr.denoise_image(image, p=1, lam=2.0, radius=2, weights=weights, backend=device)).all()


@pytest.mark.one_driver
def test_memory_is_saved_where_it_is_promised(device):
    grid = gr.GridGraph((64, 64), 8)
    plain = gr.weights.bilateral(4.0, 0.5)
    full, half, none = (
        gr.memory_needed(grid, p=1, weights=w, backend=device)
        for w in (plain, gr.weights.half(plain), gr.weights.recomputed(plain))
    )
    if backends.get(device).name != "numpy":
        assert none < half / 4 < half < 0.6 * full
    else:
        assert none == half == full


@both_ways
def test_a_stored_graph_says_so(device, held):
    graph = gr.GridGraph((5, 6)).to_graph()
    weights = getattr(gr.weights, held)(gr.weights.bilateral(2.0, 0.7))
    with pytest.raises(BackendUnavailable, match=r"GridGraph|OpenCL"):
        gr.regularize(cases.function(graph), graph, p=1, weights=weights, backend=device)


def test_what_cannot_be_held_so_says_so():
    plain = gr.weights.bilateral(2.0, 0.7)
    with pytest.raises(TypeError, match="got Constant"):
        gr.weights.half(gr.weights.constant())
    with pytest.raises(TypeError, match=r"put the guide around it: guided\(recomputed"):
        gr.weights.recomputed(gr.weights.guided(plain, np.ones(4)))
    with pytest.raises(TypeError, match="got Held"):
        gr.weights.half(gr.weights.half(plain))
    grid = gr.GridGraph((5, 6))
    f0 = cases.function(grid)
    with pytest.raises(BackendUnavailable, match="between single cells"):
        gr.regularize(f0, grid, p=1, weights=gr.weights.recomputed(gr.weights.patch(1, 0.5)), backend="numpy")
    with pytest.raises(BackendUnavailable, match="GridGraph"):
        gr.regularize(f0, grid.to_graph(), p=1, weights=gr.weights.half(plain), backend="numpy")


@pytest.mark.parametrize(("width", "kind"), [(1, "gpu"), (None, "cpu")])
def test_small_weights_where_subnormals_are_flushed(width, kind):
    """In float16 all below 2^-14 is subnormal; OpenCL allows a device to flush what is so in float32."""
    drivers = [one for one in backends.devices() if one.backend == "opencl"]
    if not drivers:
        pytest.skip(backends.absent()["opencl"])
    from gpureg.backends.opencl import primitives as opencl

    device = dataclasses.replace(drivers[0], kind=kind, vector_width=width or drivers[0].vector_width)
    backend = opencl.make(device, "float32")
    backend._options += ("-cl-denorms-are-zero", "-DFLUSHED")
    graph, form = gr.GridGraph((5, 41), metric="cityblock"), PatchForm(np.ones(1), scale=1.0)
    f = np.linspace(0, 4, 41) * np.arange(1, 6)[:, None]
    weighted = backend.patch_distance(graph, f.reshape(-1, 1), form, storage="half")
    weights = backend.get_weights(weighted)
    assert (weights[(weights > 0) & (weights < 2.0**-14)]).size > 9
    exact = np.exp(-(np.diff(f, axis=0) ** 2))
    assert (np.abs(weights[1, :-1] - exact) <= (RELATIVE + 2.0**-22) * exact + ABSOLUTE).all()
    # of sums of at most four rounded weights
    degree = oracle().get(graph, oracle().degree(oracle().prepare(graph, weights.astype(float))))
    assert (np.abs(backend.get(graph, backend.degree(weighted)) - degree) <= 4 * 2.0**-24 * degree).all()
