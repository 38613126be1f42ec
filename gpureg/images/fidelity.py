"""The fidelity and the number of iterations of a plan: :func:`fidelity_of`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..tuning.fidelity import lam_rule
from .course import Course
from .noise import Noise
from .options import Choice
from .raster import Raster

# lam of the rule for the edge norm, as a share of lam for the vertex norm: the best value on the camera image at sigma
# 20 and p = 1. On three photographs the best values were 0.5 to 0.7.
_EDGE_NORM = 0.7


@dataclass(frozen=True)
class Fidelity:
    """The fidelity, and when the iterations stop.

    Attributes
    ----------
    lam : float or array of the image's pixels
    max_iter : int
        Maximum number of iterations.
    tol : float or None
    start : float
        First value of a search for lam.
    """

    lam: float | npt.ArrayLike
    max_iter: int
    tol: float | None
    start: float


def fidelity_of(
    asked: Choice,
    raster: Raster,
    noise: Noise,
    course: Course,
    of_weights: float,
    *,
    idle: bool,
    units: tuple[float, ...] | None = None,
) -> tuple[Fidelity, dict[str, str]]:
    """Choose the fidelity, with reasons; `of_weights` is the lam of a filter, and an `idle` plan does nothing.

    Raises
    ------
    ValueError
        lam depends on the noise, and there is none.
    """
    why: dict[str, str] = {}
    lam = None if course.search is not None else asked["lam"]
    plain = asked["p"] in (None, 2)
    if asked["p"] is None:
        why["p"] = "default"
    if lam is None:
        why["lam"] = "rule: how much a pixel itself counts" if course.filters else "rule: from the noise"
    if lam is None and course.local:
        why["lam"] = "rule: from the noise and the size of the gradient"
    if asked["max_iter"] is None:
        why["iterations"] = "rule: at p = 2 more only blur" if plain else "rule"
    if asked["max_iter"] is None and course.filters:
        why["iterations"] = "rule: a filter is one sweep"
    tol, start, default = asked["tol"], 0.0, 1
    if idle:
        return Fidelity(math.inf, 0, tol, start), why
    if lam is None and noise.level == 0 and (course.search is not None or not course.filters):
        raise ValueError("without noise there is nothing to choose lam from: give lam a number")
    if course.filters:
        start = of_weights
    else:
        degree = 2.0 if asked["p"] is None else asked["p"]
        if lam is None and asked["k"] is not None:
            start = 3.1 * noise.level ** (degree - 2)
        elif lam is None:
            values = raster.values
            if units is not None:
                values = np.moveaxis(raster.cells / np.asarray(units), -1, raster.channel_axis or 0)
            start = lam_rule(
                values,
                noise.level,
                degree,
                channel_axis=raster.channel_axis,
                mask=raster.inside,
                local=course.local,
            )
        # at p = 2 further sweeps only blur
        default = 3 if degree == 2 else 200 if asked["k"] is None else 4
        if tol is None and asked["max_iter"] is None and degree != 2 and course.most is None:
            tol, why["tol"] = 1e-4, "rule"
    if course.most is not None:
        default = course.most
    chosen: float | npt.ArrayLike = start if lam is None else lam
    if lam is None and not course.filters:
        if asked["norm"] == "edge":
            chosen = float(np.asarray(chosen)) * _EDGE_NORM
            why["lam"] += f", {_EDGE_NORM} of it: edge norm"
        profile = noise.combined()
        if profile is not None:
            # the weight of a datum is the inverse of its variance
            chosen = np.asarray(chosen, np.float64) / profile.reshape(raster.shape) ** 2
    return Fidelity(chosen, default if asked["max_iter"] is None else asked["max_iter"], tol, start), why
