"""Data on every device, sums over long segments, several sweeps, and which devices the tests take.

tests/backends/test_primitives.py holds the primitives themselves.
"""

from __future__ import annotations

import dataclasses

import cases
import numpy as np
import pytest
import rows  # noqa: F401, fills ROWS
from checking import check, nan, on
from conftest import device_params
from numpy.testing import assert_array_equal
from primitives import ROWS, assert_within
from problems import DTYPES, Kind, oracle, problem

from gpureg import backends
from gpureg.backends import PatchForm, Smoothness

every_setup = pytest.mark.parametrize(
    ("setup", "dtype"),
    [
        pytest.param(setup, dtype, id=f"{setup.id}-{dtype}")
        for dtype in DTYPES
        for setup in cases.SETUPS
        if dtype == "float32" or setup.wide
    ],
)


@every_setup
def test_functions_come_back(device, setup, dtype):
    """Bit by bit: both types hold the values exactly."""
    backend, one = on(device, dtype), problem(Kind(setup, dtype))
    returned = backend.get(one.graph, backend.put(one.graph, one.f))
    assert returned.dtype == backend.dtype
    assert_array_equal(returned, one.f)


@every_setup
def test_weights_come_back(device, setup, dtype):
    backend, one = on(device, dtype), problem(Kind(setup, dtype))
    returned, expected = backend.get_weights(one.on(backend)), oracle().get_weights(one.on_oracle)
    if expected is None:
        assert returned is None
    else:
        assert returned.dtype == backend.dtype
        assert_array_equal(returned, expected)


@pytest.mark.parametrize("name", ["grid", "masked", "volume", "csr", "pixel", "csr, one vertex"])
def test_functions_on_the_edges_come_back(device, name):
    backend, one = on(device), problem(Kind(cases.Setup(name)))
    host = one.host(one.H)
    assert_array_equal(backend.get_edges(one.graph, backend.put_edges(one.graph, host)), host)


@pytest.mark.parametrize("dtype", DTYPES)
def test_put_rounds_and_takes_any_layout(device, dtype):
    backend, grid = on(device, dtype), cases.graph("narrow")
    values = cases.rng(3).random((3, grid.n_vertices))  # float64, not exact in float32
    returned = backend.get(grid, backend.put(grid, values.T))
    assert_array_equal(returned, values.T.astype(dtype))
    empty = backend.get(grid, backend.empty(grid, 2))
    assert empty.shape == (grid.n_vertices, 2)


@pytest.mark.parametrize("setup", [cases.SETUPS[0], *cases.LONG], ids=lambda setup: setup.id)
def test_long_sums_without_float64(setup):
    """The compensated sum of an OpenCL device that has float32 alone, on one that has both."""
    if "opencl" in backends.absent():
        pytest.skip(backends.absent()["opencl"])
    both = backends.get("opencl")
    backend = type(both)(dataclasses.replace(both.device, float64=False), np.float32)
    check(backend, ROWS["energy"], problem(Kind(setup)))


@pytest.mark.one_driver
@every_setup
def test_sweeps_in_a_row(device, setup, dtype):
    """A kernel's output is another one's input: what it leaves in padding must do no harm.

    eps = 1/4 keeps the conductances from magnifying the first sweeps' rounding (by 1/eps at most), so that four sweeps
    stay within the tolerance of one.
    """
    one = problem(Kind(setup, dtype))
    model = Smoothness(1.0, 0.25, setup.coupled)

    def four(on, weighted):
        a, f0 = on.put(one.graph, one.f), on.put(one.graph, one.f0)
        b, lam = nan(on, one.graph, setup.channels), on.put(one.graph, one.lam)
        g = nan(on, one.graph, model.norms(setup.channels))
        for _ in range(4):
            on.sweep(weighted, a, f0, lam, model, theta=1.0, g=g, out=b)
            a, b = b, a
        return on.get(one.graph, a)

    exact, backend = four(oracle(), one.on_oracle), on(device, dtype)
    actual = four(backend, one.on(backend))
    assert_within(actual, exact, cases.TOLERANCES[dtype] * np.abs(exact).max(), "four sweeps")


@pytest.mark.parametrize("name", ["row", "csr"])
def test_a_hundred_dual_steps_close_the_gap(device, name):
    """What a solver does: outputs that are inputs again, y and its predecessor changing places."""
    backend = on(device)
    graph, weights, lam = cases.graph(name), cases.weights(name), 4.0
    weighted = backend.prepare(graph, weights)
    # projected gradients of the dual are safe up to lam/|d_w|^2, and |d_w|^2 <= 4 max degree
    sigma = lam / (4 * float(oracle().degree(oracle().prepare(graph, weights)).max()))
    f0 = backend.put(graph, cases.function(graph))
    f = f_before = f0
    y, before = backend.empty_edges(graph, 1), backend.empty_edges(graph, 1)
    step = {"model": Smoothness(1.0, 0.0), "beta": 0.0, "sigma": sigma}
    gaps = []
    for k in range(101):
        if k % 50 == 0:
            gaps.append(backend.duality_gap(weighted, f, y, f0, lam, Smoothness(1.0, 0.0)))
        y, before = backend.dual_step(weighted, y, before, f, f_before, **step), y
        f = f_before = backend.primal(weighted, y, f0, lam)
    assert gaps[0] > gaps[1] > gaps[2] >= 0
    # measured with the oracle: 0.125 on CSR, whose degrees are uneven, 0.008 on the row
    assert gaps[2] <= 0.15 * gaps[0]


def test_data_under_the_mask_do_not_spread(device):
    """Weights of vertices inside the mask do not depend on the values outside it when patches are single pixels."""
    grid = cases.graph("masked")
    f = cases.function(grid)
    changed = np.where(grid.mask.reshape(-1, 1), f, 99.0)
    backend = backends.get(device)
    form = PatchForm(np.ones(1), scale=1.0)
    plain, other = (backend.get_weights(backend.patch_distance(grid, x, form)) for x in (f, changed))
    assert plain.any()
    assert_array_equal(plain, other)


# The devices that the tests take


FOUND, MISSING = ["opencl:0", "opencl:1", "numpy"], {"warp": "not installed"}


@pytest.mark.parametrize(
    ("wanted", "required", "expected"),
    [
        ([], [], ["opencl:0", "opencl:1", "numpy", ("skip", "warp")]),
        ([], ["warp"], ["opencl:0", "opencl:1", "numpy", ("fail", "warp")]),
        (["numpy"], [], ["numpy"]),
        (["opencl"], [], ["opencl:0", "opencl:1"]),
        (["numpy", "warp:cuda:0"], [], ["numpy", ("fail", "warp:cuda:0")]),
        (["numpy"], ["warp"], ["numpy", ("fail", "warp")]),
        (["numpy"], ["opencl", "vulkan"], ["numpy", ("fail", "vulkan")]),
    ],
)
def test_an_absent_backend_skips_or_fails(wanted, required, expected):
    """The `device` fixture: narrowed by GPUREG_TEST_DEVICES, made strict by GPUREG_REQUIRE."""
    params = device_params(FOUND, MISSING, wanted, required)
    given = [param.values[0] if isinstance(param.values[0], str) else param.values[0][:2] for param in params]
    assert given == expected
