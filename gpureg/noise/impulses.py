"""Find impulses: single pixels whose values have nothing to do with their neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
    extreme: Flags | None
    axes: tuple[int, ...]
    least: float = 0.0


def extremes(values: Array, good: Flags, low: float, high: float) -> Flags | None:
    """Return the cells with the smallest or the largest value, if they have a notable share."""
    found: Flags = ((values == low) | (values == high)) & good
    return found if np.count_nonzero(found) > _EXTREME_SHARE * found.size else None


def find_impulses(scene: Scene, sigma: float | Array) -> tuple[Flags, bool]:
    """Return the impulses, and whether they are salt and pepper.

    Parameters
    ----------
    scene : Scene
    sigma : float or (b, ...) array
        Standard deviation of the noise, or one per pixel where it grows with the signal.
    """
    found = _candidates(scene, scene.usable, sigma)
    agree = 2
    if np.count_nonzero(found) > _MANY * found.size:
        agree = 3
        found = _candidates(scene, scene.usable, sigma, agree=agree)
    if scene.extreme is not None:
        found |= _candidates(scene, scene.usable & scene.extreme, sigma, far=_FAR_EXTREME, agree=agree)
    count = np.count_nonzero(found)
    if count < _SHARE * found.size:
        return found, False
    if scene.extreme is not None and np.count_nonzero(found & scene.extreme) > _AT_EXTREMES * count:
        return found | _salt(scene, scene.extreme, sigma), True
    for _ in range(2):
        found |= _candidates(scene, scene.usable & ~found, sigma, known=found)
    return found, False


def lone_pixels(scene: Scene) -> Flags:
    """Return the pixels that differ from neighbours of which nearly all are exactly equal."""
    found = np.zeros(scene.values.shape, bool)
    at = np.flatnonzero((scene.values != scene.medians) & scene.usable)
    if at.size:
        around = scene.values.ravel()[_neighbours(scene.values, at, scene.axes, 1)]
        equal = np.count_nonzero(around == np.median(around, axis=0), axis=0)
        found.ravel()[at[equal >= _EQUAL * len(around)]] = True
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
