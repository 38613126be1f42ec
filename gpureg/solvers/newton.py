"""Primal-dual Newton steps.

The minimiser and its dual variable satisfy lam (f - f0) + d*y = 0 and y = phi'(|df|) df/|df|. For p < 2 Newton's method
on y (|df|^2 + eps^2)^((2 - p)/2) = df (Chan, Golub and Mulet 1999, for p = 1) hardly depends on eps, but Newton's
method on f alone is slow for a small eps. Eliminating the change of y gives for the change h of f

    lam h + d* [ g dh - k/2 (y <df, dh> + df <y, dh>) ] = - gradient,   g = q^((p-2)/2),  k = (2 - p) g q^(-p/2)

with q = |df|^2 + eps^2. The system is made symmetric, and y is shortened so that it is positive definite. For p > 2,
y = g df is Newton's method. The systems are solved on the host, by conjugate gradients with the matrix of eq. 25
(k = 0) as preconditioner.

For eps = 0 and p < 2 there are no second derivatives: the steps use an eps > 0 that decreases with the gap. y and the
gap still belong to the problem with eps = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..backends import BALL_ROUNDINGS, Array
from ..model.matrices import Difference
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from . import multigrid
from .dual import duality_gap
from .loop import Course, Solver

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Sufficient decrease (Armijo), and the maximal number of halvings of a step.
_DECREASE, _HALVINGS = 1e-4, 30
# Maximal conjugate gradient steps per Newton step, and their relative residual.
_INNER, _FORCING = 1000, 0.03
# If the problem has no smoothing: what that of the steps may add to the energy, as a share of the gap.
_PART = 0.1
# The smallest conductance, as a share of the largest one.
_FLOOR = 1e-10


@dataclass(frozen=True)
class _Model:
    """The energy on the host, in the caller's variable."""

    d: Difference
    f0: FloatArray
    lam: FloatArray  # (n, 1); 0 where f is pinned
    free: FloatArray  # (n, 1); 1, or 0 where f is pinned
    p: float
    coupled: bool
    edge_norm: bool

    @property
    def share(self) -> float:
        return 0.5 if self.edge_norm else 1.0

    def grouped(self, H: FloatArray) -> FloatArray:
        """Sum H, (D, m), over the edges of a vertex (not for the edge norm) and coupled channels; one row per edge."""
        if self.coupled:
            H = H.sum(axis=1, keepdims=True)
        if self.edge_norm:
            return H
        return self._around(H)[self.d.start]

    def _around(self, H: FloatArray) -> FloatArray:
        sums = [np.bincount(self.d.start, h, minlength=len(self.f0)).astype(np.float64) for h in H.T]
        return np.stack(sums, axis=1)

    def energy(self, f: FloatArray, eps: float) -> float:
        square = (self.d.matrix @ f) ** 2
        if self.coupled:
            square = square.sum(axis=1, keepdims=True)
        if not self.edge_norm:
            square = self._around(square)
        smoothness = self.share * ((square + eps**2) ** (self.p / 2)).sum() / self.p
        return float(smoothness + (self.lam * (f - self.f0) ** 2).sum() / 2)


@dataclass(frozen=True)
class _State:
    f: Array
    previous: Array
    model: _Model
    host: FloatArray
    y: FloatArray
    eps: float  # of the next step
    cycle: multigrid.Preconditioner | None = None  # if it is the same for all steps
    box: tuple[FloatArray, FloatArray] | None = None
    inner: int = 0
    halved: int = 0


