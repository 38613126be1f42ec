"""OpenCL's own concerns: pack widths, and the launches a GPU gets, tried on the CPU drivers that are here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import EPS, fidelity, function, graph, half_weights, weights

from gpureg import backends
from gpureg.backends import Smoothness
from gpureg.graphs.grid import GridGraph

ORACLE = backends.get("numpy", np.float64)


def drivers() -> list[backends.Device]:
    return [device for device in backends.devices() if device.backend == "opencl"]


@pytest.mark.parametrize(("width", "kind", "name"), [(1, "gpu", "csr"), (2, "cpu", "grid"), (4, "cpu", "volume")])
def test_every_pack_width_computes_the_same(width: int, kind: str, name: str) -> None:
    """A GPU takes packs of 1 and rounds its launches up to whole work groups: both must leave no trace.

    On one graph each, as kernels take long to build; tests/gpu holds every primitive as a GPU takes it.
    """
    if not drivers():
        pytest.skip(backends.absent()["opencl"])
    from gpureg.backends.opencl import primitives as opencl

    backend = opencl.make(replace(drivers()[0], vector_width=width, kind=kind), np.float32)
    made, f, f0 = graph(name), function(graph(name)), function(graph(name), seed=13)
    lam = fidelity(made)
    form = backends.PatchForm(np.ones(1), shift=0.01, scale=2.0)

    def results(b: backends.Backend) -> dict[str, np.ndarray | float]:
        weighted = b.prepare(made, weights(name))
        F, F0, L = b.put(made, f), b.put(made, f0), b.put(made, lam)
        g = b.gradient_norm(weighted, F, power=-0.5, eps=EPS, coupled=True)
        return {
            "put": b.get(made, F),
            "degree": b.get(made, b.degree(weighted)),
            "gradient_norm": b.get(made, g),
            "p_laplacian": b.get(made, b.p_laplacian(weighted, F, g)),
            "jacobi_step": b.get(made, b.jacobi_step(weighted, F, F0, g, L)),
            "energy": b.energy(weighted, F, F0, L, Smoothness(1, EPS)),
            "max_change": b.max_change(weighted.graph, F, F0),
            "patch_distance": b.get_weights(b.patch_distance(made, f, form)),
        }

    found, exact = results(backend), results(ORACLE)
    # The sharp bounds are test_primitives.py's; a lane in the wrong place is off by the size of the values.
    off = {name: np.abs(found[name] - x).max() / np.abs(x).max() for name, x in exact.items()}
    assert not {name: share for name, share in off.items() if not share <= 1e-5}


@pytest.mark.parametrize(
    ("shape", "radius", "metric", "weighted", "channels"),
    [
        ((75, 151), 1, "cityblock", False, 1),
        ((75, 151), 1, "chebyshev", True, 3),
        ((75, 151), 3, "chebyshev", True, 1),
        ((75, 151), 3, "euclidean", False, 1),
        ((3, 2201), 2, "chebyshev", True, 1),
        ((9, 11, 37), 1, "chebyshev", True, 1),
    ],
)
def test_a_sweep_does_not_depend_on_how_the_grid_is_cut(
    monkeypatch: pytest.MonkeyPatch, shape: tuple[int, ...], radius: int, metric: str, weighted: bool, channels: int
) -> None:
    """The same bits from the whole, from blocks of other sizes, and from a part with a halo; from NaN in the ring."""
    if not drivers():
        pytest.skip(backends.absent()["opencl"])
    from gpureg.backends.opencl import primitives as opencl
    from gpureg.backends.opencl.geometry import Blocks, GridGeometry, round_up
    from gpureg.backends.opencl.layout import GridLayout

    backend = opencl.make(drivers()[0], np.float32)
    grid = GridGraph(shape, radius, metric)  # type: ignore[arg-type]
    f, f0, lam = function(grid, channels), function(grid, channels, seed=13), fidelity(grid)
    half = half_weights(grid) if weighted else None

    def swept(grid: GridGraph, half: np.ndarray | None, *functions: np.ndarray) -> np.ndarray:
        on, (F, F0, L) = backend.prepare(grid, half), (backend.put(grid, x) for x in functions)
        out = backend.put(grid, np.full(functions[0].shape, np.nan))
        backend.sweep(on, F, F0, L, Smoothness(1.0, EPS), theta=0.625, g=None, out=out)
        return backend.get(grid, out)

    whole = swept(grid, half, f, f0, lam)
    layout = backend._topology(grid)
    assert isinstance(layout, GridLayout)
    geometry, lanes = layout.geometry, layout.width
    planned = geometry.blocks(channels, 1, weighted, 2)
    different = []
    for band, stretch in ((2, lanes), (4, 3 * lanes), (shape[0] + 1, round_up(shape[-1], lanes))):
        ring_pitch = geometry.spread(stretch + 2 * round_up(geometry.reach, lanes) + lanes)
        count = (-(-geometry.W // stretch), -(-geometry.rows // band))
        size = planned.ring_size // planned.ring_pitch * ring_pitch
        blocks = Blocks(band, stretch, count, planned.slots, ring_pitch, size)
        layout._rings = backend.upload(np.full(blocks.ring_size * count[0] * count[1], np.nan, np.float32))
        with monkeypatch.context() as patched:
            patched.setattr(GridGeometry, "blocks", lambda *_, blocks=blocks, **__: blocks)
            if swept(grid, half, f, f0, lam).tobytes() != whole.tobytes():
                different.append((band, stretch))
    assert not different
    # a part that begins and ends anywhere, with a halo of two radii
    halo, last = 2 * radius, shape[-1]
    begin, end = last // 3, last // 3 + 21
    wide = slice(begin - halo, end + halo)
    part = GridGraph((*shape[:-1], end - begin + 2 * halo), radius, metric)  # type: ignore[arg-type]
    cut = [x.reshape(*shape, -1)[..., wide, :].reshape(part.n_vertices, -1) for x in (f, f0, lam)]
    inside = None if half is None else half[..., wide] * part.edges.unit_half()
    found = swept(part, inside, *cut).reshape(*part.shape, channels)[..., halo:-halo, :]
    assert found.tobytes() == whole.reshape(*shape, channels)[..., begin:end, :].tobytes()


def test_sizes_are_worked_out_once_a_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    """A job's bytes come from numbers alone: one geometry for many questions, and no layout."""
    if not drivers():
        pytest.skip(backends.absent()["opencl"])
    from gpureg.backends.opencl import primitives as opencl
    from gpureg.backends.opencl.geometry import GridGeometry

    backend, grid = opencl.make(drivers()[0], np.float32), GridGraph((301, 203), 2)
    made = []
    monkeypatch.setattr(
        GridGeometry, "of", classmethod(lambda cls, *given, of=GridGeometry.of: made.append(given) or of(*given))
    )
    monkeypatch.setattr(backend, "upload", None)
    asked = [backend.function_bytes(grid, 3), backend.edge_bytes(grid), backend.edge_bytes(grid, directed=True)]
    asked += [backend.topology_bytes(grid), backend.sweep_bytes(grid, 3, 1), *backend.patch_bytes(grid, 3, 1)]
    assert made == [(grid, backend.lanes, 4, 0)]
    assert asked[0] >= 4 * 3 * grid.n_vertices
    assert asked[2] > asked[1] >= 4 * 12 * grid.n_vertices


