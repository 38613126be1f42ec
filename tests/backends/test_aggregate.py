"""Averaged patches and the largest weight: the oracle against loops, every device against the oracle."""

from __future__ import annotations

import dataclasses
import itertools

import cases
import numpy as np
import pytest
import rows  # noqa: F401, fills ROWS
from checking import as_gpu, check
from numpy.testing import assert_allclose
from primitives import ROWS
from problems import Kind, PatchCase, oracle, problem

from gpureg import backends
from gpureg.backends import BackendUnavailable
from gpureg.graphs.grid import GridGraph
from gpureg.regularization import one_sweep


def literal(grid, w, f, share, centre, radius):
    """The equation, term by term; w(u, v) by the places of the two."""
    cells = set(itertools.product(*map(range, grid.shape)))
    number = {cell: i for i, cell in enumerate(itertools.product(*map(range, grid.shape)))}
    patch = list(itertools.product(range(-radius, radius + 1), repeat=grid.ndim))
    total = np.zeros_like(f)
    for x in number:
        for o in [(0,) * grid.ndim, *map(tuple, grid.offsets.tolist())]:
            y = tuple(a + b for a, b in zip(x, o, strict=True))
            if y not in cells:
                continue
            for j in patch:
                u = tuple(a - b for a, b in zip(x, j, strict=True))
                v = tuple(a + b for a, b in zip(u, o, strict=True))
                if u not in cells or v not in cells:
                    continue
                part = share[number[u]] * w[u, v] if any(o) else centre[number[u]]
                total[number[x]] += part * f[number[y]]
    return total


def check_the_equation(backend, name):
    """A numpy backend in float64 against the loops."""
    grid, half = cases.graph(name), cases.weights(name)
    generator = cases.rng(47)
    f, share, centre = generator.random((grid.n_vertices, 2)), *generator.random((2, grid.n_vertices, 1))
    csr = grid.to_graph(half)
    places = [tuple(int(c) for c in cell) for cell in np.ndindex(grid.shape)]
    w = dict.fromkeys(itertools.product(places, places), 0.0)
    w |= {
        (places[u], places[v]): weight for u, v, weight in zip(csr.edge_rows(), csr.indices, csr.weights, strict=True)
    }
    weighted = backend.prepare(grid, half)
    expected = literal(grid, w, f, share, centre, 1)
    assert_allclose(backend.aggregate(weighted, f, share, centre, 1), expected, rtol=1e-13)


@pytest.mark.parametrize("name", ["small grid", "small masked", "small row", "small volume"])
def test_the_oracle_is_the_equation(name):
    check_the_equation(oracle(), name)


@pytest.mark.one_driver
@pytest.mark.parametrize("name", ["grid", "row", "volume"])
def test_as_a_gpu_takes_it(monkeypatch, device, name):
    check(as_gpu(device, "float32", monkeypatch), ROWS["aggregate"], problem(Kind(cases.Setup(name))))


@pytest.mark.parametrize("name", ["csr", "small csr, unweighted", "csr, one vertex"])
def test_the_largest_weight_on_a_stored_graph(device, name):
    graph = cases.graph(name)
    backend = backends.get(device)
    largest = backend.get(graph, backend.largest_weight(backend.prepare(graph, None)))
    w = np.ones(graph.n_edges) if graph.weights is None else graph.weights
    expected = [max([0.0, *w[a:b]]) for a, b in itertools.pairwise(graph.indptr)]
    np.testing.assert_array_equal(largest[:, 0], expected)


@pytest.mark.one_driver
def test_half_weights_are_averaged_too(device):
    backend, grid = backends.get(device), cases.graph("grid")
    if "half" not in backend.storages:
        pytest.skip("weights in float16 are OpenCL's")
    f, form = cases.function(grid), PatchCase("grid", radius=1, scale=0.5).form(grid)
    args = [backend.put(grid, x) for x in (f, np.ones_like(f), np.ones_like(f))]
    half, full = (
        backend.get(grid, backend.aggregate(backend.patch_distance(grid, f, form, storage=storage), *args, 1))
        for storage in ("half", "full")
    )
    # a weight is off by 2^-11 of its size at most, and so is a sum of positive terms
    sizes = oracle().aggregate(oracle().patch_distance(grid, f, form), np.abs(f), np.ones_like(f), np.ones_like(f), 1)
    assert (np.abs(half - full) <= (2.0**-11 + 1e-5) * sizes).all()
    assert (half != full).any()


@pytest.mark.one_driver
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize(("channels", "radius"), [(1, 1), (3, 1), (1, 2)])
@pytest.mark.parametrize("lam", [0.0, 1.5])
def test_averaged_weights_are_averaged_patches(device, channels, radius, masked, lam):
    """The step whose weights are sums over patches: what `aggregate` gives with shares of 1, divided by its own sum.

    Some 120 x 25 positive terms a sum, on values of size 1, in another order: 2 x 3000 roundings at the very most, and
    far fewer as they grow like a random walk (measured: 4e-7).
    """
    backend = backends.get(device)
    assert backend.averages
    mask = cases.rng(5).random((37, 53)) < 0.85 if masked else None
    grid = GridGraph((37, 53), 5, "euclidean", mask=mask)
    f, form = cases.function(grid, channels), PatchCase("", radius=2, scale=2.0, spatial=True).form(grid)
    inside = np.ones((grid.n_vertices, 1)) if mask is None else mask.reshape(-1, 1).astype(float)
    count = one_sweep._per_patch(grid, lam, radius)
    step = dataclasses.replace(form, average=radius)
    fused = backend.get(grid, backend.similarity_step(grid, f, step, backend.put(grid, f), backend.put(grid, count)))
    weighted = backend.patch_distance(grid, f, form)
    args = (np.concatenate([f * inside, inside], 1), inside, lam / 2 * inside)
    sums = backend.get(grid, backend.aggregate(weighted, *(backend.put(grid, x) for x in args), radius))
    known = inside[:, 0] > 0
    assert_allclose(fused[known], sums[known, :-1] / sums[known, -1:], rtol=0, atol=5e-6)
    plain = backend.get(grid, backend.similarity_step(grid, f, form, backend.put(grid, f), lam))
    assert np.abs(plain - fused)[known].max() > 1e-3


def test_only_stored_weights_of_a_grid(device):
    backend, csr = backends.get(device), cases.graph("small csr")
    f = backend.put(csr, np.ones((csr.n_vertices, 1)))
    with pytest.raises(BackendUnavailable, match="stored on a GridGraph"):
        backend.aggregate(backend.prepare(csr, None), f, f, f, 1)


def test_a_part_has_the_bits_of_the_whole(device):
    """A band whose halo is the window's reach, the patch's, and that of the patches that are compared."""
    backend = backends.get(device)
    whole, first, halo = GridGraph((61, 43), 3), 16, 3 + 2 * 2
    f = cases.function(whole).reshape(*whole.shape)
    form = PatchCase("", radius=2, scale=0.5).form(whole)

    def aggregated(values):
        grid = GridGraph(values.shape, 3)
        values = values.reshape(-1, 1)
        ones = backend.put(grid, np.ones_like(values))
        weighted = backend.patch_distance(grid, values, form)
        return backend.get(grid, backend.aggregate(weighted, backend.put(grid, values), ones, ones, 2)).reshape(
            grid.shape
        )

    np.testing.assert_array_equal(aggregated(f[first:])[halo:], aggregated(f)[first + halo :])
