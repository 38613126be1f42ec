"""How time grows with the number of pixels: one case per size, ours and the peers'."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import gpureg as gr
from gpureg import backends

from .filters import OPENCV_NLM, SKIMAGE_NLM, nlm_operations, one_step
from .iterations import NUMPY64, PRODUCT, Sweeps, first_iteration, operations, scipy_product, unit_picture
from .model import DEVICE, HOST, TOLERANCE, Bar, Case, Entry, Image, Setup, apart, missing, peer, skipped, traffic

GROWN = "its smallest size, per pixel"
# Side of the corners that are compared where the whole is too much for numpy in float64.
CORNER = 96


def free_memory() -> float:
    """Bytes that are free, infinity where the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return float("inf")
    return next((1024.0 * float(line.split()[1]) for line in lines if line.startswith("MemAvailable")), float("inf"))


def corners_agree(
    value: Callable[[], Image], f0: Image, reach: int, exact: Callable[[Image], Image]
) -> tuple[bool, str]:
    """Whether two opposite corners of our result are those of numpy, given a crop wider by `reach`.

    The far corner finds numbers of vertices that do not fit their type.
    """
    found = value()
    side = len(f0)
    keep = min(CORNER, side)
    crop = min(keep + reach, side)
    good, said = True, []
    for where, wide, part in (
        ("near", slice(0, crop), slice(0, keep)),
        ("far", slice(side - crop, side), slice(side - keep, side)),
    ):
        inside = slice(part.start - wide.start, part.stop - wide.start)
        same, text = apart(
            found[part, part], exact(f0[wide, wide])[inside, inside], TOLERANCE["float32"], f"{NUMPY64}, {where} corner"
        )
        good = good and same
        said.append(text)
    return good, "; ".join(said)


def sweep_growth(setup: Setup) -> Iterator[Case]:
    """One p = 1 iteration on a grid of 8 neighbours, from 512x512 to 8192x8192."""
    w1 = gr.weights.bilateral(2.0, 0.2)
    for side in setup.pick((512, 1024, 2048, 4096, 8192), (64, 128, 256), (24, 37)):
        f0, name = unit_picture(setup, side)
        grid = gr.GridGraph((side, side), 1)
        picture = f0.reshape(grid.shape)
        # the two passes' arrays, and as much again while they are packed and uploaded
        need = 2.0 * traffic("sweep", grid)
        n_edges = 8 * grid.n_vertices

        def exact(crop: Image) -> Image:
            return first_iteration(gr.GridGraph(crop.shape, 1), w1, crop.reshape(-1, 1)).reshape(crop.shape)

        entries = []
        if side <= 2048:
            oracle = backends.get("numpy")
            half = oracle.get_weights(w1.prepare(oracle, grid, f0))
            entries.append(scipy_product(grid.to_graph(half), f0))
        else:
            entries.append(
                Entry(PRODUCT, None, is_peer=True, note="not tried beyond 2048x2048: its matrix is too large")
            )
        free = free_memory()
        for device in setup.best_of_each():
            # those before it keep theirs: all are timed in turns
            if free < need:
                entries.append(skipped(device, f"needs about {need / 1e9:.0f} GB, {free / 1e9:.0f} are left"))
                continue
            free -= need
            sweeps = Sweeps(device, grid, w1, f0)

            def check(sweeps: Sweeps = sweeps, picture: Image = picture) -> tuple[bool, str]:
                sweeps()
                return corners_agree(lambda: sweeps.value().reshape(picture.shape), picture, 2, exact)

            count = operations(grid.n_vertices, n_edges)
            entries.append(Entry(device, sweeps, sweeps.backend.finish, check, DEVICE, traffic("sweep", grid), count))
        yield Case(
            "growth-iteration",
            "one p = 1 iteration on a grid, 8 neighbours, bilateral weights, by size",
            entries,
            [f"{name}; the best device of each backend; weights made and on the device before"],
            [Bar(GROWN, 1.15, transfers=DEVICE, growth=True)],
            f"{side}x{side}",
            grid.n_vertices,
        )


def nlm_growth(setup: Setup) -> Iterator[Case]:
    """Nonlocal means, one step from host to host, from 512x512 to 8192x8192."""
    patch_radius, radius, H = setup.pick((3, 10, 20.0), (3, 10, 20.0), (1, 3, 20.0))
    size, width = 2 * patch_radius + 1, 2 * radius + 1
    w2 = gr.weights.patch(patch_radius, size * H)
    opencv, restoration = peer("cv2"), peer("skimage.restoration")
    for side in setup.pick((512, 1024, 2048, 4096, 8192), (64, 128, 256), (24, 37)):
        _, noisy, name = setup.noisy(side)
        grey = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        f0 = grey.astype(np.float32)
        grid = gr.GridGraph(f0.shape, radius)

        def exact(crop: Image) -> Image:
            return one_step("numpy", crop, gr.GridGraph(crop.shape, radius), w2, dtype=np.float64)

        def by_opencv(grey: Image = grey) -> Any:
            return opencv.fastNlMeansDenoising(grey, None, H, size, width)

        def by_skimage(f0: Image = f0) -> Any:
            return restoration.denoise_nl_means(f0, size, radius, H, fast_mode=True, preserve_range=True)

        entries = [
            missing(who) if module is None else Entry(who, call, is_peer=True)
            for who, module, call in ((OPENCV_NLM, opencv, by_opencv), (SKIMAGE_NLM, restoration, by_skimage))
        ]
        for device in setup.best_of_each():

            def ours(device: str = device, f0: Image = f0, grid: gr.GridGraph = grid) -> Image:
                return one_step(device, f0, grid, w2)

            def check(ours: Callable[[], Image] = ours, f0: Image = f0) -> tuple[bool, str]:
                return corners_agree(ours, f0, radius + patch_radius, exact)

            count = nlm_operations(grid)
            entries.append(
                Entry(device, ours, check=check, transfers=HOST, bytes=8.0 * grid.n_vertices, operations=count)
            )
        yield Case(
            "growth-nlm",
            f"nonlocal means, {size}x{size} flat patch, {width}x{width} window, one step, host to host, by size",
            entries,
            [f"picture: {name}, noise of standard deviation 20, rounded to 8 bits; the best device of each backend"],
            [Bar(GROWN, 1.15, growth=True)],
            f"{side}x{side}",
            grid.n_vertices,
        )
