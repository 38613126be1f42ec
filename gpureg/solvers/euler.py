"""The explicit Euler process of the paper, eq. 24, with a stable step."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..backends import Array, Backend, Smoothness, in_turns
from ..checks import integer, number
from ..doors import door
from ..model.on_device import DeviceProblem
from .loop import changed
from .stopping import LOCAL, Process, ProcessState


@dataclass(frozen=True)
class _State(ProcessState):
    step: float
    bound: float


@door
@dataclass(frozen=True)
class Euler(Process[_State]):
    """Explicit Euler steps: f + tau (lam (f0 - f) - p-Laplacian of f) (eq. 24).

    Parameters
    ----------
    step : float, optional
        tau > 0. None: half of the bound below.
    check_every : int, default 10
        Steps between two checks of energy and change, which read from the device.
    stop : {"change", "error", "gradient", "energy"}, default "change"
    tol : float, optional
        The stop test and its tolerance, as in :class:`gpureg.Jacobi`.

    Raises
    ------
    TypeError, ValueError
        A step that is not > 0; a check_every that is not an integer >= 1; an unknown stop; a tol that is not >= 0. At
        use, for p = 2: a step above 2/mu, mu the largest eigenvalue of lam + Laplacian, with which the process
        diverges.

    Warns
    -----
    RuntimeWarning
        For p other than 2: a step above the bound, with which the energy may rise.

    Notes
    -----
    Let A be the matrix with fixed conductances. For p <= 2 a step of at most 2/mu_max(A) does not raise the energy.
    x'Ax <= sum_u (lam(u) + 2 alpha(u)) x(u)^2, with alpha(u) the sum of the alpha of eq. 25, and conductances are at
    most c = eps^(p - 2), 1 at p = 2. This gives the bound 2/max_u(lam(u) + 4 c sum_v gamma(u, v)^2), with 2 c for the
    edge norm. For p > 2 conductances are bounded by the range of the data, which half the bound preserves. For p < 2 a
    small eps makes the bound small: Gauss-Jacobi, with a step per vertex, is faster.

    Examples
    --------
    >>> Euler(step=0.1)
    Euler(step=0.1, check_every=10, stop='change', tol=None)
    """

    step: float | None = None
    check_every: int = 10
    stop: str = "change"
    tol: float | None = None

    def __post_init__(self) -> None:
        if self.step is not None:
            number("step", self.step, above=0)
        integer("check_every", self.check_every, low=1)
        self.check()

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """Check that the step is stable; return the state before the first step, from `initial`, (n, m)."""
        backend, graph = problem.backend, problem.weighted.graph
        degree, lam = _variable(problem)
        # steps are in units of 1/lam
        unit = float(problem.problem.frame.lam(np.ones(()), problem.p))
        bound = stable_step(problem, initial, degree, lam)
        step = self.step / unit if self.step is not None else (bound / 2 if math.isfinite(bound) else 1.0)
        if step > bound * (1 + 1e-9):
            if problem.p == 2:
                _expect_stable(problem, step, bound, lam)  # at p = 2 the unit is 1
            else:
                warnings.warn(
                    f"step = {step * unit:g} is beyond the bound {bound * unit:.6g} for p = {problem.p:g} and "
                    f"eps = {problem.eps * problem.problem.frame.scale:g}: "
                    "the energy may rise, or the process diverge. Use a smaller step, a larger eps, or solver='jacobi'",
                    RuntimeWarning,
                    stacklevel=2,
                )
        # steps of g = s f are s^2 times as long, because eq. 24 is for f: then tau is (n, 1), on the device
        tau: float | Array = step if problem.scale is None else backend.put(graph, step * problem.scale**2)
        empty, test = backend.empty(graph, problem.channels), self.test(problem, initial)
        g = problem.scratch()

        def forward(backend: Backend, f: Array, out: Array) -> None:
            conductances = backend.conductances(problem.weighted, f, problem.model, g=g)
            backend.euler_step(problem.weighted, f, problem.f0, conductances, problem.lam, tau, out=out)

        turns = in_turns(backend, forward, initial, empty)
        return _State(initial, empty, g, test, problem.p < 1, turns, step * unit, bound * unit)

    def advance(self, problem: DeviceProblem, state: _State) -> _State:
        """Do one step, into the buffer of the second last iterate."""
        state.turns[0]()
        return changed(state, f=state.previous, previous=state.f, turns=state.turns[::-1])

    def describe(self, state: _State) -> str:
        """Describe the process, its step and the bound."""
        known = f"step {state.step:.6g}, where {state.bound:.6g} is known to be stable"
        return f"Explicit Euler (eq. 24), {known}{LOCAL if state.local else ''}"


def _variable(problem: DeviceProblem) -> tuple[FloatArray, FloatArray]:
    """Return the sum of gamma(u, v)^2 over the neighbours of each vertex, and lam, both (n,)."""
    n = problem.weighted.graph.n_vertices
    degree = problem.backend.get(problem.weighted.graph, problem.backend.degree(problem.weighted))[:, 0]
    degree = degree.astype(np.float64)
    if problem.scale is not None:
        degree = degree * problem.scale[:, 0] ** 2
    return degree, np.broadcast_to(problem.problem.lam, (n, 1))[:, 0]


def stable_step(problem: DeviceProblem, initial: Array, degree: FloatArray, lam: FloatArray) -> float:
    """Return a bound on steps that do not raise the energy; infinity if nothing moves; `degree` and `lam` are (n,)."""
    p, eps, free = problem.p, problem.eps, np.isfinite(lam)
    # a conductance of the vertex norm is the sum of two
    ends = 1 if problem.edge_norm else 2
    if p <= 2:
        conductance = 1.0 if p == 2 else eps ** (p - 2)
        return _reciprocal(2, lam[free] + 2 * ends * conductance * degree[free])
    if problem.weighted.directed:
        # no maximum principle, but the energy does not rise: (d^2 + eps^2)^(p/2) <= p E at every vertex and edge
        conductance = (p * problem.energy(initial)) ** ((p - 2) / p)
    else:
        # the values stay in their range, in the device's variable s f
        graph = problem.weighted.graph
        both = np.stack([problem.backend.get(graph, x).astype(np.float64) for x in (initial, problem.f0)])
        widths = np.ptp(both, axis=(0, 1)) ** 2
        largest = float(problem.backend.get(graph, problem.backend.degree(problem.weighted)).max(initial=0))
        square = largest * float(widths.sum() if problem.coupled else widths.max())
        conductance = (square + eps**2) ** ((p - 2) / 2)
    alpha = ends * conductance * degree[free]
    # the second bound preserves the range
    return min(_reciprocal(2, lam[free] + 2 * (p - 1) * alpha), _reciprocal(1, lam[free] + alpha))


def _reciprocal(numerator: float, values: FloatArray) -> float:
    largest = float(values.max(initial=0))
    return numerator / largest if largest > 0 else math.inf


def _expect_stable(problem: DeviceProblem, step: float, bound: float, lam: FloatArray) -> None:
    """Raise ValueError if step > 2/mu, mu the largest eigenvalue of lam + Laplacian on the vertices not pinned."""
    from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

    backend, weighted = problem.backend, problem.weighted
    graph, n = weighted.graph, weighted.graph.n_vertices
    free = np.isfinite(lam)
    scale = np.ones(n) if problem.scale is None else problem.scale[:, 0]
    g = problem.backend.conductances(weighted, None, Smoothness(2, 0, edge=problem.edge_norm))

    def apply(x: FloatArray) -> FloatArray:
        inside = np.where(free, x.ravel(), 0)
        flow = backend.get(graph, backend.p_laplacian(weighted, backend.put(graph, (scale * inside)[:, None]), g))
        return np.where(free, scale * flow[:, 0] + np.where(free, lam, 0) * inside, 0)

    if n < 3:  # too small for Lanczos
        largest = float(np.linalg.eigvalsh(np.stack([apply(e) for e in np.eye(n)])).max())
    else:
        operator = LinearOperator((n, n), matvec=apply, dtype=np.float64)
        try:
            # a Ritz value is never above the eigenvalue: a step found unstable is unstable
            start = np.random.default_rng(1).standard_normal(n)
            found = eigsh(operator, k=1, which="LA", tol=1e-4, v0=start, return_eigenvectors=False)
        except ArpackNoConvergence:
            found = np.array([2 / bound])
        largest = float(found[0])
    if step * largest > 2 * (1 + 1e-5):
        raise ValueError(
            f"step = {step:g} is unstable: beyond 2/mu = {2 / largest:.6g} the explicit Euler process diverges, mu = "
            f"{largest:.6g} being the largest eigenvalue of lam + Laplacian. Use a smaller step, or None for "
            f"{bound / 2:.6g}"
        )
