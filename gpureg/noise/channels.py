"""Compare the noise and the content of channels, and group those that are better denoised together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .measure import SMOOTHEST
from .measured import Fields, Measured
from .steps import Flags, along, inner, smallest

Groups = tuple[tuple[int, ...], ...]
# Channels are denoised together if their noise is correlated at most so much, their gradients agree at least so much,
# and their sigmas differ at most by this factor: then no measured case was more than 1 percent worse than alone.
_CORRELATED, _AGREE, _RATIO = 0.3, 0.5, 2.0
# Mean square of a central difference of noise smoothed by (1 4 6 4 1)/16 along one to three axes, over sigma^2: 84/1024
# times 70/256 for each other axis. A channel's gradients must be so many standard deviations above this.
_OF_SLOPE = {count: 84 / 1024 * (70 / 256) ** (count - 1) for count in (1, 2, 3)}
_CLEAR = 10.0
# Most planes that are compared.
PLANES = 4


@dataclass(frozen=True, eq=False)
class Relations:
    """How the noise and the content of m channels are related.

    Attributes
    ----------
    covariance : (m, m) float array
        Covariance of the noise, in the image's units; NaN where it is not known.
    agreement : (m, m) float array
        Cosine of the channels' gradients without noise: 1 for the same edges.
    """

    covariance: npt.NDArray[np.float64]
    agreement: npt.NDArray[np.float64]

    @property
    def correlation(self) -> npt.NDArray[np.float64]:
        """The correlation of the noise, (m, m)."""
        deviation = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        return self.covariance / deviation / deviation[:, None]


def relate(channels: Sequence[Sequence[Measured]]) -> Relations | None:
    """Compare the channels, each as its measured planes; None unless two channels of a plane were measured.

    Pairs of which a channel was never measured are NaN.
    """
    count = len(channels)
    products, agreements, weights = (np.zeros((count, count)) for _ in range(3))
    for planes in zip(*channels, strict=True):
        fields = [plane.fields for plane in planes]
        measured = [i for i, each in enumerate(fields) if each is not None]
        known = [each for each in fields if each is not None]
        if len(known) < 2 or len({each.response.shape for each in known}) > 1:
            continue
        axes = known[0].axes
        valid: Flags = np.logical_and.reduce([each.valid for each in known])
        at = np.flatnonzero(valid)
        if at.size < 400:
            continue
        texture = sum(inner(each.texture, axes).ravel()[at] / each.sigma**2 for each in known)
        chosen = at[smallest(np.asarray(texture), max(int(SMOOTHEST * at.size), 400))]
        responses = np.stack([each.response.ravel()[chosen].astype(np.float64) * each.scale for each in known])
        pairs = np.ix_(measured, measured)
        products[pairs] += responses @ responses.T / 6.0 ** len(axes)
        agreements[pairs] += _agreement(known) * chosen.size
        weights[pairs] += chosen.size
    if not weights.any():
        return None
    some = np.where(weights > 0, weights, np.nan)
    return Relations(products / some, agreements / some)


def _agreement(channels: Sequence[Fields]) -> npt.NDArray[np.float64]:
    """Return the cosine of the channels' gradients over a plane, (m, m), without noise.

    Products of two channels do not contain their independent noise; it is taken off the energy of each. A channel with
    hardly any gradient agrees with none.
    """
    axes = channels[0].axes
    # every second row is enough
    ok: Flags = inner(np.logical_and.reduce([each.usable for each in channels]), axes)[:, ::2]
    number, count = len(channels), int(np.count_nonzero(ok))
    whole = count == ok.size
    found = np.zeros((number, number))
    for axis in axes:
        others = [other for other in axes if other != axis]
        slopes = []
        for each in channels:
            ndim = each.smooth.ndim
            one, other = (inner(each.smooth[along(axis, i, (i - 2) or None, ndim)], others)[:, ::2] for i in (2, 0))
            slope = (one - other).ravel()
            slopes.append(slope if whole else slope * ok.ravel())
        table = np.stack(slopes)
        found += (table @ table.T).astype(np.float64)
    sizes = np.array([2 * each.sigma for each in channels])
    found /= sizes * sizes[:, None]
    noise = len(axes) * _OF_SLOPE[len(axes)]
    energy = np.diag(found) - noise * count
    energy = np.where(energy > _CLEAR * noise * math.sqrt(max(count, 1)), energy, np.inf)
    return np.asarray(np.where(np.eye(number, dtype=bool), 1.0, np.abs(found) / np.sqrt(energy * energy[:, None])))


def groups(relations: Relations | None, sigmas: Sequence[float], channels: int) -> Groups:
    """Return the groups of channels that are better denoised together, by indices.

    A channel joins the first group in which it fits with every channel. If nothing is known of the channels, each is
    a group by itself.
    """
    if channels == 1 or relations is None:
        return tuple((i,) for i in range(channels))
    found: list[list[int]] = []
    correlation = np.abs(relations.correlation)
    for i in range(channels):
        for group in found:
            if all(
                correlation[i, j] <= _CORRELATED
                and relations.agreement[i, j] >= _AGREE
                and max(sigmas[i], sigmas[j]) <= _RATIO * min(sigmas[i], sigmas[j])
                for j in group
            ):
                group.append(i)
                break
        else:
            found.append([i])
    return tuple(tuple(group) for group in found)
