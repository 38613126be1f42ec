"""The result of a run, :class:`Result`, and why it ended, :class:`Stop`."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from .problem import Problem


class Stop(enum.Enum):
    """Why a run ended; the value of each member is a sentence for the user."""

    MAX_ITER = "All the iterations asked for were done."
    TOLERANCE = "The largest change in one iteration fell to the tolerance."
    ERROR = "The estimated distance still to go fell to the tolerance."
    GRADIENT = "The norm of the energy's gradient fell to the tolerance."
    ENERGY = "The decrease of the energy in one iteration fell to the tolerance."
    ROUNDING = "The changes fell to the rounding of the floating-point type before the error fell to the tolerance."
    GAP = "The duality gap fell to the tolerance."
    GAP_NO_DATA = "The duality gap fell to the tolerance. Components without data are set to a constant, see `method`."
    BALANCED = "The steepest slopes up and down are equal at each vertex, to the tolerance (p = infinity)."
    BALANCED_NO_DATA = (
        "The steepest slopes up and down are equal at each vertex, to the tolerance (p = infinity). Components without "
        "data are set to a constant, see `method`."
    )
    PRECISION = "The duality gap falls no further: the floating-point type allows no smaller one."
    CALLBACK = "The callback asked to stop."
    INTERRUPTED = "The run was interrupted; the value is the last whole iterate."

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, eq=False)
class Result:
    """The result of a regularization.

    Attributes
    ----------
    value : array
        The regularized function, in the shape of the data, of their library and on their device.
    iterations : int
        Complete iterations done.
    stop : Stop
        Why it ended; ``str(result.stop)`` is a sentence.
    energy : (c,) float array
        The eps-smoothed energy (eq. 19, 20 with eq. 15) at the start and at each check.
    checks : (c,) int array
        The iterations at which `energy` was computed.
    gap : float or None
        Bound on the energy minus its minimum, the rounding of the energy and of the data included; None unless the
        solver computes one. By this rounding it can be above the tolerance at which the run ended.
    error_bound : float or None
        A bound on the Euclidean distance over all values from the minimiser, in the data's units: sqrt(2 gap / min lam)
        if lam > 0 everywhere. None without a gap, or where no bound is known.
    eps : float
        The smoothing of the gradient norm that was used (eq. 15), in the data's units; with coupled=False the largest
        of all channels.
    method : str
        Description of the iterations, as a sentence: the process, and its damping or step.
    backend : str
        The device used, with its name for `backend` and its description; or the devices, and a note if they may round
        differently.
    seconds : float
        Wall-clock time of the run, weights and transfers included.
    error_bound_note : str
        How `error_bound` was found, or why there is none, as a sentence; empty without a gap.
    problem : object or None
        What was solved, for :func:`gpureg.derivatives`: the graph, and the data on the host, with which a result can be
        three times as large as its value; with coupled=False one per channel. None where the value is not that of a
        single minimisation.
    """

    value: npt.NDArray[Any]
    iterations: int
    stop: Stop
    energy: npt.NDArray[np.float64]
    checks: npt.NDArray[np.int64]
    gap: float | None
    error_bound: float | None
    eps: float
    method: str
    backend: str
    seconds: float
    error_bound_note: str = ""
    problem: Problem | tuple[Problem, ...] | None = field(default=None, repr=False, compare=False)

    # as an array of the data's library
    _exchanged: ClassVar[tuple[str, ...]] = ("value",)

    @classmethod
    def bare(
        cls,
        value: npt.NDArray[Any],
        *,
        iterations: int,
        stop: Stop,
        eps: float,
        method: str,
        backend: str,
        seconds: float,
        problem: Problem | None = None,
    ) -> Result:
        """Make a result without energies and gap."""
        return cls(
            value=value,
            iterations=iterations,
            stop=stop,
            energy=np.empty(0),
            checks=np.empty(0, np.int64),
            gap=None,
            error_bound=None,
            eps=eps,
            method=method,
            backend=backend,
            seconds=seconds,
            problem=problem,
        )

    @property
    def lower_bound(self) -> float | None:
        """Lower bound on the energy of all functions; None without a gap."""
        return None if self.gap is None else float(self.energy[-1]) - self.gap


class Interrupted(KeyboardInterrupt):
    """A KeyboardInterrupt during a run; ``result`` has the last complete iterate."""

    def __init__(self, result: Result) -> None:
        super().__init__(str(Stop.INTERRUPTED))
        self.result = result
