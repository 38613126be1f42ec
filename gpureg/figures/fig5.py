"""Figure 5: a polygon, its vertices regularized with p = 2, w = 1; it shrinks only without the fit term."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import metrics
from ..curves.denoise import denoise_curve
from ..plot import curves
from ..solvers import Jacobi
from .inputs import Inputs
from .sheet import Drawn, caption, share

# Iterations without and with the fit term, as in the paper, and the fidelity, which the paper does not give.
FREE, FITTED, LAM = 30, 100, 4.0
# Noise, in segments, and the maximum number of vertices, so that they are visible.
NOISE, VERTICES = 0.25, 80


def draw(inputs: Inputs) -> Drawn:
    """Draw the figure, and return it with its numbers."""
    source = inputs.outline()
    polygon = source.points[:: -(-len(source.points) // VERTICES)]
    segment = metrics.curve_length(polygon) / len(polygon)
    drawn = {"original": polygon} if inputs.noise else {}
    if inputs.noise:
        polygon = polygon + np.random.default_rng(5).normal(0, NOISE * segment, polygon.shape)
    drawn |= {"noisy": polygon}
    free, fitted = f"lam = 0, {FREE} iterations", f"lam = {LAM:g}, {FITTED} iterations"
    settings_of: dict[str, Any] = {"solver": Jacobi(damping=1), "tol": None, "backend": inputs.backend}
    for name, lam, iterations in ((free, 0.0, FREE), (fitted, LAM, FITTED)):
        drawn[name] = denoise_curve(polygon, lam=lam, max_iter=iterations, **settings_of)
    first = next(iter(drawn.values()))
    area, length = abs(metrics.curve_area(first)), metrics.curve_length(first)
    numbers: dict[str, Any] = {"polygon": source.name, "vertices": len(polygon), "lam": [0.0, LAM]}
    titles = {}
    for name, points in drawn.items():
        told = {
            "share of the area": share(abs(metrics.curve_area(points)), area),
            "share of the length": share(metrics.curve_length(points), length),
        }
        if inputs.noise:
            error = float(np.linalg.norm(points - first, axis=1).mean() / segment)
            told["mean error in segments"] = round(error, 3)
        numbers[name] = told
        titles[
            f"{name}\narea {100 * told['share of the area']:.1f} %, length {100 * told['share of the length']:.1f} %"
        ] = points
    title = "Figure 5. A polygon denoised by the positions of its vertices, without and with the fit term"
    noise = f", noise of {NOISE:g} segments added" if inputs.noise else ""
    settings = (
        f"{source.name}, {len(polygon)} vertices{noise}; p = 2, w = 1, iterations of (31) as in the paper, which does "
        f"not give its lam."
    )
    see = (
        f"Without the fit term the polygon shrinks to {100 * numbers[free]['share of the area']:.1f} % of its area and "
        f"{100 * numbers[free]['share of the length']:.1f} % of its length; with it "
        f"{100 * numbers[fitted]['share of the area']:.1f} % and {100 * numbers[fitted]['share of the length']:.1f} % "
        f"are left."
    )
    if inputs.noise:
        errors = [numbers[name]["mean error in segments"] for name in ("noisy", free, fitted)]
        see += " Mean error of a vertex, in segments: noisy {}, without {}, with {}.".format(*errors)
    figure = curves(titles, upright=source.upright, caption=caption(title, settings, see), vertices=False)
    return Drawn(title, settings, see, numbers, figure)
