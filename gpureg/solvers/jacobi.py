"""The Gauss-Jacobi process of the paper, eq. 25 and 31."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..backends import Array
from ..problem import DeviceProblem
from .loop import Solver


@dataclass(frozen=True)
class _State:
    f: Array  # the last whole iterate
    previous: Array  # the one before it, to be overwritten by the next
    g: Array | None  # scratch for the conductances


@dataclass(frozen=True)
class Jacobi(Solver):
    """Gauss-Jacobi sweeps: each vertex takes the weighted mean of its data and its neighbours (eq. 25, 31).

    Parameters
    ----------
    damping : float, optional
        theta in (0, 1]: f + theta (J(f) - f) instead of J(f). None takes 1, the paper's process, for p <= 2, and
        1/(p - 1) for p > 2, where the plain sweep can diverge.
    check_every : int, default 10
        Sweeps between two looks at energy and change, which read back from the device.

    Raises
    ------
    TypeError, ValueError
        A damping outside (0, 1], a check_every that is no integer >= 1.

    Notes
    -----
    For 0 < p <= 2 and eps > 0 one sweep with damping 1 never raises the eps-smoothed energy.

    Examples
    --------
    >>> Jacobi(check_every=5)
    Jacobi(damping=None, check_every=5)
    """

    damping: float | None = None
    check_every: int = 10

    def __post_init__(self) -> None:
        for name, value, kinds in (
            ("damping", self.damping, (int, float, np.number)),
            ("check_every", self.check_every, (int, np.integer)),
        ):
            if value is not None and (isinstance(value, bool) or not isinstance(value, kinds)):
                raise TypeError(f"{name} must be a number, got {value!r}")
        if self.damping is not None and not 0 < self.damping <= 1:
            raise ValueError(f"damping must lie in (0, 1], got {self.damping}")
        if self.check_every < 1:
            raise ValueError(f"check_every must be >= 1, got {self.check_every}")

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """State before the first sweep."""
        graph, backend = problem.weighted.graph, problem.backend
        scratch = None if problem.p == 2 else backend.empty(graph, 1 if problem.coupled else problem.channels)
        return _State(initial, backend.empty(graph, problem.channels), scratch)

    def step(self, problem: DeviceProblem, state: _State) -> _State:
        """One sweep, into the buffer of the iterate before the last."""
        theta = self.damping
        if theta is None:
            theta = 1.0 if problem.p <= 2 else 1 / (problem.p - 1)
        problem.backend.sweep(
            problem.weighted,
            state.f,
            problem.f0,
            problem.lam,
            p=problem.p,
            eps=problem.eps,
            coupled=problem.coupled,
            theta=theta,
            g=state.g,
            out=state.previous,
        )
        return _State(state.previous, state.f, state.g)
