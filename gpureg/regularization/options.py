"""Options that the public functions share and pass on: settings of a run, and of the model."""

from __future__ import annotations

from typing import Any, Literal, TypedDict

import numpy.typing as npt

from ..backends import Chosen
from ..solvers import Solver
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


RUN: dict[str, Any] = {"backend": "auto", "dtype": None, "memory": None, "callback": None, "progress": False}
MODEL: dict[str, Any] = {"norm": "vertex", "eps": None, "solver": "jacobi", "tol": None, **RUN}