def test_rows_of_a_gpu_begin_at_its_lines() -> None:
    """Rows of at least two lines, of functions and of weights; short ones would become much longer."""
    if not drivers():
        pytest.skip(backends.absent()["opencl"])
    from gpureg.backends.opencl.geometry import GridGeometry

    for itemsize in (4, 8):
        at = GridGeometry.of(GridGraph((5, 101), 2), 1, itemsize, 128)
        begins = (at.guard, at.pitch, at.plane, at.weight_guard, at.weight_pitch)
        assert not [begin for begin in begins if begin * itemsize % 128]
        assert at.pitch - at.W < 128 // itemsize
        short = GridGeometry.of(GridGraph((5, 256 // itemsize - 1), 2), 1, itemsize, 128)
        assert short.pitch - short.W <= 64 // itemsize


def test_a_job_too_large_for_the_device_says_so() -> None:
    if not drivers():
        pytest.skip(backends.absent()["opencl"])
    backend = backends.get(drivers()[0].id)
    with pytest.raises(MemoryError, match="GiB at most"):
        backend._allocate(1 << 50)


def test_memory_of_buffers_outlives_a_wait_that_failed() -> None:
    """Host memory that queued work may still use goes only once a wait is over."""
    if not drivers():
        pytest.skip(backends.absent()["opencl"])
    shared = backends.get(drivers()[0].id)._shared  # type: ignore[attr-defined]
    shared.queue.finish()
    mark = np.zeros(1, np.uint8)
    shared.leaving.append(mark)
    with pytest.raises(KeyboardInterrupt), shared.waiting():
        raise KeyboardInterrupt
    assert any(kept is mark for kept in shared.leaving)
    with shared.waiting():
        shared.queue.finish()
    assert not shared.leaving
