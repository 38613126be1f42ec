"""The Warp backend's own: launches on several threads, strips of cells, the step whose weights are never stored."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import cases
import numpy as np
import pytest
import rows  # noqa: F401, fills ROWS
from checking import check, nan
from primitives import ROWS
from problems import Kind, PatchCase, oracle, problem

from gpureg import backends
from gpureg.backends import Smoothness
from gpureg.backends.recorded import Parameter
from gpureg.graphs.grid import GridGraph

if "warp" in backends.absent():
    pytest.skip(backends.absent()["warp"], allow_module_level=True)

import warp as wp
from gpureg.kernels.warp import (
    aggregate,
    jacobi_step,
    patch_distance,
    similarity_step,
    similarity_step_gpu,
    sweep_gpu,
    total,
)
from gpureg.kernels.warp import grid as grid_kernels

from gpureg.backends.warp import pool as warp_pool
from gpureg.backends.warp import primitives as warp
from gpureg.backends.warp import recording


def everything(backend, name, channels):
    """The bytes of what several primitives give on a graph, from outputs full of NaN."""
    graph, weights = cases.graph(name), cases.weights(name)
    f, f0 = (backend.put(graph, cases.function(graph, channels, seed=seed)) for seed in (11, 13))
    lam = backend.put(graph, cases.fidelity(graph))
    weighted = backend.prepare(graph, weights)

    def out(m=channels):
        return nan(backend, graph, m)

    g = backend.gradient_norm(weighted, f, power=-0.5, eps=cases.EPS, coupled=True, out=out(1))
    found = [
        g,
        backend.degree(weighted),
        backend.p_laplacian(weighted, f, g, out=out()),
        backend.jacobi_step(weighted, f, f0, g, lam, theta=0.625, out=out()),
        backend.euler_step(weighted, f, f0, Smoothness(1.5, cases.EPS, True, edge=True), lam, 0.125, out=out()),
        backend.adjoint(weighted, backend.difference(weighted, f), out=out()),
    ]
    form = PatchCase(name, channels, radius=1, scale=0.5).form(graph)
    host = cases.function(graph, channels)
    hosts = [backend.get(graph, x) for x in found]
    hosts.append(backend.get_weights(backend.patch_distance(graph, host, form)))
    if isinstance(graph, GridGraph):
        hosts.append(backend.get(graph, backend.similarity_step(graph, host, form, f0, lam, out=out())))
    assert all(np.isfinite(x).all() for x in hosts)
    sums = [
        backend.energy(weighted, f, f0, lam, Smoothness(1.5, cases.EPS)),
        backend.max_change(weighted.graph, f, f0),
    ]
    return [x.tobytes() for x in hosts] + sums


@pytest.mark.parametrize(("name", "channels"), [("grid", 1), ("row", 1), ("masked", 3), ("csr of grid", 1)])
def test_threads_do_not_change_a_bit(monkeypatch, name, channels):
    """Few rows or many, cut along the one axis or the other; a stored graph by its edges."""
    backend = backends.get("warp:cpu")
    monkeypatch.setattr(warp_pool, "cores", lambda: 1)
    alone = everything(backend, name, channels)
    monkeypatch.setattr(warp_pool, "LEAST_WORK", 16)
    cut = []
    run = warp_pool._pool.run
    monkeypatch.setattr(warp_pool._pool, "run", lambda commands: (cut.append(len(commands)), run(commands)))
    different = []
    for threads in (2, 3, 7):
        monkeypatch.setattr(warp_pool, "cores", lambda threads=threads: threads)
        found = everything(backend, name, channels)
        different += [(threads, i) for i, (a, b) in enumerate(zip(found, alone, strict=True)) if a != b]
    assert not different
    assert max(cut) == 4 * 7


def test_a_stored_graph_is_cut_by_its_edges():
    """Degrees are far from even; the runs of vertices cover all, and none has much more than its share."""
    graph = cases.graph("csr")
    layout = backends.get("warp:cpu")._layout(graph)
    cuts = layout.cuts(graph.n_vertices, 5)
    assert cuts[0] == 0 and cuts[-1] == graph.n_vertices and cuts == sorted(cuts)
    work = np.diff(graph.indptr[cuts]) + np.diff(cuts)
    heaviest = np.diff(graph.indptr).max() + 1
    assert work.sum() == graph.n_vertices + graph.n_edges
    assert work.max() <= work.sum() / 5 + heaviest
    assert work.max() < np.diff(graph.indptr[[613 * i // 5 for i in range(6)]]).max()


def test_what_a_thread_raises_reaches_the_caller():
    class Broken:
        def launch(self):
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        warp_pool._pool.run([Broken() for _ in range(4)])


@pytest.mark.parametrize("name", ["packs", "packs, unit weights"])
@pytest.mark.parametrize("primitive", ["gradient_norm", "jacobi_step"])
def test_packs_on_three_axes(name, primitive):
    check(backends.get("warp:cpu"), ROWS[primitive], problem(Kind(cases.Setup(name, full=True))))


def test_kernels_compile_for_cuda(tmp_path):
    """To PTX, which needs no device: the C++ parts are for both compilers."""
    if sys.platform == "darwin":
        pytest.skip("Warp for macOS has no compiler for CUDA")
    access = grid_kernels.make(wp.float32, 2, "weights")
    for kernel in (
        similarity_step.make(wp.float32, 1, True, True, (2, 1, 3, 0, False, True, 1, 1, 1)),
        patch_distance.make_grid(wp.float64, True, True, (3, 3, 1, 0, False, True, 1, 1, 1)),
        aggregate.make(access, 2),
        jacobi_step.make(access, 1, 1, "vertex", True, 1, False),
        total.make(wp.float64, False),
        similarity_step_gpu.make(wp.float32, 1, True, False, (1, 3, 1, False, False, 16), similarity_step_gpu.ITEMS),
        sweep_gpu.make(access, 3, ((0, 1), (1, 0)), True, True, 8, sweep_gpu.ITEMS),
    ):
        wp.compile_aot_module(kernel.module, arch=80, module_dir=tmp_path, use_ptx=True)
    made = list(tmp_path.glob("*.ptx"))
    assert len(made) == 7
    # private arrays in memory would be variables of the local state space
    assert not [path.name for path in made if ".local ." in path.read_text("utf-8")]


def test_tiles_of_a_gpu_add_weights():
    """Averaged weights, a mask, several blocks, and more steps along a row than a tile has room for.

    A weight, at most 1, is off by less than 2^-20 (bounds.EXP and 3 (2 radius + 1)^2 terms), so the quotient by less
    than 2^-18 of the range of f, which is 1.
    """
    gpu = warp.make(dataclasses.replace(backends.get("warp:cpu").device, kind="gpu"), "float32")
    grid = GridGraph((9, 137), 29, "chebyshev", mask=cases.rng(5).random((9, 137)) < 0.85)
    f, lam = cases.function(grid), cases.fidelity(grid)
    form = dataclasses.replace(PatchCase("", radius=1, scale=0.5, shift=0.125, spatial=True).form(grid), average=1)
    assert gpu._tiles(grid, form, 1, 1).count > 1
    found, exact = (
        b.get(grid, b.similarity_step(grid, f, form, b.put(grid, f), b.put(grid, lam))) for b in (gpu, oracle())
    )
    np.testing.assert_allclose(found, exact, rtol=0, atol=2.0**-18)


def test_tiles_of_a_gpu_sweep(monkeypatch):
    """As the oracle; a part of a grid, whose tiles lie elsewhere, has the bits of the whole."""
    gpu = warp.make(dataclasses.replace(backends.get("warp:cpu").device, kind="gpu"), "float32")
    launched = []
    launch = gpu._launch
    monkeypatch.setattr(
        gpu, "_launch", lambda dim, make, *args, **given: launched.append(make) or launch(dim, make, *args, **given)
    )
    check(gpu, ROWS["sweep"], problem(Kind(cases.Setup("grid"))))
    assert sweep_gpu.make in launched

    def swept(f):
        grid = GridGraph(f.shape)
        values = gpu.put(grid, f.reshape(-1, 1))
        out = gpu.sweep(
            gpu.prepare(grid, None), values, values, 0.5, Smoothness(1.0, cases.EPS), theta=1.0, g=None,
            out=nan(gpu, grid, 1),
        )  # fmt: skip
        return gpu.get(grid, out).reshape(f.shape)

    f = cases.rng(3).random((45, 150), dtype=np.float32)
    np.testing.assert_array_equal(swept(f[7:, 11:])[2:, 2:], swept(f)[9:, 13:])


class InventedCuda:
    """Warp's captures, of a device that is not there."""

    is_cuda = True

    def __init__(self, works):
        self.works, self.capturing, self.done, self.graphs = works, False, [], []

    def ScopedCapture(self, **given):
        device = self

        class Capture:
            def __enter__(self):
                if not device.works:
                    raise RuntimeError("no graphs")
                device.capturing, device.captured = True, []
                return self

            def __exit__(self, *error):
                device.capturing, self.graph = False, device.captured

        return Capture()

    def capture_launch(self, graph):
        self.graphs.append(len(graph))
        self.done += graph

    def command(self, name):
        device = self

        class Command:
            value = 0.0

            def set_param_at_index(self, at, value):
                self.value = value

            def launch(self):
                (device.captured if device.capturing else device.done).append((name, self.value))

        return Command()


