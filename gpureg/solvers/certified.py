"""Find the minimiser, with a bound on the error."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Generic

import numpy as np

from ..backends import Array
from ..checks import choice, number
from ..doors import door
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from ..model.result import Stop
from .box import inside, with_box
from .dual import Dual, hidden
from .linear import Linear
from .loop import Course, S, Solver, changed
from .newton import Newton
from .primal_dual import PrimalDual
from .stopping import largest_value

METHODS: dict[str, type[Solver]] = {"dual": Dual, "primal-dual": PrimalDual, "linear": Linear, "newton": Newton}


# Newton's method takes over if more iterations than this are needed: at 512 x 512 it takes 3 to 5 s, as long as 300
# iterations in numpy or 2000 compiled ones.
_WORTH, _WORTH_COMPILED = {"numpy": 300}, 2000
# At p = 1 a primal-dual step is cheap and Newton takes many steps: as long as so many times more. A hole of 256 x 256
# in a picture takes 5800 primal-dual steps, 2.5 s, where the rate of the first 256 predicts 10 000, and Newton 60 s.
_CHEAP = 16
# Iterations before the rate of a method is known. Primal-dual steps begin slowly.
_KNOWN, _KNOWN_PRIMAL_DUAL = 50, 200
# Machine epsilons of the largest value by which rounding changes a converged f: measured up to 2.
_STILL = 4
# Bytes of weights up to which matrices of a graph are made on the host.
_HOST_EDGES = 1 << 28
# A start from p = 2: maximal number of iterations, those between two looks, and the change at which they end, as a
# share of the data's spread.
_SQUARES, _LOOK, _CHANGE = 1000, 3, 1e-4


@dataclass(frozen=True)
class _State(Generic[S]):
    method: Solver[S]
    inner: S  # the state of the method
    begun: int  # the check of the course at which the method began
    before: str = ""  # description of the method before it
    bound: float = -math.inf  # the highest dual energy so far

    @property
    def f(self) -> Array:
        return self.inner.f

    @property
    def previous(self) -> Array:
        return self.inner.previous


@door
@dataclass(frozen=True)
class Certified(Solver[_State]):
    """Find a minimiser for p >= 1, with a computed duality gap.

    Parameters
    ----------
    tol : float, default 1e-4
        Stop once the gap is at most this share of the energy.
    method : {"auto", "dual", "primal-dual", "linear", "newton"}, default "auto"
        "linear": only for p = 2, a linear system; conjugate gradients on the device, preconditioned by cosine
        transforms on a grid without mask and weights if lam is a number, otherwise by multigrid or, where lam is large,
        by the diagonal. "dual": accelerated proximal gradient steps on the dual problem, for lam > 0. "primal-dual":
        proximal steps on f and on the dual variable in turn, for any lam. "newton": a few expensive primal-dual Newton
        steps with multigrid, in float64 if the device has it. "auto" begins with "linear" for p = 2, otherwise with
        "dual"; where lam has zeros, with "primal-dual" for p < 2 and "newton" for p > 2. It changes to "newton" if the
        first method would be slow (for a small lam). All are on the device.

    Raises
    ------
    TypeError, ValueError
        A tol that is not >= 0; an unknown method. At use: p < 1, or a lam that is 0 somewhere with "dual".

    Notes
    -----
    The gap is the energy of f minus the dual energy of a function y on the edges (kernels/README.md, ``duality_gap``).
    The dual energy is a lower bound on every energy, so that the gap bounds how far the energy of f is above the
    minimum, for any f. Where lam is 0 this needs bounds on a minimiser: the range of the data in the component of the
    graph, or for a gamma that is not symmetric a wider range that follows from the energy. A component without data is
    set to a constant, with a RuntimeWarning. If lam > 0 everywhere, the energy is lam-strongly convex and |f - f*|^2 <=
    2 gap / min lam; where lam has zeros ``Result.error_bound_note`` says what is known. The gap includes a bound on
    its rounding error, p machine epsilons of the energy: a smaller `tol` ends with :attr:`gpureg.Stop.PRECISION`. At
    p = 2 "linear" computes the gap from a residual, with less rounding.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> f0 = np.array([0, 0, 0.3, 0, 1, 1, 0.8, 1])
    >>> solver = gr.Certified(tol=1e-6)
    >>> result = gr.regularize(f0, gr.GridGraph(8), p=1, lam=4, solver=solver, dtype=float, backend="numpy")
    >>> bool(result.gap <= 1e-6 * result.energy[-1])
    True
    """

    tol: float | None = 1e-4
    method: str = "auto"

    most: ClassVar[int] = 20_000
    smooths: ClassVar[bool] = False
    renews: ClassVar[bool] = False

    def __post_init__(self) -> None:
        number("tol", self.tol, low=0)
        choice("method", self.method, ("auto", *METHODS))

    def accept(self, problem: Problem) -> None:
        """Raise ValueError unless the problem has one minimiser and the method supports it."""
        if problem.p < 1:
            raise ValueError(
                f"solver='certified' needs p >= 1, got {problem.p:g}: below 1 the energy is not convex and can have "
                "many local minima. solver='jacobi' finds one, which depends on the start"
            )
        if self.method == "dual" and not np.min(problem.lam) > 0:
            raise ValueError("method='dual' needs lam > 0 at every vertex: use method='auto' or 'primal-dual'")
        if self.method == "linear" and problem.p != 2:
            raise ValueError(f"method='linear' is for p = 2, got p = {problem.p:g}")

    def prepare(self, problem: DeviceProblem) -> DeviceProblem:
        """Return the problem with a box where lam has zeros, and components without data set to a constant."""
        return with_box(problem)

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """Start the method for this problem: where lam has zeros, from the solution for p = 2."""
        method, before = self._first(problem.problem), problem.without_data
        before += ". " if before else ""
        initial, own = inside(problem, initial)
        if problem.box is not None and problem.p != 2 and not own:
            initial, said = _of_squares(problem, initial)
            before += said
        return _State(method, method.start(problem, initial), 0, before)

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """Return the memory that the first method needs, and where lam has zeros f0 and the box."""
        functions, edges = self._first(problem).keeps(problem)
        if np.min(problem.lam, initial=np.inf) > 0:
            return functions, edges
        return max(functions, Linear().keeps(problem)[0]) + 4, edges

    def _first(self, problem: Problem) -> Solver:
        if self.method != "auto":
            return METHODS[self.method]()
        if problem.p == 2:
            return Linear()
        if np.min(problem.lam, initial=np.inf) > 0:
            return Dual()
        return PrimalDual() if problem.p < 2 else Newton()

    def resume(self, problem: DeviceProblem, state: _State) -> _State:
        """Continue from the last state of the method, if the method still supports the problem."""
        if problem.box is not None or type(state.method) is not type(self._first(problem.problem)):
            return self.start(problem, state.f)
        return _State(state.method, state.method.resume(problem, state.inner), 0)

    def advance(self, problem: DeviceProblem, state: _State) -> _State:
        """Do one iteration of the method."""
        return changed(state, inner=state.method.advance(problem, state.inner))

    def next_check(self, state: _State, done: int) -> int:
        """Return the next check of the method."""
        return state.method.next_check(state.inner, done)

    def certify(self, problem: DeviceProblem, state: _State, course: Course) -> tuple[_State, float]:
        """Compute the gap, and change to Newton's method if the current one would be slow."""
        energy = course.energies[-1]
        inner, gap = state.method.certify(problem, state.inner, course)
        assert gap is not None  # every method of METHODS has one
        # every dual energy is a lower bound: use the highest so far
        gap = min(gap, max(energy - state.bound, 0.0) + hidden(problem, energy))
        bound = max(state.bound, energy - gap)
        state = replace(state, inner=inner, bound=bound)
        if self.method == "auto" and not isinstance(state.method, Newton):
            backend, graph = problem.backend, problem.weighted.graph
            patience = _WORTH.get(backend.name, _WORTH_COMPILED)
            # no method can reach a tolerance below the rounding of the gap
            rounding = problem.p * float(np.finfo(backend.dtype).eps)
            within = course.tol is not None and course.tol > rounding
            # at p = 2 Newton's method is the linear system again
            within = within and not isinstance(state.method, Linear)
            steps_of_both = isinstance(state.method, PrimalDual)
            if steps_of_both and problem.p == 1:
                patience *= _CHEAP
            left = _remaining(course, gap, _KNOWN_PRIMAL_DUAL if steps_of_both else _KNOWN)
            if within and left > patience and backend.edge_bytes(graph) <= _HOST_EDGES:
                newton = Newton()
                rate = "the gap did not fall" if math.isinf(left) else f"about {left:.2g} more were left at their rate"
                before = f"{state.before}{state.method.describe(inner)} ({course.checks[-1]} iterations; {rate}), then "
                return _State(newton, newton.start(problem, inner.f), len(course.checks), before, bound), gap
        return state, gap

    def judge(self, problem: DeviceProblem, state: _State, course: Course) -> Stop | None:
        """Stop at a gap within the tolerance, or at one limited by rounding.

        The latter has not fallen by a fifth while the iterations doubled, and f hardly changes.
        """
        gaps = [gap for gap in course.gaps if gap is not None]
        if course.tol is not None and gaps[-1] <= course.tol * course.energies[-1]:
            return Stop.GAP_NO_DATA if problem.without_data else Stop.GAP
        # only the checks of this method
        gaps, checks = gaps[state.begun :], course.checks[state.begun :]
        if not gaps:
            return None
        done = checks[-1] - checks[0]
        early = [gap for gap, at in zip(gaps, checks, strict=True) if 2 * (at - checks[0]) <= done]
        least = min(gaps)
        if done >= state.method.patience and (least == math.inf or least > 0.8 * min(early)):
            unit = float(np.finfo(problem.backend.dtype).eps) * largest_value(problem)
            return Stop.PRECISION if course.changes[-1] <= _STILL * unit else None
        return None

    def error_bound(self, problem: DeviceProblem, state: _State, gap: float, energy: float) -> tuple[float | None, str]:
        """Bound the distance of f from the minimiser as the method does."""
        return state.method.error_bound(problem, state.inner, gap, energy)

    def rounding(self, problem: DeviceProblem, state: _State, gap: float, energy: float) -> float:
        """Bound the roundings that are not in the gap of the method."""
        return state.method.rounding(problem, state.inner, gap, energy)

    def describe(self, state: _State) -> str:
        """Describe what the methods did."""
        return state.before + state.method.describe(state.inner)


