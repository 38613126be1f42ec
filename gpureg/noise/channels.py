"""Compare the noise and the content of channels, and group those that are better denoised together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .measure import SMOOTHEST, Measured
from .steps import Array, Flags, inner, smallest

Groups = tuple[tuple[int, ...], ...]
# Channels are denoised together if their noise is correlated at most so much, their gradients agree at least so much,
# and their sigmas differ at most by this factor: then no measured case was more than 1 percent worse than alone.
_CORRELATED, _AGREE, _RATIO = 0.3, 0.6, 2.0
# Energy of the gradient of smoothed noise, over sigma^2; three times its mean, so that noise does not agree.
_OF_NOISE = 0.144
# Most planes that are compared.
PLANES = 4


@dataclass(frozen=True, eq=False)
class Relations:
    """How the noise and the content of m channels are related.

    Attributes
    ----------
    covariance : (m, m) float array
        Covariance of the noise, in the image's units.
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
    """Compare the channels, each as its measured planes; None unless all channels of a plane were measured."""
    count = len(channels)
    products, agreements, weight = np.zeros((count, count)), np.zeros((count, count)), 0
    for planes in zip(*channels, strict=True):
        fields = [plane.fields for plane in planes]
        known = [each for each in fields if each is not None]
        if len(known) < count or len({each.response.shape for each in known}) > 1:
            continue
        axes = known[0].axes
        valid: Flags = np.logical_and.reduce([each.valid for each in known])
        at = np.flatnonzero(valid)
        if at.size < 400:
            continue
        texture = sum(inner(each.texture, axes).ravel()[at] / each.sigma**2 for each in known)
        chosen = at[smallest(np.asarray(texture), max(int(SMOOTHEST * at.size), 400))]
        responses = np.stack([each.response.ravel()[chosen].astype(np.float64) * each.scale for each in known])
        products += responses @ responses.T / 6.0 ** len(axes)
        seen = [_seen(each.gradient, each.usable, each.sigma) for each in known]
        energy = np.array([float(each.sum(dtype=np.float64)) for each in seen])
        for i in range(count):
            for j in range(i):
                common = float(np.sqrt(seen[i] * seen[j]).sum(dtype=np.float64))
                agreements[i, j] += common / max(float(np.sqrt(energy[i] * energy[j])), 1e-30) * chosen.size
        weight += chosen.size
    if not weight:
        return None
    agreements = (agreements + agreements.T) / weight + np.eye(count)
    return Relations(products / weight, agreements)


def _seen(gradient: Array, usable: Flags, sigma: float) -> Array:
    """Return the energy of the gradient above that of noise, where the pixels count."""
    found: Array = np.maximum(gradient - np.float32(_OF_NOISE * sigma**2), 0) * usable
    return found


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
