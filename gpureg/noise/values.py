"""Measure the noise of values on the vertices of a graph: :func:`value_noise`, :func:`alike_channels`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.components import Components
from ..graphs.csr import Graph
from .local import local_noise, settled, without_impulses

# Channels are regularized together if their noise differs by at most this factor; measured, the coupling of colours
# still helps the channel with less noise then.
_ALIKE = 2.0


class ValueNoise(NamedTuple):
    """The noise of values (n, m).

    Attributes
    ----------
    local : (n,) float array
        Standard deviation around each vertex, the root mean square over the channels; NaN where it cannot be told.
    smooth : (n, m) float array
        The values, with impulses at the median of their neighbours.
    impulses : (n,) bool array
        Vertices whose value is far beyond those of their neighbours.
    """

    local: FloatArray
    smooth: FloatArray
    impulses: npt.NDArray[np.bool_]


def value_noise(f: FloatArray, graph: Graph, parts: Components, told: npt.NDArray[np.bool_]) -> ValueNoise:
    """Measure the noise of values (n, m) around each vertex, and find impulses, where it can be `told`, (n,)."""
    repaired, found = without_impulses(f, graph, parts)
    impulses = found & told
    smooth = np.where(impulses[:, None], repaired, f)
    local = np.full(len(f), np.nan)
    if told.any():
        local[told] = settled(local_noise(smooth, graph), parts)[told]
    return ValueNoise(local, smooth, impulses)


def alike_channels(f: FloatArray, graph: Graph) -> list[IntArray]:
    """Group the channels of values (n, m) by their noise: the indices of each group, from the least noise on.

    A channel with much less noise than another one would be blurred by the fidelity of both.
    """
    if f.shape[1] == 1:
        return [np.zeros(1, np.int64)]
    levels = np.sqrt([float(np.mean(local_noise(x[:, None], graph) ** 2)) for x in f.T])
    order = np.argsort(levels, kind="stable")
    groups: list[list[int]] = []
    for c in order:
        if groups and levels[c] <= _ALIKE * levels[groups[-1][0]]:
            groups[-1].append(int(c))
        else:
            groups.append([int(c)])
    return [np.sort(np.array(group)) for group in groups]


def mean_squares(parts: list[FloatArray], sizes: list[int]) -> FloatArray:
    """Return the root mean square of numbers of groups with so many channels each."""
    weighted = [size * np.asarray(part) ** 2 for part, size in zip(parts, sizes, strict=True)]
    means: FloatArray = np.sqrt(np.sum(weighted, axis=0) / sum(sizes))
    return means