def _of_squares(problem: DeviceProblem, initial: Array) -> tuple[Array, str]:
    """Return the solution of the same problem with p = 2, about, and what was done."""
    # without the box, which only a certificate needs
    squares = replace(problem.changed(replace(problem.problem, p=2.0, eps=0.0)), box=None)
    linear, done = Linear(), 0
    state, still = linear.start(squares, initial), _CHANGE * problem.problem.spread
    while done < _SQUARES:
        state, done = linear.advance(squares, state), done + 1
        if done % _LOOK == 0 and not squares.change(state.f, state.previous) > still:
            break
    return state.f, f"From the solution for p = 2 ({done} iterations): "


def _remaining(course: Course, gap: float, known: int) -> float:
    """Estimate the remaining iterations to the tolerance, from the rate of the second half of those done.

    It is 0 as long as fewer than `known` are done.
    """
    done = course.checks[-1]
    if done < known or not course.tol:
        return 0.0
    target = course.tol * course.energies[-1]
    half = max(k for k, at in enumerate(course.checks[:-1]) if 2 * at <= done)
    earlier = course.gaps[half]
    assert earlier is not None
    if not gap > target > 0:
        return 0.0
    if not earlier > gap:
        return math.inf
    return (done - course.checks[half]) * math.log(gap / target) / math.log(earlier / gap)
