"""Estimates of the mean squared error of a denoised image without the clean image."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import unmasked
from ..checks import flag, integer, number
from ..doors import door
from ..exchange import as_given, on_host
from ..graphs.edges import checked_spacing

Denoiser = Callable[..., npt.ArrayLike]
Values = npt.NDArray[np.floating[Any]]
Inside = npt.NDArray[np.bool_] | None

# Step of the random probe, as a share of the noise.
_STEP = 0.02


@door
def sure(
    denoise: Denoiser,
    image: npt.ArrayLike,
    sigma: float | npt.ArrayLike,
    *,
    channel_axis: int | None = None,
    mask: npt.ArrayLike | None = None,
    seed: int = 0,
    step: float | None = None,
) -> float:
    """Estimate the mean squared error of a denoiser without bias (Stein), by one random probe.

    Parameters
    ----------
    denoise : callable
        ``denoise(image)`` returns an array of the image's shape. It is called twice with floats: integers are
        converted, as rounding would hide the small step.
    image : array
        The noisy image, or data of any shape.
    sigma : float or array
        Standard deviation >= 0 of the white Gaussian noise, in the image's units; an array broadcasts to the image.
    channel_axis : int, optional
        The axis of the channels, for `mask`.
    mask : bool array, optional
        True where a pixel counts, in the shape of the image without the channels; NaN is allowed elsewhere.
    seed : int, default 0
        Seed of the probe; use the same one for denoisers that are compared.
    step : float, optional
        Length of the probe's step, in the image's units; None means sigma/50.

    Returns
    -------
    float
        Mean over pixels and channels, in squared units of the image. Its standard deviation is about
        sigma^2 sqrt(2/N), and it can be negative.

    Raises
    ------
    TypeError, ValueError
        Arguments that do not match, or a denoiser that returns another shape or values that are not finite.

    Notes
    -----
    The estimate is

        mean((f(y) - y)^2) - mean(sigma^2) + 2 mean(sigma^2 b (f(y + e b) - f(y))/e)

    with random b = +-1 and step e (Ramani, Blu, Unser, Monte-Carlo SURE, IEEE TIP 17(9), 2008). The denoiser must be
    continuous. If it computes weights from the image, it must compute them from its argument.

    Examples
    --------
    >>> import numpy as np
    >>> noisy = np.random.default_rng(7).normal(0, 2, (64, 64))
    >>> round(sure(lambda y: 0.5 * y, noisy, 2.0), 1)  # a quarter of the noise's energy is left
    1.0
    """
    integer("seed", seed, low=0)
    values, inside = _checked(image, mask, channel_axis)
    noise = np.asarray(sigma)
    if noise.dtype.kind not in "iuf":
        raise TypeError(f"sigma must be a real number or an array of them, got {sigma!r}")
    try:
        variance = np.broadcast_to(noise.astype(np.float64) ** 2, values.shape)
    except ValueError:
        raise ValueError(
            f"sigma must be a number or broadcast to shape {values.shape}, got shape {noise.shape}"
        ) from None
    if inside is not None:
        variance = variance[inside]
    if not np.isfinite(variance).all() or (noise < 0).any():
        raise ValueError("sigma must be finite and >= 0")
    mean = float(np.mean(variance))
    if step is None:
        step = _STEP * math.sqrt(mean)
    else:
        number("step", step, above=0)
    before = _denoised(denoise, values, inside)
    error = float(np.mean((before - _of(values, inside)) ** 2))
    if mean == 0:
        return error
    probe = np.random.default_rng(seed).integers(0, 2, values.shape) * 2.0 - 1.0
    moved = _denoised(denoise, (values + step * probe).astype(values.dtype), inside)
    return error - mean + 2 * float(np.mean(variance * _of(probe, inside) * (moved - before))) / step


@door
def j_invariance(
    denoise: Denoiser,
    image: npt.ArrayLike,
    *,
    stride: int = 4,
    every: bool = False,
    channel_axis: int | None = None,
    mask: npt.ArrayLike | None = None,
    spacing: Sequence[float] | None = None,
) -> float:
    """Compute the self-supervised loss of a denoiser: the error of its predictions of hidden pixels.

    Parameters
    ----------
    denoise : callable
        As in :func:`sure`. It is called once, or stride^d times with `every`.
    image : array
        The noisy image.
    stride : int, default 4
        Distance >= 2 between the pixels that are hidden at the same time.
    every : bool, default False
        Hide every pixel once, in stride^d grids, instead of one grid in the middle.
    channel_axis : int, optional
        The axis of the channels, which are hidden together.
    mask : bool array, optional
        True where a pixel counts, in the shape of the image without the channels; NaN is allowed elsewhere.
    spacing : sequence of float, optional
        Size of a pixel along each axis; None means 1. A hidden pixel is replaced by the mean of its neighbours, with
        the inverse squares of their distances as weights.

    Returns
    -------
    float
        Mean squared difference to the noisy values. It estimates the mean squared error plus sigma^2, for any noise
        that is independent between pixels; smaller is better.

    Raises
    ------
    TypeError, ValueError
        As :func:`sure`; also an image that is too small for the stride.

    Notes
    -----
    See Batson and Royer, Noise2Self (ICML 2019). With equal spacing and no mask this is the loss of scikit-image's
    ``denoise_invariant``, which converts integers to 0..1 and has neither mask nor spacing. Denoisers that give the
    pixel itself a large weight lose most when it is hidden. Then the best parameters here smooth too little or too much
    in the denoiser itself; :func:`sure` does not have this error.

    Examples
    --------
    >>> import numpy as np
    >>> noisy = np.random.default_rng(7).normal(0, 2, (64, 64))
    >>> round(j_invariance(lambda y: 0 * y, noisy, every=True), 1)  # no error, and the noise of 3.9
    3.9
    """
    integer("stride", stride, low=2)  # with 1, all neighbours of a hidden pixel are hidden
    every = flag("every", every)
    values, inside = _checked(image, mask, channel_axis)
    axes = [axis for axis in range(values.ndim) if channel_axis is None or axis != channel_axis % values.ndim]
    sizes = checked_spacing(spacing, len(axes)) or (1.0,) * len(axes)
    steps = dict(zip(axes, sizes, strict=True))
    filled = _neighbours(values, inside, steps)
    total, count = 0.0, 0
    for hidden in _grids([values.shape[a] if a in axes else 0 for a in range(values.ndim)], int(stride), every):
        of = np.zeros(values.shape, bool)
        of[hidden] = True
        if inside is not None:
            of &= inside
        if of.any():
            told = _denoised(denoise, np.where(of, filled, values), of)
            total, count = total + float(((told - values[of]) ** 2).sum()), count + told.size
    if not count:
        raise ValueError(
            f"no pixel is hidden: the image, shape {values.shape}, or its mask is too small for the stride"
        )
    return total / count


def _checked(image: npt.ArrayLike, mask: npt.ArrayLike | None, channel_axis: int | None) -> tuple[Values, Inside]:
    """Check the image and the mask, and return them as floats and as booleans in the image's shape."""
    array = unmasked(image, "image")
    if array.dtype.kind not in "iuf":
        raise TypeError(f"image must hold integers or real numbers, got {array.dtype}")
    if channel_axis is not None:
        integer("channel_axis", channel_axis, low=-array.ndim, high=array.ndim - 1)
    values: Values = array.astype(np.float32 if array.dtype in (np.float16, np.float32) else np.float64)
    inside = None
    if mask is not None:
        inside = np.asarray(mask)
        shape = array.shape if channel_axis is None else tuple(np.delete(array.shape, channel_axis).tolist())
        if inside.dtype != np.bool_ or inside.shape != shape:
            raise ValueError(f"mask must be boolean of shape {shape}, got {inside.dtype} of shape {inside.shape}")
        if channel_axis is not None:
            inside = np.expand_dims(inside, channel_axis)
        inside = np.broadcast_to(inside, values.shape)
    if not np.isfinite(_of(values, inside)).all():
        raise ValueError("image must be finite; a mask can leave pixels out")
    if not _of(values, inside).size:
        raise ValueError("image is empty, or the mask is False everywhere")
    return values, inside


