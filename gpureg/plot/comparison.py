"""Draw a noisy image, the denoised one and their difference; compute PSNR and SSIM."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..doors import door
from .canvas import (
    Path_,
    as_picture,
    as_spacing,
    check_path,
    colours,
    finish,
    finite,
    missing,
    panels,
    sections,
    show,
    span,
    unknown_in,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Side of the window of the structural similarity.
_WINDOW = 7
# Share of the differences within the scale of their panel; the others have the colours of its ends.
_SHOWN = 0.995


def _scale(
    data_range: float | tuple[float, float] | None, pictures: Sequence[npt.NDArray[Any]]
) -> tuple[float, float, bool]:
    """Return black, white, and whether they are only the limits of an integer type; the first picture decides."""
    if data_range is not None:
        ends = np.asarray(data_range)
        if ends.dtype.kind not in "iuf":
            raise TypeError(f"data_range must be a number, or (black, white), got {data_range!r}")
        black, white = (0.0, float(ends)) if ends.ndim == 0 else (float(ends.flat[0]), float(ends.flat[-1]))
        if ends.shape not in ((), (2,)) or not (math.isfinite(black) and math.isfinite(white) and white > black):
            raise ValueError(f"data_range must be a number > 0, or (black, white) with white > black, got {data_range}")
        return black, white, False
    for picture in pictures:
        if picture.dtype.kind in "iu":
            limits = np.iinfo(picture.dtype)
            return float(limits.min), float(limits.max), True
        if picture.dtype.kind == "b":
            return 0.0, 1.0, False
    return *span(pictures[0]), False


@door
def quality(
    image: npt.ArrayLike,
    reference: npt.ArrayLike,
    data_range: float | tuple[float, float] | None = None,
    *,
    channel_axis: int | None = None,
) -> tuple[float, float]:
    """Compute PSNR in dB and SSIM of an image.

    Parameters
    ----------
    image, reference : array
        Arrays of one shape: two or three axes, and an axis of channels if any.
    data_range : float or (float, float), optional
        White, or black and white, in the image's units. The default is the limits of the integer type if one of the
        two has one, otherwise the range of the reference.
    channel_axis : int, optional
        Axis of the channels; None for grey.

    Returns
    -------
    psnr, ssim : float
        Peak signal-to-noise ratio in dB, infinite for equal images, and structural similarity, at most 1; it is NaN
        for an image with fewer than three pixels along an axis. Pixels that are not finite in one of the two do not
        count, nor do windows of the similarity with such a pixel.

    Raises
    ------
    ImportError
        scikit-image is not installed.
    TypeError, ValueError
        The shapes differ, values are not real, or the data range is wrong.

    Notes
    -----
    Both are scikit-image's, with its default settings; the window of the similarity is 7 pixels wide, or smaller in a
    smaller image.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> clean = np.add.outer(np.arange(16.0), np.arange(16.0))
    >>> psnr, ssim = gr.plot.quality(clean + 1, clean, 30)
    >>> round(psnr, 2), round(ssim, 2)
    (29.54, 1.0)
    """
    one, two = as_picture(image, "image", channel_axis), as_picture(reference, "reference", channel_axis)
    if one.shape != two.shape:
        raise ValueError(f"image and reference must have one shape, got {np.shape(image)} and {np.shape(reference)}")
    try:
        from skimage.metrics import peak_signal_noise_ratio, structural_similarity
    except ImportError:
        raise missing("skimage", "scikit-image") from None
    black, white, _ = _scale(data_range, (two, one))
    width = white - black
    one, two = (picture.astype(np.float64) for picture in (one, two))
    known = np.isfinite(one) & np.isfinite(two)
    if not known.any():
        return math.nan, math.nan
    with np.errstate(divide="ignore"):
        psnr = float(peak_signal_noise_ratio(two[known], one[known], data_range=width))
    window = min(_WINDOW, *one.shape[:-1])
    window -= 1 - window % 2
    if window < 3:
        return psnr, math.nan
    one, two = np.where(known, one, 0), np.where(known, two, 0)
    _, similar = structural_similarity(one, two, win_size=window, data_range=width, channel_axis=-1, full=True)
    counts: npt.NDArray[np.bool_] = known
    for axis in range(known.ndim - 1):
        counts = np.asarray(np.lib.stride_tricks.sliding_window_view(counts, window, axis=axis).all(axis=-1))
    inner = (slice(window // 2, -(window // 2)),) * (known.ndim - 1)
    similar = similar[inner][counts]
    return psnr, float(similar.mean()) if similar.size else math.nan


def _title(name: str, values: tuple[float, float] | None) -> str:
    if values is None:
        return name
    ssim = "" if math.isnan(values[1]) else f", SSIM {values[1]:.3f}"
    return f"{name}\nPSNR {values[0]:.2f} dB{ssim}"


@door
def compare(
    noisy: npt.ArrayLike,
    denoised: npt.ArrayLike,
    *,
    reference: npt.ArrayLike | None = None,
    path: Path_ | None = None,
    data_range: float | tuple[float, float] | None = None,
    spacing: Sequence[float] | None = None,
    titles: tuple[str, str] = ("noisy", "denoised"),
    caption: str = "",
    channel_axis: int | None = None,
) -> Figure:
    """Draw noisy | denoised | difference, with PSNR and SSIM where a reference is given.

    Parameters
    ----------
    noisy, denoised : array
        Two or three axes, and an axis of channels if any. Three planes through the middle of a volume are drawn. Three
        channels are red, green and blue; otherwise the mean of the channels is drawn. NaN and infinity are drawn
        orange.
    reference : array, optional
        The image without noise, of the same shape.
    path : path, optional
        File to write, in a format of matplotlib: .png, .pdf, .svg.
    data_range : float or (float, float), optional
        White, or black and white, in the data's units, also for PSNR and SSIM. The default is the limits of the integer
        type, or for floats the range of the reference, or of `noisy` without one. By default integers of more than 8
        bits are drawn over the range of their values.
    spacing : sequence of float, optional
        Distance between pixels along each axis. The default is 1.
    titles : (str, str), default ("noisy", "denoised")
        Titles of the two images.
    caption : str, optional
        Text below the figure.
    channel_axis : int, optional
        Axis of the channels; None for grey.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ImportError
        matplotlib, or scikit-image for the titles, is not installed.
    OSError
        The file cannot be written; no partial file is left.
    TypeError, ValueError
        The shapes differ, values are not real, the data range is wrong, there are not two titles, or matplotlib does
        not write the format.

    Notes
    -----
    In the difference, zero is the middle grey, and 99.5 percent of the values are within the scale. Visible structure
    there was removed with the noise.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> noisy = np.random.default_rng(0).normal(100, 20, (64, 64))
    >>> figure = gr.plot.compare(noisy, gr.denoise_image(noisy, backend="numpy"))
    >>> [axes.get_title() for axes in figure.axes[:2]]
    ['noisy', 'denoised']
    """
    check_path(path)
    if not isinstance(titles, list | tuple) or len(titles) != 2 or not all(isinstance(t, str) for t in titles):
        raise ValueError(f"titles must be two strings, got {titles!r}")
    before, after = as_picture(noisy, "noisy", channel_axis), as_picture(denoised, "denoised", channel_axis)
    clean = None if reference is None else as_picture(reference, "reference", channel_axis)
    for name, picture in (("denoised", after), ("reference", clean)):
        if picture is not None and picture.shape != before.shape:
            raise ValueError(f"{name} must have the shape of noisy, {before.shape}, got {picture.shape}, channels last")
    steps = as_spacing(spacing, before.ndim - 1)
    given = (before,) if clean is None else (clean, before)
    black, white, by_type = _scale(data_range, given)
    heads = [
        _title(name, None if clean is None else quality(picture, clean, (black, white), channel_axis=-1))
        for name, picture in zip(titles, (before, after), strict=True)
    ]
    if by_type and white - black > 255:
        black, white = span(given[0])
    cuts = sections([size // 2 for size in before.shape[:-1]])
    removed = [cut.of(before).astype(np.float64) - cut.of(after) for cut in cuts]
    sizes = np.abs(np.concatenate([finite(plane) for plane in removed]))
    most = float(sizes.max()) if sizes.size else 0.0
    spread = (float(np.quantile(sizes, _SHOWN)) if sizes.size else 0.0) or most or 1.0
    drawn = [
        [*(colours(cut.of(x), black, white) for x in (before, after)), colours(plane, -spread, spread)]
        for cut, plane in zip(cuts, removed, strict=True)
    ]
    below = [*caption.splitlines(), *unknown_in([picture for pictures in drawn for picture in pictures])]
    figure, axes, beside = panels(cuts, before.shape, steps, [*heads, " - ".join(titles)], below)
    for row, cut, pictures in zip(axes, cuts, drawn, strict=True):
        for panel, picture in zip(row, pictures, strict=True):
            show(panel, picture, cut, steps)
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    bar = ScalarMappable(Normalize(-spread, spread), "gray")
    figure.colorbar(bar, cax=beside, extend="both" if most > spread else "neither")
    return finish(figure, path)
