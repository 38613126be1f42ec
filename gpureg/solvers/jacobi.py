"""The Gauss-Jacobi process of the paper, eq. 25 and 31."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..backends import Array
from ..problem import DeviceProblem
from .loop import Solver, check_settings

# A sweep that still raises the energy after so many halvings is left out: what is left is rounding.
_HALVINGS = 30


@dataclass(frozen=True)
class _State:
    f: Array  # the last whole iterate
    previous: Array  # the one before it, to be overwritten by the next
    g: Array | None  # scratch for the conductances
    theta: float
    why: str  # what theta is there for, "" where it is 1
    energy: float | None  # of f, where a sweep that raises it is taken back
    halved: int = 0  # how often that was


@dataclass(frozen=True)
class Jacobi(Solver):
    """Gauss-Jacobi sweeps: each vertex takes the weighted mean of its data and its neighbours (eq. 25, 31).

    Parameters
    ----------
    damping : float, optional
        theta in (0, 1]: f + theta (J(f) - f) instead of J(f). None takes 1, the paper's process, but 1/(p - 1) for
        p > 2, where the plain sweep can diverge, halved in a sweep that would raise the energy, and 1/2 where lam = 0
        on a bipartite part of the graph (such as the 4-adjacency graph), on which the plain sweep can swing between two
        states for ever. ``Result.method`` says which; ``damping=1`` is the plain sweep in all cases.
    check_every : int, default 10
        Sweeps between two looks at energy and change, which read back from the device.

    Raises
    ------
    TypeError, ValueError
        A damping outside (0, 1], a check_every that is no integer >= 1.

    Notes
    -----
    For 0 < p <= 2 and eps > 0 one sweep with damping 1 never raises the eps-smoothed energy. For p > 2 the damping
    1/(p - 1) is enough near the minimiser but not everywhere, so that by default every sweep's energy is looked at, at
    the price of one more pass over the edges.

    Examples
    --------
    >>> Jacobi(check_every=5)
    Jacobi(damping=None, check_every=5)
    """

    damping: float | None = None
    check_every: int = 10

    def __post_init__(self) -> None:
        check_settings({"damping": self.damping, "check_every": self.check_every})
        if self.damping is not None and not 0 < self.damping <= 1:
            raise ValueError(f"damping must lie in (0, 1], got {self.damping}")

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """State before the first sweep."""
        theta, why = self.damping, "as asked for"
        if theta is None and problem.p > 2:
            theta, why = 1 / (problem.p - 1), "1/(p - 1): beyond p = 2 the plain sweep can diverge"
        elif theta is None and problem.swings():
            theta, why = 0.5, "lazy: with lam = 0 on a bipartite part the plain sweep can swing between two states"
        elif theta is None:
            theta = 1.0
        empty = problem.backend.empty(problem.weighted.graph, problem.channels)
        energy = problem.energy(initial) if self.damping is None and problem.p > 2 else None
        return _State(initial, empty, problem.scratch(), theta, "" if theta == 1 else why, energy)

    def advance(self, problem: DeviceProblem, state: _State) -> _State:
        """One sweep, into the buffer of the iterate before the last."""
        self._sweep(problem, state, state.theta)
        energy, halved = state.energy, 0
        if state.energy is not None:
            # J(f) - f is a direction of descent: a short enough step lowers the energy, if by more than its rounding.
            allowed = state.energy * (1 + 8 * float(np.finfo(problem.backend.dtype).eps))
            energy = problem.energy(state.previous)
            while not energy <= allowed and halved < _HALVINGS:
                halved += 1
                self._sweep(problem, state, state.theta / 2**halved if halved < _HALVINGS else 0.0)
                energy = problem.energy(state.previous)
        return replace(state, f=state.previous, previous=state.f, energy=energy, halved=state.halved + (halved > 0))

    @staticmethod
    def _sweep(problem: DeviceProblem, state: _State, theta: float) -> None:
        problem.backend.sweep(
            problem.weighted,
            state.f,
            problem.f0,
            problem.lam,
            p=problem.p,
            eps=problem.eps,
            coupled=problem.coupled,
            theta=theta,
            edge_norm=problem.edge_norm,
            g=state.g,
            out=state.previous,
        )

    def describe(self, state: _State) -> str:
        """The process, and its damping."""
        damped = f", damped by theta = {state.theta:.6g} ({state.why})" if state.why else ""
        shortened = f", {state.halved} sweep(s) shortened so as not to raise the energy" if state.halved else ""
        return f"Gauss-Jacobi (eq. 25){damped}{shortened}"
