"""The Warp backend's own: launches on several threads, strips of cells, the step whose weights are never stored."""

from __future__ import annotations

import subprocess
import sys

import cases
import numpy as np
import pytest
import rows  # noqa: F401, fills ROWS
from checking import check, nan
from primitives import ROWS
from problems import Kind, PatchCase, problem

from gpureg import backends
from gpureg.backends import Smoothness
from gpureg.graphs.grid import GridGraph

if "warp" in backends.absent():
    pytest.skip(backends.absent()["warp"], allow_module_level=True)

import warp as wp
from gpureg.kernels.warp import aggregate, jacobi_step, patch_distance, similarity_step, total
from gpureg.kernels.warp import grid as grid_kernels

from gpureg.backends.warp import pool as warp_pool


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
        patch_distance.make_grid(wp.float64, True, (3, 3, 1, 0, False, True, 1, 1, 1)),
        aggregate.make(access, 2),
        jacobi_step.make(access, 1, 1, "vertex", True, 1, False),
        total.make(wp.float64, False),
    ):
        wp.compile_aot_module(kernel.module, arch=80, module_dir=tmp_path, use_ptx=True)
    assert len(list(tmp_path.glob("*.ptx"))) == 5


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
