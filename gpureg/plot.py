"""Pictures of results, by matplotlib, which is imported here alone (extra ``plot``)."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from .io import write_atomically


def compare(
    noisy: npt.ArrayLike,
    denoised: npt.ArrayLike,
    path: str | os.PathLike[str],
    *,
    reference: npt.ArrayLike | None = None,
    data_range: float = 255,
    caption: str = "",
) -> tuple[float, ...]:
    """Write a picture of noisy | denoised | difference, with PSNR where a reference is given.

    Parameters
    ----------
    noisy, denoised : (H, W) or (H, W, 3) array
    path : path
        A file whose extension matplotlib knows, .png for one.
    reference : array, optional
        The picture without noise.
    data_range : float, default 255
        White.
    caption : str, optional
        A line below.

    Returns
    -------
    tuple of float
        PSNR of `noisy` and `denoised` in dB, or nothing without a reference.

    Raises
    ------
    ImportError
        matplotlib, or scikit-image for the PSNR, is not installed.
    OSError
        The file cannot be written; nothing is left behind then.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    before, after = (np.asarray(x, np.float64) for x in (noisy, denoised))
    difference = before - after
    spread = float(np.abs(difference).max()) or 1.0
    if difference.ndim == 3:
        difference = 0.5 + difference / (2 * spread)
    titles = ["noisy", "denoised", f"difference (±{spread:.0f})"]
    quality: tuple[float, ...] = ()
    if reference is not None:
        from skimage.metrics import peak_signal_noise_ratio

        clean = np.asarray(reference, np.float64)
        quality = tuple(float(peak_signal_noise_ratio(clean, x, data_range=data_range)) for x in (before, after))
        titles[:2] = (f"{title}, PSNR {value:.2f} dB" for title, value in zip(titles[:2], quality, strict=True))
    height, width = before.shape[:2]
    figure: Any = Figure(figsize=(15, 5.2 * height / width + 0.7), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    grey: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": data_range}
    panels = (np.clip(before, 0, data_range), np.clip(after, 0, data_range), difference)
    for i, (axes, panel, title) in enumerate(zip(figure.subplots(1, 3), panels, titles, strict=True)):
        if panel.ndim == 3:
            axes.imshow(panel / data_range if i < 2 else panel)
        else:
            axes.imshow(panel, **(grey if i < 2 else {"cmap": "gray", "vmin": -spread, "vmax": spread}))
        axes.set_title(title)
        axes.set_axis_off()
    if caption:
        figure.supxlabel(caption, fontsize=10)
    write_atomically(path, lambda temporary: figure.savefig(temporary))
    return quality