def _of(values: npt.NDArray[Any], inside: Inside) -> npt.NDArray[Any]:
    return values if inside is None else values[inside]


def _denoised(denoise: Denoiser, values: Values, where: Inside) -> npt.NDArray[np.float64]:
    """Return the checked result of a denoiser at some pixels, in float64."""
    value = np.asarray(on_host(denoise(as_given(values)), "the result of the denoiser"))
    if value.shape != values.shape:
        raise ValueError(f"the denoiser must return an array of shape {values.shape}, got {value.shape}")
    chosen: npt.NDArray[np.float64] = _of(value, where).astype(np.float64)
    if not np.isfinite(chosen).all():
        raise ValueError("the denoiser returned values that are not finite")
    return chosen


def _grids(sizes: list[int], stride: int, every: bool) -> Iterator[tuple[slice, ...]]:
    """Yield grids of pixels as slices; size 0 means an axis of channels, whose slice is the whole axis."""
    offsets = itertools.product(*[range(stride) if size else (0,) for size in sizes])
    grids = [
        tuple(slice(o, None, stride) if size else slice(None) for o, size in zip(offset, sizes, strict=True))
        for offset in offsets
    ]
    yield from grids if every else grids[len(grids) // 2 :][:1]


def _neighbours(values: Values, inside: Inside, spacing: dict[int, float]) -> Values:
    """Compute the mean of the nearest neighbours along these axes inside the mask, mirrored at the border."""
    from scipy import ndimage

    kept: Any = np.ones(1, values.dtype) if inside is None else inside.astype(values.dtype)
    data = values if inside is None else np.where(inside, values, 0).astype(values.dtype)
    total, weight = np.zeros_like(values), np.zeros_like(values)
    for axis, step in spacing.items():
        if values.shape[axis] > 1:
            pair = np.array([1, 0, 1]) / step**2
            total += ndimage.convolve1d(data, pair, axis, mode="mirror")
            weight += ndimage.convolve1d(np.broadcast_to(kept, values.shape), pair, axis, mode="mirror")
    # a pixel without neighbours gets the mean of all pixels
    alone = data.sum() / np.broadcast_to(kept, values.shape).sum()
    mean: Values = np.where(weight > 0, total / np.where(weight > 0, weight, 1), alone).astype(values.dtype)
    return mean