@pytest.mark.parametrize("works", [True, False])
def test_launches_with_the_same_numbers_become_a_graph(monkeypatch, works):
    """From the second replay on; another number takes plain launches again; a driver without graphs takes them all."""
    cuda = InventedCuda(works)
    monkeypatch.setattr(recording, "wp", cuda)
    record = recording.Record(cuda)
    record.add([cuda.command("first")], [Parameter.of(1.0, 0)])
    record.add([cuda.command("second")], [])
    numbers = (0.5, 0.5, 0.5, 2.0, 0.5, 0.5)
    for number in numbers:
        record.replay(number)
    assert cuda.done == [launch for number in numbers for launch in (("first", number), ("second", 0.0))]
    assert cuda.graphs == ([2, 2, 2] if works else [])


FORKED = """
import os, sys
import numpy as np
from gpureg import backends
from gpureg.backends.warp import pool as warp
from gpureg.graphs.grid import GridGraph

warp.LEAST_WORK, warp.cores = 16, lambda: 2
backend, grid = backends.get("warp:cpu"), GridGraph((37, 53))
weighted, f = backend.prepare(grid, None), backend.put(grid, np.arange(37.0 * 53)[:, None])

def norm():
    return backend.get(grid, backend.gradient_norm(weighted, f, power=0.5, eps=0.1, coupled=True)).tobytes()

before = norm()
assert warp._pool._threads is not None
child = os.fork()
if not child:
    os._exit(0 if warp._pool._threads is None and norm() == before and warp._pool._threads else 1)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) or norm() != before)
"""


@pytest.mark.skipif(not hasattr(sys.modules["os"], "fork"), reason="a system without fork")
def test_a_forked_child_makes_its_own_threads():
    subprocess.run([sys.executable, "-W", "ignore", "-c", FORKED], check=True, timeout=120)
