"""Recorded work: what is launched again is the work asked for, on what its buffers hold now."""

from __future__ import annotations

import gc
import weakref
from concurrent.futures import ThreadPoolExecutor

import cases
import numpy as np
import pytest

from gpureg import backends
from gpureg.backends import Smoothness, in_turns

MODEL = Smoothness(1.0, cases.EPS)


@pytest.fixture
def grid_parts(device, monkeypatch):
    """A backend, a graph on it, two iterates, the data and lam, as other tests have them compiled.

    In OpenCL the second replay already has kernel objects of its own.
    """
    if device.startswith("opencl"):
        from gpureg.backends.opencl import recording

        monkeypatch.setattr(recording, "_SHARED", 1)
    backend, grid = backends.get(device, np.float32), cases.graph("grid")
    weighted = backend.prepare(grid, cases.weights("grid"))
    f, f0, lam = (
        backend.put(grid, x) for x in (cases.function(grid), cases.function(grid, seed=13), np.ones((1961, 1)))
    )
    return backend, weighted, f, backend.empty(grid, 1), f0, lam


def test_recorded_sweeps_have_the_bits_of_sweeps(grid_parts):
    """Once done, once recorded, thrice replayed in each direction, against sweeps one by one."""
    backend, weighted, f, other, f0, lam = grid_parts
    grid = weighted.graph
    g = backend.empty(grid, 1)
    plain = [backend.put(grid, cases.function(grid)), backend.empty(grid, 1)]

    def sweep(on, here, there):
        on.sweep(weighted, here, f0, lam, MODEL, theta=1.0, g=g, out=there)

    turns = list(in_turns(backend, sweep, f, other))
    for _ in range(10):
        turns[0]()
        turns.reverse()
        sweep(backend, *plain)
        plain.reverse()
    assert backend.get(grid, f).tobytes() == backend.get(grid, plain[0]).tobytes()
    assert backend.get(grid, other).tobytes() == backend.get(grid, plain[1]).tobytes()


def test_numbers_of_recorded_work_can_change(grid_parts):
    """The momentum of a dual step is another number in each step."""
    backend, weighted, _, _, f0, lam = grid_parts
    grid, betas = weighted.graph, (0.0, 0.3, 0.6, 0.1, 0.7, 0.2, 0.5, 0.4, 0.9, 0.8)

    def step(on, here, there, beta):
        on.dual_step(weighted, here[0], there[0], here[1], there[1], MODEL, beta=beta, sigma=0.01)
        on.primal(weighted, there[0], f0, lam, out=there[1])

    found = []
    for recorded in (True, False):
        pairs = [(backend.empty_edges(grid, 1), backend.put(grid, cases.function(grid))) for _ in range(2)]
        turns = list(in_turns(backend, step, *pairs))
        for beta in betas:
            if recorded:
                turns[0](beta)
            else:
                step(backend, *pairs, beta)
            turns.reverse()
            pairs.reverse()
        found.append(backend.get_edges(grid, pairs[0][0]).tobytes())
    assert found[0] == found[1]


def test_a_record_keeps_its_buffers_and_gives_them_up(grid_parts):
    """No buffer of a record dies before it, even if nothing else holds it, nor after it."""
    backend, weighted, f, other, f0, lam = grid_parts
    grid = weighted.graph

    def record():
        g = backend.empty(grid, 1)
        turns = in_turns(backend, lambda on, a, b: on.sweep(weighted, a, f0, lam, MODEL, theta=1, g=g, out=b), f, other)
        for turn in turns * 3:
            turn()
        return turns, weakref.ref(g)

    turns, kept = record()
    gc.collect()
    expected = backend.get(grid, f)
    turns[0]()
    turns[1]()
    assert kept() is not None
    assert not np.array_equal(backend.get(grid, f), expected)
    del turns
    gc.collect()
    assert kept() is None or backend.name == "numpy"


@pytest.mark.one_driver
def test_records_of_two_threads_do_not_meet(grid_parts):
    """Kernel objects that are shared hold the arguments of one launch at a time."""
    backend, weighted, _, _, f0, lam = grid_parts
    grid = weighted.graph

    def swept(seed):
        pair, g = [backend.put(grid, cases.function(grid, seed=seed)), backend.empty(grid, 1)], backend.empty(grid, 1)

        def sweep(on, here, there):
            on.sweep(weighted, here, f0, lam, MODEL, theta=1.0, g=g, out=there)

        turns = list(in_turns(backend, sweep, *pair))
        for _ in range(20):
            turns[0]()
            turns.reverse()
        return backend.get(grid, pair[0]).tobytes()

    alone = [swept(seed) for seed in (3, 5)]
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(swept, [3, 5] * 3)) == alone * 3
