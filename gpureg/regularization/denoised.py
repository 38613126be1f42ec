"""The result of denoising a mesh, a point cloud or curves: :class:`Denoised`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..checks import integer, number
from ..model.result import Result
from .options import Model

# A number, or one for each of several shapes.
S = TypeVar("S", float, tuple[float, ...])


@dataclass(frozen=True, eq=False, kw_only=True)
class Denoised(Generic[S]):
    """The result of denoising a shape.

    Attributes
    ----------
    value : (n,) or (n, m) float array
        The denoised positions of the vertices, or the denoised values.
    filter : str
        What was regularized: "normals", "positions", "values" ...
    sigma : float, or one per curve
        Standard deviation of the noise, in the units of the coordinates or of the values: given, or estimated.
    estimated : bool
        Whether the noise was estimated.
    p : float
        Degree of regularity.
    lam : float, or one per curve, or (n,) array
        The fidelity used; an array if it was given as one.
    results : tuple of Result
        The runs of the model, in order; empty if there is no noise to remove.
    displacement : (n,) float array
        The displacement of each vertex; 0 if values were regularized.
    seconds : float
        Wall-clock time.
    """

    WHAT: ClassVar[Mapping[str, str]] = {}
    """Description of what each filter regularizes."""

    value: npt.NDArray[Any]
    filter: str
    sigma: S
    estimated: bool
    p: float
    lam: S | FloatArray
    results: tuple[Result, ...] = ()
    displacement: FloatArray = field(default_factory=lambda: np.empty(0))
    seconds: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether positions were changed, and not values."""
        return self.filter != "values"

    @property
    def iterations(self) -> int:
        """Total number of iterations of all runs."""
        return sum(result.iterations for result in self.results)

    def describe(self) -> str:
        """Describe the filter and its parameters in one line."""
        what = self.WHAT[self.filter]
        if not self.results:
            return f"{what}: there is no noise to remove"
        runs, each = len(self.results), self.results[0].iterations
        if not self.iterations:
            return f"{what}; {self._parameters()}, solved directly"
        times = f"{runs} rounds of {each}" if runs > 1 else str(each)
        return f"{what}; {self._parameters()}, {times} iterations"

    def _parameters(self) -> str:
        lam = f"{self.lam:.4g}" if isinstance(self.lam, float) else "a map"
        return f"p = {self.p:g}, lam = {lam}"


def check_numbers(
    options: Model,
    *,
    p: float | None = None,
    sigma: float | None = None,
    max_iter: int | None = None,
    max_displacement: float | None = None,
) -> None:
    """Raise TypeError or ValueError unless these settings are numbers in range, also if no run will use them."""
    if p is not None:
        number("p", p, above=0)
    if max_iter is not None:
        integer("max_iter", max_iter, low=0)
    at_least_0 = {"sigma": sigma, "max_displacement": max_displacement}
    at_least_0 |= {"eps": options.get("eps"), "tol": options.get("tol")}
    for name, value in at_least_0.items():
        if value is not None:
            number(name, value, low=0)


def checked_fidelity(lam: Any, n: int, what: str = "vertex") -> float | FloatArray:
    """Check a fidelity; return a number, or one per vertex, (n,).

    Parameters
    ----------
    lam : float or (n,) array
    n : int
        Number of vertices.
    what : str
        The word for a vertex in errors.

    Raises
    ------
    TypeError, ValueError
        Not numbers >= 0; another shape.
    """
    if np.ndim(lam) == 0:
        return number("lam", lam.item() if isinstance(lam, np.ndarray) else lam, low=0, finite=False)
    given = np.asarray(lam)
    if given.dtype.kind not in "biuf":
        raise TypeError(f"lam must be a number or one per {what}, got {given.dtype}")
    if given.shape != (n,):
        raise ValueError(f"lam must be a number or one per {what}, ({n},), got {given.shape}")
    if not (given >= 0).all():
        raise ValueError(f"lam must be >= 0 (0: no data there, infinity: pinned), got {given[~(given >= 0)][0]}")
    return given.astype(np.float64)


def limited(moves: FloatArray, most: float | FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Limit displacements (n, d) to the length `most`, a number or (n,); return them and their lengths (n,)."""
    distance = np.linalg.norm(moves, axis=1)
    if most is None:
        return moves, distance
    shorter = np.minimum(1, most / np.maximum(distance, np.finfo(float).tiny))[:, None]
    return moves * shorter, np.minimum(distance, most)
