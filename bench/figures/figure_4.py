"""Figure 4: the fine partition of a picture, and its regularization on the region adjacency graph."""

from __future__ import annotations

from typing import Any

import numpy as np

import gpureg as gr

from .levelling import camera

# Sides of the picture: in full, and quickly.
SIDES = {False: 512, True: 128}
ITERATIONS = 30


def draw(quick: bool, backend: str) -> tuple[Any, dict[str, Any]]:
    """The figure and its numbers."""
    from matplotlib.figure import Figure

    side = SIDES[quick]
    picture = camera(side).astype(np.uint8)
    # the paper's process is without a fidelity in its image part: eq. 25 with lam = 0
    found = gr.simplify_image(picture, p=2, lam=0, weights="similarity", max_iter=ITERATIONS, backend=backend)
    change = np.abs(found.value.astype(float) - found.fine)
    panels = [
        ("(a) the picture", picture),
        (f"(b) {found.n_regions} regions, {found.percent:.1f} percent", found.random_colours()),
        ("(c) painted with their means", found.fine),
        ("(d) what regularization changes", 255 - np.clip(4 * change, 0, 255)),
        (f"(e) regularized, p = 2, $w_2^0$, {ITERATIONS} iterations", found.value),
        ("(f) the zones of its extrema", gr.simplify_image(found.value, max_iter=0, smooth=0).random_colours()),
    ]
    figure = Figure(figsize=(12.3, 8.8), dpi=110, layout="constrained")
    for axes, (title, image) in zip(figure.subplots(2, 3).flat, panels, strict=True):
        axes.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        axes.set_title(title, fontsize=10)
        axes.set(xticks=[], yticks=[])
    figure.suptitle("Figure 4: simplification on the region adjacency graph", fontsize=13)
    assert found.result is not None
    numbers = {
        "picture": f"scikit-image's camera, reduced to {side} x {side}",
        "smooth": found.smooth,
        "regions": found.n_regions,
        "percent": round(found.percent, 2),
        "borders": found.graph.n_edges // 2,
        "psnr of the fine partition": round(_psnr(found.fine, picture), 2),
        "psnr of the regularized one": round(_psnr(found.value, picture), 2),
        "iterations": found.result.iterations,
        "method": found.result.method,
        "backend": found.result.backend,
        "seconds": {stage: round(seconds, 4) for stage, seconds in found.seconds.items()},
    }
    return figure, numbers


def _psnr(image: np.ndarray[Any, Any], truth: np.ndarray[Any, Any]) -> float:
    return float(10 * np.log10(255**2 / np.mean((image.astype(float) - truth) ** 2)))
