"""The options of ``gpureg simplify``: :class:`Simplification`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ..graphs.edges import Metric
from ..model.problem import Norm
from ..regions.options import WeightKind
from ..regions.simplify import SourceKind
from ..regions.values import Model
from ..weights import Weights, bilateral

Kind = WeightKind | Literal["bilateral"]


@dataclass(frozen=True)
class Simplification:
    """The options of ``gpureg simplify``, without IN and OUT."""

    sources: SourceKind | int = "extrema"
    markers: Path | None = None
    smooth: float | None = None
    metric: Metric = "cityblock"
    compactness: float = 0.0
    model: Model = "mean"
    p: float = 2.0
    lam: float = 0.05
    weights: Kind = "similarity"
    h: float | None = None
    sigma_space: float | None = None
    sigma_value: float | None = None
    norm: Norm = "vertex"
    rings: int = 1
    by_size: bool = False
    solver: Literal["jacobi", "certified"] = "jacobi"
    max_iter: int = 30
    tol: float | None = None
    eps: float | None = None
    merge_tol: float | None = None
    backend: str = "auto"
    dtype: str | None = None
    axes: str | None = None
    each: tuple[str, ...] = ()
    spacing: tuple[float, ...] | Literal["file"] | None = None
    mask: Path | None = None
    labels: Path | None = None
    random_colours: Path | None = None
    fine: Path | None = None

    def model_of_regions(self) -> dict[str, Any]:
        """Return the options of the model for :func:`gpureg.simplify_image`.

        Raises
        ------
        ValueError
            Bilateral weights without their scales.
        """
        kind: Kind | Weights = self.weights
        if self.weights == "bilateral":
            if self.sigma_space is None or self.sigma_value is None:
                raise ValueError(
                    "--weights bilateral needs --sigma-space, in pixels or units of --spacing, and --sigma-value, in "
                    "pixel values"
                )
            kind = bilateral(self.sigma_space, self.sigma_value)
        names = (
            *("smooth", "metric", "compactness", "model", "p", "lam", "h", "norm", "rings", "by_size"),
            *("solver", "max_iter", "tol", "eps", "backend", "dtype"),
        )
        return {"weights": kind} | {name: getattr(self, name) for name in names}

    def outputs(self, target: Path) -> dict[str, Path]:
        """Return the files to write, by their option."""
        files = {"OUT": target, "--labels": self.labels, "--random-colours": self.random_colours, "--fine": self.fine}
        return {option: path for option, path in files.items() if path is not None}
