"""One value for each region of a label image: :func:`region_values` (section 5.2)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, unmasked
from ..checks import choice, integer
from ..doors import door

Model = Literal["mean", "median", "source"]
MODELS: tuple[Model, ...] = ("mean", "median", "source")


@door
def region_values(
    f: npt.ArrayLike,
    labels: npt.ArrayLike,
    model: Model = "mean",
    *,
    sources: npt.ArrayLike | None = None,
    n_regions: int | None = None,
) -> FloatArray:
    """Compute the model of each region: the mean or median of a function, or its value at the region's source.

    Parameters
    ----------
    f : array
        In the shape of `labels`, or with m channels as a last axis.
    labels : int array
        0..k-1, -1 in no region, as returned by :func:`gpureg.energy_partition`.
    model : {"mean", "median", "source"}, default "mean"
        "median" is computed for each channel; for an even number of values it is the mean of the two in the middle.
        "source" is the mean over the cells of the source; for a plateau this is its value.
    sources : int array, optional
        For "source": labels at the cells of the sources, -1 elsewhere, in the shape of `labels`.
    n_regions : int, optional
        k; None means the largest label plus one.

    Returns
    -------
    (k,) or (k, m) float64 array

    Raises
    ------
    TypeError, ValueError
        An unknown model, shapes that do not match, a region without a cell.

    Examples
    --------
    >>> import gpureg as gr
    >>> labels = [[0, 0, 1], [0, 1, 1]]
    >>> gr.region_values([[1, 2, 8], [6, 8, 5]], labels), gr.region_values([[1, 2, 8], [6, 8, 5]], labels, "median")
    (array([3., 7.]), array([2., 8.]))
    """
    choice("model", model, MODELS)
    values, given = unmasked(f, "f"), unmasked(labels, "labels")
    if values.dtype.kind not in "biuf":
        raise TypeError(f"f must hold integers or real numbers, got {values.dtype}")
    shape = given.shape
    if values.shape != shape and values.shape[:-1] != shape:
        raise ValueError(f"f must have the shape of labels {shape}, or that and channels, got {values.shape}")
    zones = _labels(given, "labels")
    if (model == "source") != (sources is not None):
        raise ValueError("sources and model='source' must be given together")
    if sources is not None:
        marked = unmasked(sources, "sources")
        zones = _labels(marked, "sources")
        if marked.shape != shape:
            raise ValueError(f"sources must have the shape of labels, {shape}")
    k = int(zones.max(initial=-1)) + 1 if n_regions is None else integer("n_regions", n_regions, low=1)
    if zones.max(initial=-1) >= k:
        raise ValueError(f"labels must be below n_regions = {k}, got {zones.max()}")
    cells = values.reshape(given.size, -1)
    counts = np.bincount(zones + 1, minlength=k + 1)[1:]
    if not counts.all() or not k:
        raise ValueError(f"region {int(np.argmin(counts)) if k else 0} has no cell")
    found = _medians(cells, zones, counts) if model == "median" else _means(cells, zones, counts)
    return found[:, 0] if values.shape == shape else found


def _labels(array: npt.NDArray[Any], name: str) -> IntArray:
    if array.dtype.kind not in "iu":
        raise TypeError(f"{name} must be integers, got {array.dtype}")
    if array.size and array.dtype.kind == "i" and array.min() < -1:
        raise ValueError(f"{name} must be >= 0, or -1, got {array.min()}")
    return array.reshape(-1).astype(np.int64, copy=False)


def _means(cells: npt.NDArray[Any], zones: IntArray, counts: IntArray) -> FloatArray:
    inside = zones >= 0
    if not inside.all():
        cells, zones = cells[inside], zones[inside]
    sums = [np.bincount(zones, channel, minlength=len(counts)) for channel in cells.T]
    means: FloatArray = np.stack(sums, axis=1) / counts[:, None]
    return means


def _medians(cells: npt.NDArray[Any], zones: IntArray, counts: IntArray) -> FloatArray:
    inside = zones >= 0
    if not inside.all():
        cells, zones = cells[inside], zones[inside]
    last = np.cumsum(counts)
    first = last - counts
    medians = np.empty((len(counts), cells.shape[1]))
    for c, channel in enumerate(cells.T):
        ordered = _by_region(channel, zones)
        lower, upper = ordered[first + (counts - 1) // 2], ordered[first + counts // 2]
        medians[:, c] = (lower.astype(np.float64) + upper) / 2
    return medians


def _by_region(channel: npt.NDArray[Any], zones: IntArray) -> npt.NDArray[Any]:
    """Return the values region by region, sorted within each region."""
    with np.errstate(over="ignore"):
        narrow = channel.astype(np.float32)
    if np.array_equal(narrow, channel) and zones.max(initial=0) < 2**31:
        # Label and value in one integer: sorting is several times faster than by two keys. The bits of floats have the
        # order of the floats if the bits of negative numbers are inverted and -0 is replaced by 0.
        bits = (narrow + np.float32(0)).view(np.uint32)
        rising = np.where(bits >> 31 == 1, ~bits, bits | np.uint32(1 << 31))
        packed = zones.astype(np.uint64) << np.uint64(32) | rising
        packed.sort()
        rising = packed.astype(np.uint32)
        bits = np.where(rising >> 31 == 1, rising & np.uint32(0x7FFFFFFF), ~rising)
        return bits.view(np.float32)
    sorted_values: npt.NDArray[Any] = channel[np.lexsort((channel, zones))]
    return sorted_values
