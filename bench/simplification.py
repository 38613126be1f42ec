"""What simplification leaves of pictures: ``GPUREG_DATA=... python -m bench.simplification [--backend NAME]``.

For each picture the raw regional extrema on G_0 and G_1 in percent of the pixels, the Gaussian that was needed for one
region to ten pixels, the regions, the PSNR of the fine partition and of the regularized one (Fig. 4: p = 2, w2^0,
lam = 0, 30 iterations), and seconds.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

import gpureg as gr
from gpureg.files.pictures import read_picture

from .filters import psnr
from .model import NEEDS_DATA, data

PICTURES = ("camera", "coins", "set12_02_house", "kodim08", "kodim19", "astronaut")


def main(arguments: list[str] | None = None) -> int:
    """Print the table; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m bench.simplification", description=__doc__)
    parser.add_argument("--backend", default="auto", help="where to run (default: auto)")
    options = parser.parse_args(arguments)
    print("| picture | extrema on G_0, G_1 | smooth | regions | of the pixels | PSNR fine | regularized | seconds |")
    print("|---|---|---|---|---|---|---|---|")
    for name in PICTURES:
        path = data("images", f"{name}.png")
        if path is None:
            print(NEEDS_DATA, file=sys.stderr)
            return 1
        picture = read_picture(path)
        image, axis = picture.pixels, picture.channel_axis
        cells = image.shape[:2]
        raw = []
        for metric in ("cityblock", "chebyshev"):
            seeds = gr.sources.extrema(image, gr.GridGraph(cells, 1, metric), backend=options.backend)
            raw.append(100 * (seeds.max() + 1) / seeds.size)
        gr.simplify_image(image, lam=0, channel_axis=axis, backend=options.backend)  # kernels are built
        begin = time.perf_counter()
        found = gr.simplify_image(image, lam=0, channel_axis=axis, backend=options.backend)
        value = found.value
        seconds = time.perf_counter() - begin
        clean = image.astype(np.float64)
        print(
            f"| {name} | {raw[0]:.1f}, {raw[1]:.1f} % | {found.smooth:g} | {found.n_regions} | {found.percent:.1f} % | "
            f"{psnr(found.fine.astype(float), clean, 255.0):.2f} | {psnr(value.astype(float), clean, 255.0):.2f} | "
            f"{seconds:.2f} |"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
