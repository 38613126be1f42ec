"""The common options of ``gpureg mesh``, ``points`` and ``curve``: :class:`ShapeSettings`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from .. import weights

# Weights by name, for any graph of points.
WEIGHTS = ("constant", "inverse-distance", "inverse-square")


@dataclass(frozen=True, kw_only=True)
class ShapeSettings:
    """The common options of the commands for shapes; None takes the default of the function that does the work."""

    MODEL: ClassVar[tuple[str, ...]] = ("p", "lam", "norm", "solver", "max_iter", "tol", "eps", "backend", "dtype")
    """Options that are passed on unchanged."""

    p: float | None = None
    lam: float | None = None
    sigma: float | None = None
    weights: str | None = None
    norm: Literal["vertex", "edge"] | None = None
    solver: Literal["jacobi", "certified"] | None = None
    max_iter: int | None = None
    tol: float | None = None
    eps: float | None = None
    backend: str = "auto"
    dtype: str | None = None
    reference: Path | None = None
    picture: Path | None = None

    def model(self, *names: str) -> dict[str, Any]:
        """Return the given options of the model and those of these names."""
        told = {name: getattr(self, name) for name in (*self.MODEL, *names) if getattr(self, name) is not None}
        if self.weights is not None:
            told["weights"] = {
                "constant": weights.constant(),
                "inverse-distance": weights.inverse_distance(1),
                "inverse-square": weights.inverse_distance(2),
            }.get(self.weights)
        return told

    def first_given(self, names: Iterable[str]) -> str | None:
        """Return the first of these options that was given, as on the command line."""
        given = (name for name in names if getattr(self, name) not in (None, False))
        return next((f"--{name.replace('_', '-')}" for name in given), None)


@dataclass(frozen=True, kw_only=True)
class ViewedSettings(ShapeSettings):
    """The common options of the commands for meshes and points, whose pictures have a view."""

    view: tuple[float, float] | Literal["auto"] = "auto"
    up: Literal["x", "y", "z"] | None = None

    def check_view(self) -> None:
        """Raise ValueError if there is a view but no picture."""
        if self.picture is None and (self.view != "auto" or self.up is not None):
            raise ValueError("--view and --up are for the picture: give --picture too")
