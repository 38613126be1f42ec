"""Options that the public functions of regions have in common."""

from __future__ import annotations

from typing import Any, Literal

import numpy.typing as npt

from ..regularization.options import MODEL, Model
from ..weights import Weights

WeightKind = Literal["similarity", "constant", "border"]
WEIGHTS: tuple[WeightKind, ...] = ("similarity", "constant", "border")


class RegionModel(Model, total=False):
    """Options for the regularization of the values of regions on their graph.

    Attributes
    ----------
    p : float, default 2
        Degree of regularity > 0.
    weights : {"similarity", "constant", "border"}, Weights, or array with one value per stored directed edge
        The default is "similarity".
    h : float, optional
        Parameter of "similarity".
    by_size : bool, default False
        Whether lam is proportional to the size of a region.
    max_iter : int, default 30
        Maximum number of iterations.
    gamma, coupled
        As in :func:`gpureg.regularize`.
    """

    p: float
    weights: WeightKind | Weights | npt.ArrayLike
    h: float | None
    by_size: bool
    max_iter: int | None
    gamma: str | npt.ArrayLike
    coupled: bool


REGION_MODEL: dict[str, Any] = {
    "p": 2.0,
    "weights": "similarity",
    "h": None,
    "by_size": False,
    "max_iter": 30,
    "gamma": "sqrt",
    "coupled": True,
    **MODEL,
}
