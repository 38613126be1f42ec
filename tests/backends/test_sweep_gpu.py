"""The fused sweep of a GPU, tried on a CPU driver: against the oracle, and the same bits for any tiles."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cases
import numpy as np
import pytest

from gpureg import backends
from gpureg.backends import Smoothness
from gpureg.graphs.grid import GridGraph


@pytest.fixture(scope="module")
def gpu() -> Any:
    drivers = [device for device in backends.devices() if device.backend == "opencl"]
    if not drivers:
        pytest.skip(backends.absent()["opencl"])
    from gpureg.backends.opencl import primitives

    return primitives.make(replace(drivers[0], vector_width=1, kind="gpu"), "float32")


def swept(backend: Any, grid: GridGraph, half: Any, model: Smoothness, functions: list[np.ndarray]) -> np.ndarray:
    """A damped sweep of f towards f0 with lam, from an output full of NaN."""
    f, f0, lam = (backend.put(grid, x) for x in functions)
    g = backend.empty(grid, model.norms(functions[0].shape[1]))
    out = backend.put(grid, np.full(functions[0].shape, np.nan))
    backend.sweep(backend.prepare(grid, half), f, f0, lam, model, theta=0.625, g=g, out=out)
    found: np.ndarray = backend.get(grid, out).astype(float)
    return found


# Few variants, as each takes seconds to compile: weights or none, both windows, channels that share a norm or not, a
# power that is compiled in or not.
CASES = [
    ("cityblock", False, 2, Smoothness(1.0, cases.EPS, coupled=False)),
    ("chebyshev", True, 3, Smoothness(1.3, cases.EPS)),
]


@pytest.mark.parametrize(("metric", "weighted", "channels", "model"), CASES, ids=["channel by channel", "coupled"])
def test_a_sweep_in_tiles(gpu: Any, oracle: Any, metric: Any, weighted: bool, channels: int, model: Smoothness) -> None:
    """Tiles inside and at the border, of one cell too; a part of the grid has the bits of the whole."""
    for shape in ((61, 131), (1, 7), (9, 1)):
        grid = GridGraph(shape, 1, metric)
        half = cases.half_weights(grid) if weighted else None
        functions = [cases.function(grid, channels), cases.function(grid, channels, seed=13), cases.fidelity(grid)]
        whole = swept(gpu, grid, half, model, functions)
        exact = swept(oracle, grid, half, model, functions)
        assert np.abs(whole - exact).max() <= cases.TOLERANCES["float32"] * np.abs(exact).max()
    assert "sweep_gpu" in {primitive for primitive, _ in gpu._shared.kernels}
    shape = (61, 131)
    grid, rows, columns = GridGraph(shape, 1, metric), slice(5, 60), slice(17, 121)
    half = cases.half_weights(grid) if weighted else None
    functions = [cases.function(grid, channels), cases.function(grid, channels, seed=13), cases.fidelity(grid)]
    whole = swept(gpu, grid, half, model, functions).reshape(*shape, channels)
    part = GridGraph((55, 104), 1, metric)
    cut = [x.reshape(*shape, -1)[rows, columns].reshape(part.n_vertices, -1) for x in functions]
    inside = None if half is None else half[:, rows, columns] * part.edges.unit_half()
    found = swept(gpu, part, inside, model, cut).reshape(55, 104, channels)
    # the halo of a sweep is two cells
    assert found[2:-2, 2:-2].tobytes() == whole[rows, columns][2:-2, 2:-2].tobytes()


def test_other_sweeps_of_a_gpu_are_the_two_kernels(gpu: Any) -> None:
    """Windows that reach further, three axes, one axis, many channels with one norm."""
    channels, model = 5, Smoothness(1.0, cases.EPS)
    asked: list[str] = []
    watched = type("Watched", (type(gpu),), {"_run": lambda self, primitive, *_, **__: asked.append(primitive)})
    backend = object.__new__(watched)
    backend.__dict__.update(gpu.__dict__)
    for grid, m in (
        (GridGraph((9, 11), 2), 1),
        (GridGraph((3, 4, 5), 1), 1),
        (GridGraph((9,), 1), 1),
        (GridGraph((9, 11), 1), channels),
    ):
        f, lam = np.ones((grid.n_vertices, m)), np.ones((grid.n_vertices, 1))
        swept(backend, grid, None, model, [f, f, lam])
    assert asked == ["gradient_norm", "jacobi_step"] * 4
