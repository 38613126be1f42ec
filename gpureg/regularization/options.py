"""Options that doors take and hand on as one: how a run is done, and what of the model has one meaning everywhere."""

from __future__ import annotations

from typing import Any, Literal, TypedDict

import numpy.typing as npt

from ..solvers import Solver
from ..solvers.loop import Callback


class Run(TypedDict, total=False):
    """How a run is done, in every door.

    Attributes
    ----------
    backend : str, default "auto"
        "auto", "numpy", "opencl", "warp" or a device of theirs.
    dtype : dtype, default float32
        float32 or float64: the type to compute in. None takes float64 where the data hold more digits than float32.
    memory : int, optional
        Bytes that the run may take; None asks the device and GPUREG_MEMORY.
    callback : callable, optional
        Called with a :class:`gpureg.Check` at every check; True stops the run.
    progress : bool, default False
        Whether to show a bar on the terminal.
    """

    backend: str
    dtype: npt.DTypeLike | None
    memory: int | None
    callback: Callback | None
    progress: bool


class Model(Run, total=False):
    """How the model is posed and solved, and how the run is done.

    Attributes
    ----------
    norm : {"vertex", "edge"}, default "vertex"
        The smoothness of eq. 20, or of eq. 30.
    eps : float, optional
        Smoothing of the gradient norm (eq. 15); None takes 1e-3 of the data's range.
    solver : str or Solver, default "jacobi"
        "jacobi", "euler", "certified", or a solver object.
    tol : float, optional
        The solver's tolerance; None makes no test.
    """

    norm: Literal["vertex", "edge"]
    eps: float | None
    solver: str | Solver
    tol: float | None


RUN: dict[str, Any] = {"backend": "auto", "dtype": None, "memory": None, "callback": None, "progress": False}
MODEL: dict[str, Any] = {"norm": "vertex", "eps": None, "solver": "jacobi", "tol": None, **RUN}
