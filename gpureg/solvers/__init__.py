"""Solvers: objects that hold settings only; one loop runs them all.

To add one: a file here with a frozen dataclass that has ``start``, ``advance`` and ``describe``, and its name in
``SOLVERS``.
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
    """A solver from its name, with default settings, or the object itself.

    Raises
    ------
    ValueError
        An unknown name.
    TypeError
        Neither a name nor a solver.
    """
    if isinstance(solver, str):
        return SOLVERS[choice("solver", solver, SOLVERS)]()
    if not isinstance(solver, Solver):
        raise TypeError(f"solver must be a name or a solver object such as gpureg.Jacobi(), got {solver!r}")
    return solver
