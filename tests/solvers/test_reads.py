"""What is read back from a device: nothing but at checks."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import cases
import numpy as np
import pytest

import gpureg as gr
from gpureg import backends
from gpureg.solvers.dual import Dual
from gpureg.solvers.jacobi import Jacobi
from gpureg.solvers.linear import Linear

GRID = gr.GridGraph((12, 9))
F0 = cases.function(GRID).astype(np.float32)


@pytest.fixture
def reads(device: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """The reads so far, by their kind."""
    backend, found = backends.get(device, "float32"), []
    if backend.name == "numpy":
        pytest.skip("numpy is the host")

    def counted(owner: Any, name: str) -> None:
        call = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *args, **named: (found.append(name), call(*args, **named))[1])

    if backend.name == "opencl":
        counted(type(backend), "_download")
    else:
        import warp as wp

        counted(wp.array, "numpy")
    return found


@pytest.mark.one_driver
@pytest.mark.parametrize(("model", "solver", "iterates"), [
    ({"p": 1, "lam": 1.0}, gr.Jacobi(check_every=7), Jacobi),
    ({"p": 3, "lam": 1.0}, gr.Jacobi(check_every=7), Jacobi),
    ({"p": 1, "lam": 1.0}, gr.Jacobi(check_every=40, accelerate=True), Jacobi),
    ({"p": 3, "lam": 1.0}, gr.Jacobi(check_every=40, accelerate=True), Jacobi),
    ({"p": 1, "lam": 1.0}, gr.Euler(check_every=7), gr.Euler),
    ({"p": 1, "lam": 4.0}, gr.Certified(method="dual", tol=0), Dual),
    ({"p": 2, "lam": cases.fidelity(GRID)[:, 0] + 0.1}, gr.Certified(tol=0), Linear),
    ({"p": 2, "lam": 0.1}, gr.Certified(tol=0), Linear),
], ids=["p = 1", "p = 3", "accelerated", "accelerated p = 3", "euler", "dual", "diagonal", "cosines"])  # fmt: skip
def test_iterations_read_nothing(
    device: str, reads: list[str], model: Any, solver: Any, iterates: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reads during iterations are counted apart from those at checks; as on a GPU, also for cosine transforms."""
    inside, iterations, advance = [], [], iterates.advance

    def watched(self: Any, problem: Any, state: Any) -> Any:
        before = len(reads)
        state = advance(self, problem, state)
        inside.append(len(reads) - before)
        iterations.append(1)
        return state

    monkeypatch.setattr(iterates, "advance", watched)
    monkeypatch.setattr(type(backends.get(device, "float32")), "transforms", True)
    result = gr.regularize(F0, GRID, solver=solver, backend=device, eps=None, max_iter=40, **model)
    assert len(iterations) == result.iterations > 5
    assert sum(inside) == 0
    assert len(reads) > 0
    if solver != gr.Certified(tol=0):
        oracle = gr.regularize(F0, GRID, solver=solver, backend="numpy", dtype=float, max_iter=40, **model)
        assert np.abs(result.value - oracle.value).max() <= 10 * cases.TOLERANCES["float32"]


def rising() -> Iterator[tuple[gr.Graph, np.ndarray]]:
    """Graphs on which a damping of 1/(p - 1) can raise the energy, as in test_processes."""
    generator = cases.rng(1)
    for _ in range(100):
        n = int(generator.integers(4, 9))
        pairs = np.array(list(itertools.combinations(range(n), 2)))
        kept = pairs[generator.random(len(pairs)) < 0.5]
        graph = gr.Graph.from_edges(kept, generator.choice([0.1, 1.0, 30.0], len(kept)), n_vertices=n)
        yield graph, generator.integers(-20, 20, (n, 2)) / 10


@pytest.mark.parametrize("accelerate", [False, True])
def test_checks_do_not_change_shortened_sweeps(accelerate: bool) -> None:
    """A sweep that raises the energy is found at the next check, and done again as with a look at each.

    Accelerated, it also begins the history anew, at the check: only the energy is promised.
    """
    given = {"p": 3, "lam": 0, "eps": 0.05, "norm": "edge", "max_iter": 15, "backend": "numpy", "dtype": float}
    shortened = 0
    for graph, f0 in itertools.islice(rising(), 28, 34):  # one of them raises it
        results = [
            gr.regularize(f0, graph, solver=gr.Jacobi(check_every=every, accelerate=accelerate), **given)
            for every in (1, 4, 15)
        ]
        for result in results:
            assert np.diff(result.energy).max() <= 1e-12 * max(result.energy[0], 1e-20)
        if not accelerate:
            assert len({(result.value.tobytes(), result.method) for result in results}) == 1
        shortened += "shortened" in results[2].method
    assert shortened == 1


def test_an_interruption_does_not_leave_a_risen_energy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pressed before the check that would have found the rise: the sweeps are done again then."""
    graph, f0 = next(itertools.islice(rising(), 31, None))
    given = {"p": 3, "lam": 0, "eps": 0.05, "norm": "edge", "backend": "numpy", "dtype": float}
    solver = gr.Jacobi(check_every=50)
    expected = gr.regularize(f0, graph, solver=solver, max_iter=14, **given)
    advance, calls = Jacobi.advance, []

    def pressed(self: Any, problem: Any, state: Any) -> Any:
        calls.append(1)
        if len(calls) == 15:
            raise KeyboardInterrupt
        return advance(self, problem, state)

    monkeypatch.setattr(Jacobi, "advance", pressed)
    with pytest.raises(gr.Interrupted) as caught:
        gr.regularize(f0, graph, solver=solver, max_iter=50, **given)
    assert caught.value.result.iterations == 14
    assert np.array_equal(caught.value.result.value, expected.value)
    assert "shortened" in caught.value.result.method
