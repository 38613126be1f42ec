"""Solvers: objects with settings only, all run by one loop.

To add a solver, add a frozen dataclass with ``start``, ``advance`` and ``describe``, and its name in ``SOLVERS``.
"""

from __future__ import annotations

from ..checks import choice
from .certified import Certified
from .euler import Euler
from .jacobi import Jacobi
from .loop import Check, Solver, run

__all__ = ["SOLVERS", "Certified", "Check", "Euler", "Jacobi", "Solver", "resolve", "run"]

SOLVERS: dict[str, type[Solver]] = {"jacobi": Jacobi, "euler": Euler, "certified": Certified}


def resolve(solver: str | Solver) -> Solver:
    """Return the solver of this name with default settings, or the given solver; raise an error for anything else."""
    if isinstance(solver, str):
        return SOLVERS[choice("solver", solver, SOLVERS)]()
    if not isinstance(solver, Solver):
        raise TypeError(f"solver must be a name or a solver object such as gpureg.Jacobi(), got {solver!r}")
    return solver
