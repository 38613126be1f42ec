"""The step at p = 2 whose weights are never stored: on every device, and as a GPU takes it."""

from __future__ import annotations

import dataclasses

import bounds
import cases
import numpy as np
import pytest
import rows  # noqa: F401, fills ROWS
from checking import as_gpu, check
from numpy.testing import assert_array_equal
from primitives import ROWS, assert_within
from problems import PatchCase, PatchKind

from gpureg import backends
from gpureg.graphs.grid import GridGraph

# What a GPU takes in another way than a CPU, without tiles (test_patch_tiles.py), tried by pretending.
NARROW = (
    PatchKind(PatchCase("row", radius=4, scale=0.1), lam="array"),
    PatchKind(PatchCase("small masked", radius=9, scale=0.002, maps=True), "float64"),
    PatchKind(PatchCase("volume", channels=6, radius=1, gaussian=True, scale=4.0), lam="array"),
)
LARGEST = (
    (PatchCase("grid", radius=2, scale=0.5, shift=0.125, spatial=True), "number"),
    (PatchCase("masked", radius=0, scale=2.0, spatial=True), "array"),
    (PatchCase("volume", radius=1, gaussian=True, scale=4.0), "array"),
)


@pytest.mark.one_driver
@pytest.mark.parametrize("kind", NARROW, ids=lambda kind: kind.id)
def test_as_a_gpu_takes_it(monkeypatch, device, kind):
    check(as_gpu(device, kind.dtype, monkeypatch), ROWS["similarity_step"], kind.make())


@pytest.mark.one_driver
@pytest.mark.parametrize(("case", "lam"), LARGEST, ids=lambda x: getattr(x, "id", x))
def test_lam_in_units_of_the_largest_weight(device, case, lam):
    """The composition of the primitives, on the same device: sums in another order, of at most 120 positive terms."""
    backend, graph = backends.get(device), cases.graph(case.graph)
    f, form = cases.function(graph), case.form(graph)
    given = 0.75 if lam == "number" else cases.fidelity(graph)
    weighted = backend.patch_distance(graph, f, form)
    unit = backend.get(graph, backend.largest_weight(weighted)).astype(np.float64)
    fidelity = np.where(np.isinf(given), given, np.where(np.isinf(given), 0, given) * unit)
    composed = backend.jacobi_step(
        weighted, backend.put(graph, f), backend.put(graph, f), None, backend.put(graph, fidelity)
    )
    device_lam = given if lam == "number" else backend.put(graph, given)
    step = backend.similarity_step(graph, f, form, backend.put(graph, f), device_lam, largest=True)
    assert np.abs(backend.get(graph, step) - backend.get(graph, composed)).max() <= 2 * 130 * 2.0**-24
    plain = backend.similarity_step(graph, f, form, backend.put(graph, f), device_lam)
    assert np.abs(backend.get(graph, step) - backend.get(graph, plain)).max() > 1e-3


def test_launches_that_share_slots_give_the_same_bits(monkeypatch, device):
    """OpenCL on a CPU: as many strips at once as there is room for, or one after the other."""
    backend = backends.get(device)
    if backend.name != "opencl":
        pytest.skip("slots are OpenCL's")
    from gpureg.backends.opencl import strips as opencl_strips

    grid = GridGraph((171, 43), 5, "euclidean")
    f, form = cases.function(grid), PatchCase("", radius=2, scale=0.5).form(grid)

    def step():
        return backend.get(grid, backend.similarity_step(grid, f, form, backend.put(grid, f), 0.5))

    together = step()
    monkeypatch.setattr(opencl_strips, "_SLOT_BYTES", 1)
    monkeypatch.setattr(backend, "_scratch_memory", None)
    assert_array_equal(step(), together)


def test_a_part_has_the_bits_of_the_whole(device):
    """A band that begins at a multiple of the device's row block; its halo is the window's and the patch's reach."""
    backend = backends.get(device)
    block = backend.row_block
    whole = GridGraph((3 * block + 70, 53), 4, "chebyshev")
    f = cases.function(whole).reshape(*whole.shape, 1)
    first = block * -(-11 // block)
    part = GridGraph((whole.shape[0] - first, 53), 4, "chebyshev")

    def step(grid, f):
        case = PatchCase("", radius=2, scale=0.5, shift=0.125, spatial=True)
        f = f.reshape(-1, 1)
        result = backend.similarity_step(grid, f, case.form(grid), backend.put(grid, f), 0.5)
        return backend.get(grid, result).reshape(grid.shape)

    halo = 4 + 2
    assert_array_equal(step(part, f[first:])[halo:], step(whole, f)[first + halo :])


def test_infinite_lam_and_bare_distances(device):
    """lam a number that is infinite: f0; weights that are the distances themselves: the composition."""
    backend, graph = backends.get(device), cases.graph("grid")
    f, f0 = cases.function(graph), cases.function(graph, seed=13)
    case = PatchCase("grid", radius=2, scale=0.5, shift=0.125, spatial=True)
    device_f0, form = backend.put(graph, f0), case.form(graph)
    pinned = backend.similarity_step(graph, f, form, device_f0, float("inf"))
    assert backend.get(graph, pinned).tobytes() == backend.get(graph, device_f0).tobytes()
    bare = dataclasses.replace(form, scale=None)
    weighted = backend.patch_distance(graph, f, bare)
    composed = backend.jacobi_step(weighted, backend.put(graph, f), device_f0, None, 0.75)
    fused = backend.similarity_step(graph, f, bare, device_f0, 0.75)
    assert backend.get(graph, fused).tobytes() == backend.get(graph, composed).tobytes()


def test_the_largest_scale_leaves_equal_values_alike(device):
    """sigma_value next to 0: weight 1 between equal values, 0 between others, and no NaN."""
    backend, grid = backends.get(device), cases.graph("grid")
    form = backends.PatchForm(np.ones(1), scale=float(np.finfo(np.float32).max))
    f = np.repeat([[0.25], [0.75]], [1000, 961], axis=0)
    step = backend.get(grid, backend.similarity_step(grid, f, form, backend.put(grid, f), 0.0))
    assert_array_equal(step, f)


def test_the_exponential_over_its_whole_range(device):
    """From 1 down to the smallest normal number within bounds.EXP and the bare exponent's roundings, then next to 0."""
    backend, tiny = backends.get(device), float(np.finfo(np.float32).tiny)
    depth = np.linspace(0, 100, 4001, dtype=np.float32).astype(np.float64)
    # pairs of cells: rho = (sqrt(depth))^2 between the two, weights of their one edge
    graph = GridGraph((len(depth), 2), mask=None, metric="cityblock")
    f = np.stack([np.zeros_like(depth), np.sqrt(depth).astype(np.float32)], axis=1).reshape(-1, 1)
    form = PatchCase("", radius=0, scale=1.0).form(graph)
    across = int(np.flatnonzero((graph.forward_offsets == [0, 1]).all(axis=1))[0])
    w = backend.get_weights(backend.patch_distance(graph, f, form))[across][:, 0]
    rho = f.reshape(-1, 2)[:, 1].astype(np.float64) ** 2
    u = cases.UNIT_ROUNDOFF["float32"]
    assert_within(w, np.exp(-rho), (bounds.EXP + 2 * rho) * u * np.exp(-rho) + tiny, "exp")
    assert w[0] == 1 and w[-1] <= tiny