@dataclass(frozen=True)
class Newton(Solver[_State]):
    """Newton's method, primal-dual for p < 2."""

    patience = 20

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """Return the memory needed: the start, and the dual variable at a check."""
        return 1, 1

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """Return the state before the first step, from `initial`, (n, m)."""
        backend, graph = problem.backend, problem.weighted.graph
        given = np.broadcast_to(problem.problem.lam, (graph.n_vertices, 1))
        free = np.isfinite(given).astype(np.float64)
        model = _Model(
            Difference.of(problem),
            problem.problem.f0.astype(np.float64),
            np.where(free > 0, given, 0),
            free,
            problem.p,
            problem.coupled,
            problem.edge_norm,
        )
        host = problem.get_function(initial).astype(np.float64)
        host = np.where(free > 0, host, model.f0)
        y = np.zeros((len(model.d.start), problem.channels))
        previous = backend.empty(graph, problem.channels)
        eps = problem.eps if problem.eps or problem.p >= 2 else 0.1 * problem.problem.spread
        box = None
        if problem.box is not None:
            scale = 1.0 if problem.scale is None else problem.scale
            low, high = (
                backend.get(graph, end).astype(np.float64) / scale for end in (problem.box.low, problem.box.high)
            )
            box = low, high
        return _State(problem.put_function(host), previous, model, host, y, eps, box=box)

    def advance(self, problem: DeviceProblem, state: _State) -> _State:
        """Do one Newton step, shortened until the energy falls enough."""
        model, f, y = state.model, state.host, state.y
        p, eps, share, grouped, D = model.p, state.eps, model.share, model.grouped, model.d.matrix
        df = D @ f
        q = np.maximum(grouped(df**2) + eps**2, np.finfo(np.float64).tiny)
        g = q ** ((p - 2) / 2)
        # where df vanishes, so do the conductances of p > 2, and the matrix may be singular where lam is 0
        held_up = np.maximum(g, _FLOOR * max(float(g.max(initial=0)), _FLOOR)) if p > 2 else g
        gradient = model.free * (model.lam * (f - model.f0) + model.d.adjoint @ (share * g * df))
        size = float(np.sqrt((gradient**2).sum()))
        if size == 0:
            return replace(state, y=share * g * df)
        if p < 2:
            bent = (2 - p) * g * q ** (-p / 2)
            length = np.sqrt(grouped(y**2))
            most = share * q ** ((p - 1) / 2)
            held = y * np.where(length > most, most / np.where(length > 0, length, 1), 1)
        else:
            bent, held = share * (2 - p) * g / q, df

        def hessian(h: FloatArray) -> FloatArray:
            dh = D @ (model.free * h)
            flux: FloatArray = share * held_up * dh - bent / 2 * (held * grouped(df * dh) + df * grouped(held * dh))
            # the identity at pinned vertices
            product: FloatArray = model.lam * h + model.free * (model.d.adjoint @ flux) + (1 - model.free) * h
            return product

        cycle = state.cycle or self._preconditioner(model, share * held_up)
        h, steps, _ = multigrid.conjugate_gradients(
            hessian, -gradient, cycle, rtol=1e-3 if p == 2 else _FORCING, most=_INNER
        )
        # the squares of a gradient can underflow where the minimum is 0
        h = model.free * h if np.isfinite(h).all() else np.zeros_like(h)
        energy, slope = model.energy(f, eps), float((gradient * h).sum())
        theta, halved = 1.0, 0
        while not model.energy(f + theta * h, eps) <= energy + _DECREASE * theta * slope and halved < _HALVINGS:
            theta, halved = theta / 2, halved + 1
        if halved == _HALVINGS:  # only rounding is left
            theta = 0.0
        dh = D @ h
        # for p >= 2, y = share g df with g = q^((p-2)/2), because q^(-p/2) in q^(-p/2) g may overflow
        turned = q ** (-p / 2) * y if p < 2 else share / q * df
        y = g * (share * (df + dh) - (2 - p) * turned * grouped(df * dh))
        host = f + theta * h
        if state.box is not None:
            host = np.clip(host, *state.box)
        return replace(
            state,
            f=problem.put_function(host),
            previous=state.f,
            host=host,
            y=y,
            cycle=cycle if p == 2 else None,
            inner=state.inner + steps,
            halved=state.halved + (halved > 0),
        )

    @staticmethod
    def _preconditioner(model: _Model, c: FloatArray) -> multigrid.Preconditioner:
        """Make a V-cycle for lam + d* c d; `c`, (D, 1) or (D, m), gives one matrix for all channels or one each."""
        from scipy.sparse import csr_array, diags_array

        lam, free = model.lam[:, 0], model.free[:, 0]

        def of(c: FloatArray) -> csr_array:
            matrix = model.d.laplacian(c, lam)
            if free.all():
                return matrix
            inside = diags_array(free)
            return csr_array(inside @ matrix @ inside + diags_array(1 - free))

        cycles = [multigrid.cycle(of(c[:, k])) for k in range(c.shape[1])]
        if len(cycles) == 1:
            return cycles[0]
        return lambda r: np.concatenate([solve(r[:, k : k + 1]) for k, solve in enumerate(cycles)], axis=1)

    def certify(self, problem: DeviceProblem, state: _State, course: Course) -> tuple[_State, float]:
        """Compute the gap of f on the device and y, for p = 1 moved into the unit ball, and choose the next eps."""
        model, p = state.model, problem.p
        y = state.y
        if p == 1:
            inside = 1 - BALL_ROUNDINGS * float(np.finfo(problem.backend.dtype).eps)
            length, most = np.sqrt(model.grouped(y**2)), model.share * inside
            y = y * np.where(length > most, most / np.where(length > 0, length, 1), 1)
        gap = duality_gap(problem, state.f, model.d.on_device(problem, y), course.energies[-1])
        if problem.eps or p >= 2:
            return state, gap
        # eps adds at most eps^p / p to the energy of a vertex: choose it as a share of the gap
        return replace(state, eps=min(state.eps, (_PART * p * gap / len(model.f0)) ** (1 / p))), gap

    def next_check(self, state: _State, done: int) -> int:
        """Check after every step."""
        return done + 1

    def describe(self, state: _State) -> str:
        """Describe the method and its steps."""
        name = "Primal-dual Newton" if state.model.p < 2 else "Newton"
        by = "multigrid" if multigrid.is_there() else "the diagonal (pyamg is not installed)"
        halved = f", {state.halved} step(s) shortened" if state.halved else ""
        return f"{name} on the host, {state.inner} step(s) of conjugate gradients preconditioned by {by} in all{halved}"
