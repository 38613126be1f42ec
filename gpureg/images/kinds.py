"""The weights of a plan: :func:`named_weights` makes weights from a name, :func:`weights_of` chooses weights."""

from __future__ import annotations

import math

import numpy.typing as npt

from ..weights import Weights, bilateral, constant, patch
from .course import Course
from .guides import for_a_guide
from .noise import Noise
from .nonlocal_rule import NonlocalRule, nonlocal_rule
from .options import Choice
from .raster import Raster
from .window import cell_sizes

# Radius of the patches of weights="patch".
PATCH_RADIUS = 2

Reasons = dict[str, str]


def follow_from_noise(asked: Choice) -> bool:
    """Return whether weights given by name depend on the noise."""
    kind = asked["weights"]
    named = kind if isinstance(kind, str) else None
    return named == "patch" or (named == "bilateral" and asked["sigma_value"] is None)


def named_weights(asked: Choice, noise: Noise, raster: Raster) -> tuple[Weights | npt.ArrayLike | None, Reasons]:
    """Return the weights that are given, or made from a name and the noise, with reasons.

    The weights are None if they have to be chosen, or if a parameter depends on the noise and there is none.
    """
    kind = asked["weights"]
    if not isinstance(kind, str):
        return kind, {}
    if kind == "constant":
        return constant(), {}
    h, value = asked["h"], asked["sigma_value"]
    if (value if kind == "bilateral" else h) is None and noise.level == 0:
        return None, {}
    profile = noise.combined()
    of_each = 1.0 if profile is None else profile
    if kind == "bilateral":
        in_space, in_value = "given", "given"
        reach = asked["sigma_space"]
        if reach is None:
            reach, in_space = 3.0 * cell_sizes(asked["spacing"])[0], "3 of the finest pixels"
        if value is None:
            in_value = "3 sigma"
        why = {} if in_space == in_value == "given" else {"reach": f"{in_space}, {in_value}"}
        return bilateral(reach, 3 * noise.level * of_each if value is None else value), why
    radius = PATCH_RADIUS if asked["patch_radius"] is None else asked["patch_radius"]
    why = {"patch": "default"} if (radius, asked["patch_sigma"]) == (PATCH_RADIUS, None) else {}
    if h is None:
        why["h"] = "rule: 0.6 sigma sqrt(samples)"
    samples = (2 * radius + 1) ** raster.ndim if asked["patch_sigma"] is None else 1
    by_rule = 0.6 * noise.level * math.sqrt(samples * raster.channels) * of_each
    weights = patch(radius, by_rule if h is None else h, sigma=noise.level * of_each, patch_sigma=asked["patch_sigma"])
    return weights, why


def weights_of(
    asked: Choice,
    raster: Raster,
    noise: Noise,
    spread: float,
    spacing: tuple[float, ...] | None,
    course: Course,
    given: Weights | npt.ArrayLike | None,
    *,
    idle: bool,
) -> tuple[NonlocalRule, Reasons]:
    """Choose the weights and their lam and average_radius, with reasons; an `idle` plan has constant weights."""
    if given is not None:
        return NonlocalRule(given, 2.0, None), {}  # lam = 2: weight 1 for the pixel itself
    k = asked["k"]
    why = {"weights": "rule: constant for p other than 2" if course.local else "rule: nonlocal means at p = 2"}
    if k is not None:
        why["weights"] = "rule: patches, on the graph of the nearest"
    why["patch"] = why["h"] = "rule: from the noise, the contrast and the channels"
    if idle or (k is None and not course.filters):
        return NonlocalRule(constant(), 2.0, None), why
    if k is not None:
        radius = asked["patch_radius"]
        if radius is None:
            radius = 3 if raster.ndim == 2 else 1
        h = noise.level * math.sqrt(raster.channels * (2 * radius + 1) ** raster.ndim)
        return NonlocalRule(patch(radius, h, sigma=noise.level), 2.0, None), why
    rule = nonlocal_rule(
        noise.level, spread, raster.channels, raster.ndim, spacing, noise.combined(), asked["patch_radius"]
    )
    if asked["guide"] is not None:
        rule = rule._replace(weights=for_a_guide(rule.weights))
    if asked["max_iter"] not in (None, 1) or asked["tol"] is not None or course.most is not None:
        rule = rule._replace(average_radius=None)  # patches are averaged only after a single sweep on the grid
    return rule, why
