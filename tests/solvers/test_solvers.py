"""One protocol of solvers: every method runs in the loop by itself; what problems and solvers share is checked once."""

from __future__ import annotations

from typing import Any

import cases
import numpy as np
import pytest

import gpureg as gr
from gpureg import backends
from gpureg.arrays import computed_type
from gpureg.model.on_device import DeviceProblem
from gpureg.model.problem import Problem
from gpureg.solvers import SOLVERS, run
from gpureg.solvers.dual import Dual
from gpureg.solvers.linear import Linear
from gpureg.solvers.loop import Outcome, Solver
from gpureg.solvers.newton import Newton
from gpureg.solvers.stopping import TESTS

GRID = gr.GridGraph((9, 12))
FLOAT64 = np.dtype(np.float64)


def alone(solver: Solver, p: float, max_iter: int) -> Outcome:
    """A solver in the loop, with nothing else."""
    problem = Problem.make(cases.function(GRID), GRID, p=p, lam=0.8, dtype=FLOAT64, smoothed=False)
    on = DeviceProblem.put(problem, backends.get("numpy", FLOAT64))
    start = on.put_function(problem.f0)
    return run(on, solver, start, max_iter=max_iter, tol=None, callback=None, report=lambda done: None)


@pytest.mark.parametrize(("solver", "p", "steps"), [(Dual(), 1.0, 2000), (Linear(), 2.0, 40), (Newton(), 1.5, 30)])
def test_a_method_of_certified_is_a_solver_of_its_own(solver: Solver, p: float, steps: int) -> None:
    """It reaches the minimiser that `Certified` certifies, and says by itself how far it is."""
    found = alone(solver, p, steps)
    gap = found.course.gaps[-1]
    assert gap is not None
    assert gap <= 1e-6 * found.course.energies[-1]
    exact = gr.regularize(
        cases.function(GRID), GRID, p=p, lam=0.8, solver=gr.Certified(tol=1e-8), backend="numpy", dtype=float
    )
    assert exact.error_bound is not None
    distance = float(np.linalg.norm(found.problem.get_function(found.f) - exact.value))
    assert distance <= exact.error_bound + np.sqrt(2 * gap / 0.8)


@pytest.mark.parametrize("solver", [*(kind() for kind in SOLVERS.values()), Dual(), Linear(), Newton()])
def test_a_state_has_the_last_two_iterates(solver: Solver) -> None:
    found = alone(solver, 2.0, 3)
    f, previous = (found.problem.get_function(x) for x in (found.state.f, found.state.previous))
    assert np.array_equal(f, found.problem.get_function(found.f))
    assert f.shape == previous.shape == (GRID.n_vertices, 1)
    assert np.abs(f - previous).max() == pytest.approx(found.course.changes[-1])


@pytest.mark.parametrize("stop", TESTS)
@pytest.mark.parametrize("kind", [gr.Jacobi, gr.Euler])
def test_what_a_stop_test_holds_is_counted(kind: type, stop: str) -> None:
    """A test's arrays on the device are those that the memory is reckoned with."""
    problem = Problem.make(cases.function(GRID), GRID, dtype=FLOAT64)
    on = DeviceProblem.put(problem, backends.get("numpy", FLOAT64))
    state = kind(stop=stop).start(on, on.put_function(problem.f0))
    held = [x for x in vars(state.test).values() if isinstance(x, np.ndarray)]
    assert (len(held), 0) == kind(stop=stop).keeps(problem)


@pytest.mark.parametrize(
    ("lam", "shape"), [(2, ()), (np.float32(2), ()), (np.full(108, 2), (108, 1)), (np.full((9, 12), 2.0), (108, 1))]
)
def test_the_fidelity_of_a_problem_is_an_array(lam: object, shape: tuple[int, ...]) -> None:
    problem = Problem.make(cases.function(GRID), GRID, lam=lam, dtype=FLOAT64)
    assert problem.lam.shape == shape
    assert problem.lam.dtype == np.float64
    assert (problem.lam == 2).all()


def test_the_fidelity_outside_a_mask_is_infinite() -> None:
    mask = np.ones((9, 12), bool)
    mask[2, 3] = False
    grid = gr.GridGraph((9, 12), mask=mask)
    problem = Problem.make(cases.function(grid), grid, lam=np.full((9, 12), 2.0), dtype=FLOAT64)
    assert np.array_equal(np.isinf(problem.lam), ~mask.reshape(-1, 1))
    assert Problem.make(cases.function(grid), grid, lam=2.0, dtype=FLOAT64).lam == 2


@pytest.mark.parametrize(
    ("given", "kind"),
    [(None, "float32"), ("f4", "float32"), (float, "float64"), (">f8", "float64"), (">f4", "float32")],
)
def test_the_type_to_compute_in(given: object, kind: str) -> None:
    found = computed_type(given)
    assert found == kind
    assert found.isnative


@pytest.mark.parametrize("given", ["float16", int, "word", complex])
def test_another_type_gets_a_sentence(given: object) -> None:
    with pytest.raises(ValueError, match="dtype must be float32 or float64, got"):
        computed_type(given)


def test_a_check_cut_short_leaves_no_gap_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C while the gap is taken: the energies are those of whole checks, and there is no gap."""
    noisy = np.random.default_rng(7).standard_normal((12, 9))
    looks: list[int] = []
    real = Dual.certify

    def cut(self: Dual, problem: Any, state: Any, course: Any) -> Any:
        looks.append(1)
        if len(looks) == 3:
            raise KeyboardInterrupt
        return real(self, problem, state, course)

    monkeypatch.setattr(Dual, "certify", cut)
    with pytest.raises(gr.Interrupted) as caught:
        gr.regularize(noisy, gr.GridGraph(noisy.shape), p=1, lam=1, solver=gr.Certified(tol=1e-9), backend="numpy")
    result = caught.value.result
    assert result.gap is None and result.error_bound is None
    assert len(result.energy) == len(result.checks) == 2
    assert result.iterations > result.checks[-1]


@pytest.mark.parametrize("answer", [True, np.True_])
def test_true_is_true_whoever_says_so(answer: Any) -> None:
    """A comparison of numpy numbers stops the run as one of Python's does."""
    noisy = np.random.default_rng(7).standard_normal((12, 9))
    result = gr.regularize(noisy, gr.GridGraph(noisy.shape), p=1, backend="numpy", callback=lambda check: answer)
    assert result.stop is gr.Stop.CALLBACK and result.iterations == 0
    told = gr.regularize(noisy, gr.GridGraph(noisy.shape), max_iter=5, backend="numpy", callback=lambda check: 1)
    assert told.iterations == 5
