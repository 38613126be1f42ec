"""Options that the public functions share and pass on: settings of a run, and of the model."""

from __future__ import annotations

from typing import Any, Literal, TypedDict

import numpy.typing as npt

from ..backends import Chosen
from ..solvers import Certified, Solver, resolve
from ..solvers.loop import Callback


class Run(TypedDict, total=False):
    """Settings of a run, in every public function.

    Attributes
    ----------
    backend : str or sequence of str, default "auto"
        "auto", "numpy", "opencl", "warp", one of their devices, "all" or several devices: those share the tiles of a
        job on a grid. Other work, such as passes on groups of patches, is done on the first one.
    dtype : dtype, optional
        Type to compute in, float32 or float64. None: float32, but float64 for images of integers of more than 16 bits.
    memory : int, optional
        Bytes that the run may use. None: set by the device and GPUREG_MEMORY.
    callback : callable, optional
        Called with a :class:`gpureg.Check` at every check; True stops the run.
    progress : bool, default False
        Whether to show a progress bar on the terminal.
    """

    backend: Chosen
    dtype: npt.DTypeLike | None
    memory: int | None
    callback: Callback | None
    progress: bool


class Model(Run, total=False):
    """Settings of the model, the solver and the run.

    Attributes
    ----------
    norm : {"vertex", "edge"}, default "vertex"
        The smoothness of eq. 20, or of eq. 30.
    eps : float, optional
        Smoothing of the gradient norm (eq. 15). None: 1e-3 of the data's spread.
    solver : str or Solver, default "jacobi"
        "jacobi", "euler", "certified", or a solver object.
    tol : float, optional
        Tolerance of the solver. None: the solver's own, if it has one.
    """

    norm: Literal["vertex", "edge"]
    eps: float | None
    solver: str | Solver
    tol: float | None


class Fill(Run, total=False):
    """Settings of functions that find unknown values.

    Attributes
    ----------
    norm : {"vertex", "edge"}
        The smoothness of eq. 20, or of eq. 30.
    eps : float, optional
        Smoothing of the gradient norm (eq. 15). None: as in :func:`gpureg.regularize`.
    solver : str or Solver, optional
        None: "certified" for p >= 1 and weights that stay, otherwise "jacobi".
    tol : float, optional
        Tolerance of the solver. None: the function's own for this solver.
    """

    norm: Literal["vertex", "edge"]
    eps: float | None
    solver: str | Solver | None
    tol: float | None


RUN: dict[str, Any] = {"backend": "auto", "dtype": None, "memory": None, "callback": None, "progress": False}
MODEL: dict[str, Any] = {"norm": "vertex", "eps": None, "solver": "jacobi", "tol": None, **RUN}
FILL: dict[str, Any] = MODEL | {"solver": None}

# The share of the energy that the gap falls to at p = 2, where a digit costs a few steps: an error of some 1e-5 of the
# spread, or the rounding of float32.
TOL_LINEAR = 1e-10


def solver_of(
    asked: dict[str, Any], p: float, max_iter: int | None, *, sweeps: int, tol: float, renewed: bool = False
) -> tuple[Solver, int | None, float | None]:
    """Return the solver of a function that finds unknown values, its max_iter and its tol; None is the solver's own.

    `asked` has its "solver" and "tol". The default solver is Certified where it can be used: for p >= 1 and weights
    that are not `renewed`. Others do up to `sweeps` iterations to the tolerance `tol` by default.
    """
    named = asked["solver"]
    if named is None:
        named = "certified" if p >= 1 and not renewed else "jacobi"
    solver = resolve(named)
    if isinstance(solver, Certified):
        own = TOL_LINEAR if p == 2 and isinstance(named, str) else None
        return solver, max_iter, own if asked["tol"] is None else asked["tol"]
    return solver, sweeps if max_iter is None else max_iter, tol if asked["tol"] is None else asked["tol"]
