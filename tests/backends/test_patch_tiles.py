"""The step whose weights are not stored, as a GPU takes it: blocks of cells in local memory, on one OpenCL driver."""

from __future__ import annotations

import dataclasses
from typing import Any

import cases
import mutations
import numpy as np
import pytest
import rows  # noqa: F401, fills ROWS
from checking import as_gpu, check
from mutations import Mutation
from numpy.testing import assert_allclose, assert_array_equal
from primitives import ROWS
from problems import PatchCase, PatchKind

from gpureg.backends.opencl.patch_tiles import PatchTiles
from gpureg.backends.patches import PatchForm, over_patches
from gpureg.graphs.grid import GridGraph

# a driver for CPUs takes long to compile kernels with barriers
pytestmark = pytest.mark.one_driver

# Wider than a block: more than one group, and more than one chunk of steps along a row.
WIDE = GridGraph((9, 137), 29, "chebyshev")

KINDS = (
    PatchKind(PatchCase("grid", channels=3, radius=3, gaussian=True, shift=0.03, scale=8.0), lam="array"),
    PatchKind(PatchCase("masked", radius=2, scale=0.5, shift=0.125, spatial=True, maps=True), "float64", "array"),
    PatchKind(PatchCase("narrow", radius=4, scale=0.01)),
    PatchKind(PatchCase("disk", radius=0, scale=2.0, spatial=True), guided=True),
)

# One change each in what only this kernel does: borders, the values that move on, columns in registers.
WRONG = (
    Mutation("similarity_step", "similarity_step_gpu", "max(u, v) < height", "u < height"),
    Mutation("similarity_step", "similarity_step_gpu", "far[4 * row + 3] = VALUE(row", "far[4 * row + 2] = VALUE(row"),
    Mutation("similarity_step", "patch_tile", "guide[at + c * plane]", "guide[at]"),
)


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch, device: str) -> Any:
    """Makes a backend that has a GPU's kernels, in one type, without optimisation: a CPU's driver takes long for it."""
    if not device.startswith("opencl"):
        pytest.skip("tiles are OpenCL's")

    def make(dtype: str = "float32") -> Any:
        backend = as_gpu(device, dtype, monkeypatch)
        backend._options += ("-cl-opt-disable",)
        return backend

    return make


def step(backend: Any, grid: GridGraph, f: Any, form: PatchForm, lam: float = 0.5, **options: Any) -> Any:
    """One sweep from f, with the data f, as an array of the grid's shape and channels."""
    values = f.reshape(grid.n_vertices, -1)
    found = backend.similarity_step(grid, values, form, backend.put(grid, values), lam, **options)
    return backend.get(grid, found).reshape(*grid.shape, -1)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.id)
def test_as_the_oracle(gpu, kind):
    backend = gpu(kind.dtype)
    check(backend, ROWS["similarity_step"], kind.make())
    assert any(primitive == "similarity_step_gpu" for primitive, _ in backend._shared.kernels)


@pytest.mark.parametrize(("radius", "average", "masked"), [(1, 1, False), (2, 3, True)])
def test_sums_of_weights(gpu, oracle, radius, average, masked):
    """Weights averaged over patches, of pairs on the grid and in the mask; channels in two launches.

    A weight, at most 1, is off by less than 2^-20 (bounds.EXP and 3 (2 radius + 1)^2 terms), so the quotient by less
    than 2^-18 of the range of f, which is 1 (measured: 3e-7).
    """
    mask = cases.rng(5).random((37, 53)) < 0.85 if masked else None
    grid = GridGraph((37, 53), 3, "euclidean", mask=mask)
    f, case = cases.function(grid, 7 if average == 1 else 1), PatchCase("", radius=radius, scale=0.5, spatial=True)
    form = case.form(grid)
    found = step(gpu(), grid, f, dataclasses.replace(form, average=average))
    single = oracle.get_weights(oracle.patch_distance(grid, f, form))
    sums = np.stack([over_patches(plane, average) for plane in single]) * grid.edges.unit_half()
    on_oracle = oracle.put(grid, f)
    exact = oracle.jacobi_step(oracle.prepare(grid, sums), on_oracle, on_oracle, None, 0.5)
    assert_allclose(found.reshape(f.shape), oracle.get(grid, exact), rtol=0, atol=2.0**-18)


def test_wide_windows_and_largest_weights(gpu, oracle):
    """Two chunks of 59 steps along a row, and lam in units of the largest weight; the bound is that of 500 terms."""
    f, form = cases.function(WIDE), PatchCase("", radius=1, scale=0.5, shift=0.125).form(WIDE)
    found, exact = (step(backend, WIDE, f, form, largest=True) for backend in (gpu(), oracle))
    assert np.abs(found - exact).max() <= 2 * 500 * 2.0**-24


def test_a_part_has_the_bits_of_the_whole(gpu):
    """A part that begins anywhere: a sum does not depend on where its cell is in a block."""
    backend, whole = gpu(), GridGraph((39, 150), 4)
    f = cases.function(whole).reshape(whole.shape)
    part, halo = GridGraph((32, 147), 4), 4 + 2 + 1

    def averaged(grid: GridGraph, values: Any) -> Any:
        form = PatchCase("", radius=2, scale=0.5, shift=0.125, spatial=True).form(grid)
        return step(backend, grid, values, dataclasses.replace(form, average=1))

    assert_array_equal(averaged(part, f[7:, 3:])[halo:, halo:], averaged(whole, f)[7 + halo :, 3 + halo :])


def test_infinite_bandwidths(gpu):
    """scale 0, all weights 1: pairs that leave the grid still have none."""
    grid = GridGraph((5, 7), 2)
    f = cases.function(grid)
    found = step(gpu(), grid, f, PatchForm(np.ones(3), scale=0.0), 0.0).ravel()
    around = grid.to_graph().to_scipy()
    assert_allclose(found, (around @ f / around.sum(axis=1).reshape(-1, 1)).ravel(), atol=2.0**-20)


def test_what_has_room():
    """Rows of a block by registers and 48 KiB; the kernels of strips take what has none."""
    grid, both, gauss = GridGraph((64, 200), 10), 1 << 16, np.array([0.25, 0.5, 0.25])

    def rows_of(form: PatchForm, channels: int, itemsize: int = 4, local: int = both) -> tuple[int, int] | None:
        blocks = PatchTiles(grid, form, itemsize, channels, channels, False, False).that_fits(local)
        return None if blocks is None else (blocks.rows, blocks.channels)

    assert rows_of(PatchForm(np.ones(7)), 1) == (16, 1)
    assert rows_of(PatchForm(np.ones(3), average=1), 3) == (12, 3)
    assert rows_of(PatchForm(np.ones(7)), 1, itemsize=8) == (8, 1)
    assert rows_of(PatchForm(gauss), 12) == (4, 4)
    assert rows_of(PatchForm(gauss), 40) is rows_of(PatchForm(gauss), 1, local=1 << 12) is None
    assert rows_of(PatchForm(np.ones(19)), 1) is rows_of(PatchForm(np.array([1.0, 2, 3])), 1) is None


@pytest.mark.parametrize("mutation", WRONG, ids=lambda mutation: mutation.id)
def test_a_wrong_kernel_is_noticed(gpu, monkeypatch, mutation):
    mutations.opencl(mutation, monkeypatch)
    backend, kind = gpu(), PatchKind(PatchCase("small grid", channels=2, radius=1, scale=0.5, spatial=True))
    backend._shared = dataclasses.replace(backend._shared, kernels={})
    with pytest.raises(AssertionError, match="out of bounds"):
        check(backend, ROWS["similarity_step"], kind.make(), first=True)
