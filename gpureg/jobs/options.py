"""What ``gpureg mesh``, ``points`` and ``curve`` are told in common: :class:`ShapeSettings`."""

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
    """The options that the commands for shapes have in common; None leaves it to the function that does the work."""

    MODEL: ClassVar[tuple[str, ...]] = ("p", "lam", "norm", "solver", "max_iter", "tol", "eps", "backend", "dtype")
    """Options that are handed on as they are."""

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
        """The options of the model, and those of these names, that were given."""
        told = {name: getattr(self, name) for name in (*self.MODEL, *names) if getattr(self, name) is not None}
        if self.weights is not None:
            told["weights"] = {
                "constant": weights.constant(),
                "inverse-distance": weights.inverse_distance(1),
                "inverse-square": weights.inverse_distance(2),
            }.get(self.weights)
        return told

    def first_given(self, names: Iterable[str]) -> str | None:
        """The first of these options that was given, as it is written on the command line."""
        given = (name for name in names if getattr(self, name) not in (None, False))
        return next((f"--{name.replace('_', '-')}" for name in given), None)


@dataclass(frozen=True, kw_only=True)
class ViewedSettings(ShapeSettings):
    """Those of shapes in space, whose pictures are seen from somewhere."""

    view: tuple[float, float] | Literal["auto"] = "auto"
    up: Literal["x", "y", "z"] | None = None

    def check_view(self) -> None:
        """ValueError where a picture is to be turned that is not drawn."""
        if self.picture is None and (self.view != "auto" or self.up is not None):
            raise ValueError("--view and --up turn the picture: give --picture too")
