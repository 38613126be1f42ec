"""Solvers: objects that hold settings only; one loop runs them all.

To add one: a file here with a frozen dataclass that has ``start``, ``advance`` and ``describe``, and its name in
``SOLVERS``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .euler import Euler
from .jacobi import Jacobi
from .loop import Check, Solver, run

__all__ = ["SOLVERS", "Check", "Euler", "Jacobi", "Solver", "is_local", "resolve", "run"]

SOLVERS: dict[str, type[Solver]] = {"jacobi": Jacobi, "euler": Euler}


def is_local(solver: str | Solver, p: float, lam: Any) -> bool:
    """Whether a solver treats a part of a graph as it would inside the whole: its step does not depend on the rest."""
    method = resolve(solver)
    if isinstance(method, Jacobi):
        return method.damping is not None or p > 2 or bool(np.min(lam) > 0)
    return isinstance(method, Euler) and method.step is not None and p == 2


def resolve(solver: str | Solver) -> Solver:
    """A solver from its name, with default settings, or the object itself.

    Raises
    ------
    ValueError
        An unknown name.
    TypeError
        Neither a name nor a solver.
    """
    if isinstance(solver, str):
        if solver not in SOLVERS:
            raise ValueError(f"unknown solver {solver!r}: use {', '.join(SOLVERS)}, or a solver object")
        return SOLVERS[solver]()
    if not isinstance(solver, Solver):
        raise TypeError(f"solver must be a name or a solver object such as gpureg.Jacobi(), got {solver!r}")
    return solver
