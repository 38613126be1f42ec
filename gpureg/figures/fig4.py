"""Figure 4: the fine partition of a picture, and its regularization on the region adjacency graph."""

from __future__ import annotations

import numpy as np

from ..regions.simplify import simplify_image
from .inputs import Inputs
from .sheet import Drawn, Panel, caption, pictures, psnr

# Longer side of the picture, without and with `quick`.
SIDES = {False: 512, True: 128}
ITERATIONS = 30


def draw(inputs: Inputs) -> Drawn:
    """Draw the figure, and return it with its numbers."""
    source = inputs.grey(SIDES[inputs.quick])
    picture = source.pixels.astype(np.uint8)
    # eq. 25 with lam = 0, as the paper simplifies images without a fidelity
    found = simplify_image(picture, p=2, lam=0, weights="similarity", max_iter=ITERATIONS, backend=inputs.backend)
    change = np.abs(found.value.astype(float) - found.fine)
    again = simplify_image(found.value, max_iter=0, smooth=0, backend=inputs.backend)
    panels = [
        Panel("(a) the picture", picture),
        Panel(f"(b) {found.n_regions} regions, {found.percent:.1f} %", found.random_colours()),
        Panel("(c) painted with their means", found.fine),
        Panel("(d) four times what regularization changes", 255 - np.clip(4 * change, 0, 255)),
        Panel(f"(e) regularized, {ITERATIONS} iterations", found.value),
        Panel(f"(f) the {again.n_regions} zones of its extrema", again.random_colours()),
    ]
    assert found.result is not None
    qualities = psnr(found.fine, picture), psnr(found.value, picture)
    title = "Figure 4. Simplification on the region adjacency graph"
    settings = (
        f"{source.name}; extrema seen through a Gaussian of {found.smooth:g} pixels, energy partition, means; p = 2, "
        f"$w_2^0$, lam = 0, {ITERATIONS} iterations. The paper's picture has 8 %, ours is seen first through the least "
        f"blur that leaves 10 % or less."
    )
    see = (
        f"{found.percent:.1f} % of the numbers, one for each zone, keep the picture to {qualities[0]} dB; "
        f"regularized on the graph of zones it is smoother still, {qualities[1]} dB from the original, and of its "
        f"extrema {again.n_regions} zones are left, {again.percent:.1f} %."
    )
    numbers = {
        "picture": source.name,
        "smooth": found.smooth,
        "regions": found.n_regions,
        "percent": round(found.percent, 2),
        "borders": found.graph.n_edges // 2,
        "psnr of the fine partition": qualities[0],
        "psnr of the regularized one": qualities[1],
        "regions of the regularized one": again.n_regions,
        "iterations": found.result.iterations,
        "method": found.result.method,
        "backend": found.result.backend,
        "seconds": {stage: round(seconds, 4) for stage, seconds in found.seconds.items()},
    }
    return Drawn(title, settings, see, numbers, pictures([panels[:3], panels[3:]], caption(title, settings, see)))
