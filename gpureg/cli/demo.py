"""``gpureg demo``: denoise a picture that comes with scikit-image."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import click
import numpy as np

from ..files.pictures import PictureError, check_place
from ..images.choose import plan_denoising
from ..images.run import run_plan
from .group import sentences
from .options import FILE, examples
from .terminal import say


@click.command(epilog=examples("gpureg demo"), short_help="Denoise a picture that comes with scikit-image.")
@click.argument("target", metavar="[OUT]", default="gpureg-demo.png", type=FILE)
@click.option("--sigma", type=float, default=20.0, show_default=True, help="Sigma of the noise to add, of 255.")
@click.option("--backend", default="auto", show_default=True, help="Where to run.")
def demo(target: Path, sigma: float, backend: str) -> None:
    """Add noise to scikit-image's camera picture, denoise it, and draw noisy | denoised | difference to OUT."""

    def work() -> None:
        check_place(target)
        if not (math.isfinite(sigma) and sigma >= 1):
            raise ValueError(f"--sigma must be finite and >= 1 (smaller is lost in rounding to 8 bits), got {sigma}")
        try:
            from skimage import data

            from .. import plot
            from ..plot.canvas import check_path

            check_path(target)
        except ImportError as error:
            raise PictureError(f"the demo needs {error.name}: pip install 'gpureg[plot]'") from None
        except ValueError as error:  # matplotlib draws OUT, and does not write every format of pictures
            raise PictureError(str(error)) from None
        clean = data.camera()
        noise = np.random.default_rng(0).standard_normal(clean.shape) * sigma
        noisy = np.clip(np.rint(clean + noise), 0, 255).astype(np.uint8)
        plan = plan_denoising(noisy)
        result = run_plan(plan, noisy, backend=backend, progress=sys.stderr.isatty())
        caption = f"{plan.describe()}\n{result.seconds:.2f} s on {result.backend}"
        try:
            before, after = (plot.quality(picture, clean)[0] for picture in (noisy, result.value))
            plot.compare(noisy, result.value, reference=clean, path=target, caption=caption)
        except ImportError as error:
            raise PictureError(f"the demo needs {error.name}: pip install 'gpureg[plot]'") from None
        say(
            f"noise    sigma = {plan.sigma:.4g} of 255, estimated (added: {sigma:g})\n"
            f"filter   {plan.describe()}\n"
            f"done     {result.seconds:.2f} s on {result.backend}; PSNR {before:.2f} -> {after:.2f} dB\n"
            f"picture  {target.resolve()}"
        )

    sentences(work)
