"""A picture larger than the device's budget through ``denoise_image``: seconds, and the host's memory at its peak.

    python bench/large.py --side 16384 --limit 8

Draws squares with noise, float32, denoises them with a progress bar, and prints a line. The exit code is 1 where the
peak, the picture and its result included, passes the limit. A system with /proc and getrusage is needed.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time

import numpy as np

import gpureg as gr


def squares(side: int) -> np.ndarray:
    """A checkerboard of 60 and 190 with noise of standard deviation 20, made in place."""
    image = np.empty((side, side), np.float32)
    random, columns = np.random.default_rng(3), np.arange(side) // 32
    for y in range(side):
        image[y] = 20 * random.standard_normal(side, np.float32)
        image[y] += np.where((columns + y // 32) % 2, 190, 60)
    return image


def peak() -> float:
    """GiB that this process has held at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def main() -> int:
    """Measure, print, and say whether the limit was kept."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=16384)
    parser.add_argument("--limit", type=float, default=8.0, help="GiB of the host's memory")
    parser.add_argument("--backend", default="auto")
    wanted = parser.parse_args()
    image = squares(wanted.side)
    before, begin = peak(), time.perf_counter()
    result = gr.denoise_image(image, backend=wanted.backend, progress=True)
    seconds, most = time.perf_counter() - begin, peak()
    noise = [float(np.std(picture[:4096, :4096] - squares_clean(wanted.side))) for picture in (image, result)]
    print(
        f"{wanted.side}x{wanted.side} float32 on {wanted.backend}: {seconds:.1f} s, peak {most:.2f} GiB "
        f"(before: {before:.2f}; limit {wanted.limit:g}), noise {noise[0]:.1f} -> {noise[1]:.1f}"
    )
    return 0 if most <= wanted.limit else 1


def squares_clean(side: int) -> np.ndarray:
    """The first corner without its noise."""
    y, x = np.indices((min(side, 4096),) * 2, np.int16) // 32
    return np.where((x + y) % 2, np.float32(190), np.float32(60))


if __name__ == "__main__":
    sys.exit(main())
