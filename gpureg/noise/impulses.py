"""Find impulses: single pixels whose values have nothing to do with their neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from .steps import Array, Flags

# A pixel is an impulse if it differs from the median of its neighbourhood and from all but 2 of its neighbours by more
# than _FAR sigma, and from the median by more than _SCATTER times the scatter of the neighbours. Where more than _MANY
# are impulses, 3 neighbours may be impulses too. For pixels at the extremes of the range _FAR_EXTREME is enough.
_FAR, _FAR_EXTREME, _SCATTER, _MANY = 5.0, 3.5, 3.5, 0.03
# More than this share of impulses is looked at closer. If most of them lie at the extremes of the range they are salt
# and pepper: an extreme pixel is one if it is further than _FAR_SALT sigma from the others in its window of 5.
_SHARE, _AT_EXTREMES, _FAR_SALT, _WINDOW = 0.01, 0.7, 2.5, 2
# Share of the neighbours of a lone pixel that are equal.
_EQUAL = 0.7
# Extreme pixels are looked at if they have more than this share.
_EXTREME_SHARE = 0.005


@dataclass(frozen=True)
class ImpulseRule:
    """How the impulses of a channel are found: all that the whole image decides, so that a part of it gives the same.

    Attributes
    ----------
    sigma : float
        Standard deviation of the noise, in the image's units; 0 for single pixels in areas of equal values.
    line : (slope, level) or None
        The variance slope * value + level of noise that grows with the signal.
    offset, scale : float
        The values are compared minus `offset` and over `scale`.
    low, high : float
        The smallest and the largest value of the image.
    whole, counts : bool
        Whether the values are whole numbers, and counts of which many are 0.
    side : int
        Side of areas of equal values, in which nothing is an impulse.
    often : tuple of float
        Values that may have been put there: the ends of whole numbers, values that many numbers have.
    agree : int
        Number of neighbours that may be as far as the impulse.
    extreme, salt : bool
        Whether pixels with these values are looked at closer, and whether the impulses are salt and pepper.
    again : bool
        Whether there are so many that impulses are looked for without those that are known.
    """

    sigma: float
    line: tuple[float, float] | None
    offset: float
    scale: float
    low: float
    high: float
    whole: bool
    counts: bool
    side: int
    often: tuple[float, ...] = ()
    agree: int = 2
    extreme: bool = False
    salt: bool = False
    again: bool = False


# Pixels around a part of an image from which its impulses follow, and are replaced, to the bit.
REACH = 24


@dataclass(frozen=True, eq=False)
class Scene:
    """What is needed to find the impulses of a block.

    Attributes
    ----------
    values : (b, ...) float array
        The values; where they are missing, anything that does not stand out.
    medians : (b, ...) float array
        The medians of the neighbourhoods.
    usable : (b, ...) bool array
        True at the pixels that may be impulses.
    extreme : (b, ...) bool array or None
        True at the smallest and the largest value, if the values are whole numbers and these have a notable share.
    axes : tuple of int
        The last one or two axes, along which neighbours are compared.
    least : float
        Smallest distance of an impulse from its neighbours.
    """

    values: Array
    medians: Array
    usable: Flags
    extreme: Flags
    axes: tuple[int, ...]
    least: float = 0.0


def rule_for(scene: Scene, rule: ImpulseRule, sigma: float | Array) -> tuple[ImpulseRule, Flags]:
    """Return how the impulses of an image are found, and the impulses.

    Parameters
    ----------
    scene : Scene
    rule : ImpulseRule
        What is known of the image.
    sigma : float or (b, ...) array
        Standard deviation of the noise over ``rule.scale``, or one per pixel where it grows with the signal.
    """
    size = scene.values.size
    extreme = bool(rule.often) and bool(np.count_nonzero(scene.extreme) > _EXTREME_SHARE * size)
    found = _candidates(scene, scene.usable, sigma)
    agree = 2
    if np.count_nonzero(found) > _MANY * size:
        agree = 3
        found = _candidates(scene, scene.usable, sigma, agree=agree)
    if extreme:
        found |= _candidates(scene, scene.usable & scene.extreme, sigma, far=_FAR_EXTREME, agree=agree)
    count = np.count_nonzero(found)
    many = bool(count >= _SHARE * size)
    salt = many and extreme and bool(np.count_nonzero(found & scene.extreme) > _AT_EXTREMES * count)
    rule = replace(rule, agree=agree, extreme=extreme, salt=salt, again=many and not salt)
    return rule, _completed(scene, rule, found, sigma)


def impulses_by(scene: Scene, rule: ImpulseRule, sigma: float | Array) -> Flags:
    """Return the impulses by a rule; `sigma` as in :func:`rule_for`."""
    if rule.sigma == 0:
        return lone_pixels(scene)
    found = _candidates(scene, scene.usable, sigma, agree=rule.agree)
    if rule.extreme:
        found |= _candidates(scene, scene.usable & scene.extreme, sigma, far=_FAR_EXTREME, agree=rule.agree)
    return _completed(scene, rule, found, sigma)


def _completed(scene: Scene, rule: ImpulseRule, found: Flags, sigma: float | Array) -> Flags:
    """Return the impulses with those that are seen when the first ones are known."""
    if rule.salt:
        return found | _salt(scene, scene.extreme, sigma)
    for _ in range(2 if rule.again else 0):
        found = found | _candidates(scene, scene.usable & ~found, sigma, known=found)
    return found


def lone_pixels(scene: Scene) -> Flags:
    """Return the pixels that differ from neighbours of which nearly all are exactly equal."""
    found = np.zeros(scene.values.shape, bool)
    for _ in range(3):  # neighbours that are lone pixels do not count
        at = np.flatnonzero(scene.usable & ~found)
        if at.size:
            near = _neighbours(scene.values, at, scene.axes, 1)
            around = np.where(found.ravel()[near], np.nan, scene.values.ravel()[near])
            median = _median_of_known(around)
            equal = np.count_nonzero(around == median, axis=0)
            many = equal >= np.maximum(_EQUAL * np.count_nonzero(~np.isnan(around), axis=0), 3)
            found.ravel()[at[many & (scene.values.ravel()[at] != median)]] = True
    return found


def _neighbours(values: Array, at: npt.NDArray[np.intp], axes: Sequence[int], radius: int) -> npt.NDArray[np.intp]:
    """Return the flat indices of the neighbours of cells, (k, n), reflected at the border without the edge."""
    places = np.unravel_index(at, values.shape)
    steps = np.stack(np.meshgrid(*[np.arange(-radius, radius + 1)] * len(axes), indexing="ij"), -1)
    found = []
    for step in steps.reshape(-1, len(axes)):
        if not step.any():
            continue
        moved = list(places)
        for axis, by in zip(axes, step, strict=True):
            size = values.shape[axis]
            place = np.abs(places[axis] + by)
            moved[axis] = np.clip(np.where(place >= size, 2 * size - 2 - place, place), 0, size - 1)
        found.append(np.ravel_multi_index(tuple(moved), values.shape))
    return np.array(found)


def _median_of_known(values: Array) -> Array:
    """Return the median over the first axis without NaN, and NaN where nothing is known, (n,)."""
    ordered = np.sort(values, axis=0)
    count = np.count_nonzero(~np.isnan(values), axis=0)
    columns = np.arange(values.shape[1])
    low, high = (ordered[np.maximum(place, 0), columns] for place in ((count - 1) // 2, count // 2))
    return np.where(count > 0, 0.5 * (low + np.where(count % 2 == 1, low, high)), np.nan)


def _candidates(
    scene: Scene, where: Flags, sigma: float | Array, *, far: float = _FAR, agree: int = 2, known: Flags | None = None
) -> Flags:
    """Return the impulses among the pixels of `where`; neighbours that are `known` impulses do not count."""
    values, medians = scene.values, scene.medians
    found = np.zeros(values.shape, bool)
    at = np.flatnonzero((np.abs(values - medians) > far * sigma) & where)
    if not at.size:
        return found
    bound = np.maximum(far * (sigma if np.ndim(sigma) == 0 else np.asarray(sigma).ravel()[at]), scene.least)
    near = _neighbours(values, at, scene.axes, 1)
    around, own, middle = values.ravel()[near], values.ravel()[at], medians.ravel()[at]
    if known is None:
        steps = np.abs(around - own)
        scatter = np.median(np.abs(around - middle), axis=0)
    else:
        around = np.where(known.ravel()[near], np.nan, around)
        steps = np.where(np.isnan(around), np.inf, np.abs(around - own))
        of_known = _median_of_known(around)
        middle = np.where(np.isnan(of_known), middle, of_known)
        scatter = np.nan_to_num(_median_of_known(np.abs(around - middle)))
    if len(near) != 8:
        agree = 1
    steps.sort(axis=0)
    stands_out = np.abs(own - middle) > np.maximum(bound, _SCATTER * scatter)
    found.ravel()[at[(steps[agree] > bound) & stands_out]] = True
    return found


def _salt(scene: Scene, extreme: Flags, sigma: float | Array) -> Flags:
    """Return the extreme pixels that are far from the pixels around them that are not extreme."""
    at = np.flatnonzero(extreme)
    near = _neighbours(scene.values, at, scene.axes, _WINDOW)
    around = np.where(extreme.ravel()[near], np.nan, scene.values.ravel()[near])
    median = _median_of_known(around)
    enough = np.count_nonzero(~np.isnan(around), axis=0) >= len(near) // 2
    bound = np.maximum(_FAR_SALT * (sigma if np.ndim(sigma) == 0 else np.asarray(sigma).ravel()[at]), scene.least)
    with np.errstate(invalid="ignore"):
        far = np.abs(median - scene.values.ravel()[at]) > bound
    found = np.zeros(scene.values.shape, bool)
    found.ravel()[at[far & enough]] = True
    return found


def filled(values: Array, impulses: Flags, axes: tuple[int, ...], inside: Flags | None = None) -> Array:
    """Return the values with each impulse replaced by the median of the pixels around it that are none.

    Parameters
    ----------
    values : array
    impulses : bool array of its shape
    axes : tuple of int
        The one or two axes along which neighbours are taken: 3 along each, and 5 if all of these are impulses.
    inside : bool array of its shape, optional
        True at the pixels that count.
    """
    unknown = impulses if inside is None else impulses | ~inside
    result = values.copy()
    at = np.flatnonzero(impulses)
    for radius in (1, 2, 4):
        if not at.size:
            break
        near = _neighbours(values, at, axes, radius)
        median = _median_of_known(np.where(unknown.ravel()[near], np.nan, values.ravel()[near]))
        told = ~np.isnan(median)
        result.ravel()[at[told]] = median[told].astype(result.dtype)
        at = at[~told]
    return result
