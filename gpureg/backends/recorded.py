"""Work on a device that is done many times with the same arrays: its launches are prepared once and then repeated.

Python takes longer to check the arguments of a kernel than a GPU takes for a small graph. A solver swaps the same two
buffers, so that each of its iterations is one of two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .data import Data

Work = Callable[..., object]
"""Calls primitives of the backend that is its first argument; its other arguments are numbers for them."""

Replay = Callable[..., None]
"""Repeats recorded launches; its arguments are the numbers of this time."""


class Parameter(float):
    """A number that can be another one each time that the recorded work is done.

    Attributes
    ----------
    at : int
        Its place among the numbers of the work.
    """

    at: int

    @classmethod
    def of(cls, value: float, at: int) -> Parameter:
        """Make the parameter with its first value."""
        made = cls(value)
        made.at = at
        return made


class Recorded:
    """Work with fixed arrays: done as it is the first time, recorded the second time, and replayed from then on.

    The record keeps its arrays alive. Only one thread may use it at a time.

    Parameters
    ----------
    backend : Backend
    work : callable
        ``work(backend, *numbers)`` calls primitives of this backend with `out`; it reads nothing back.
    """

    def __init__(self, backend: Data, work: Work) -> None:
        self._backend, self._work = backend, work
        self._done = False
        self._replay: Replay | None = None

    def __call__(self, *numbers: float) -> None:
        """Do the work, with these numbers."""
        if self._replay is not None:
            self._replay(*numbers)
        elif self._done:
            parameters = [Parameter.of(number, at) for at, number in enumerate(numbers)]
            self._replay = self._backend.record(self._work, parameters)
        else:
            self._work(self._backend, *numbers)
            self._done = True


def places(args: list[Any]) -> list[tuple[int, int]]:
    """Find the parameters among the arguments of a kernel: pairs of the argument's place and the parameter's."""
    return [(i, arg.at) for i, arg in enumerate(args) if isinstance(arg, Parameter)]


def in_turns(backend: Data, work: Work, here: Any, there: Any) -> tuple[Recorded, Recorded]:
    """Record ``work(backend, here, there, *numbers)``, and the same with its two buffers swapped."""

    def forth(backend: Data, *numbers: float) -> None:
        work(backend, here, there, *numbers)

    def back(backend: Data, *numbers: float) -> None:
        work(backend, there, here, *numbers)

    return Recorded(backend, forth), Recorded(backend, back)
