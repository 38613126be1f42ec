"""Figure 5: a polygon, its vertices regularized with p = 2, w = 1: it shrinks without the fit term, not with it."""

from __future__ import annotations

from typing import Any

import numpy as np

import gpureg as gr

from ..model import data

# Iterations without fit term and with it, as in the paper, and the fidelity.
FREE, FITTED, LAM = 30, 100, 0.5


def _polygon(quick: bool) -> tuple[str, Any]:
    """A butterfly's outline of the test data, or a star with noise."""
    path = data("curves", "mpeg7_butterfly_1.csv")
    if not quick and path is not None:
        return "butterfly", gr.read_curves(path).curves[0].points[::20]
    angle = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    radius = 100 + 25 * np.cos(5 * angle) + np.random.default_rng(5).normal(0, 1.5, len(angle))
    return "star", radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def draw(quick: bool, backend: str) -> tuple[Any, dict[str, Any]]:
    """The figure and its numbers."""
    name, polygon = _polygon(quick)
    settings: dict[str, Any] = {"solver": gr.Jacobi(damping=1), "tol": None, "backend": backend}
    drawn = {"initial": polygon}
    for title, lam, iterations in ((f"λ = 0, {FREE} iterations", 0.0, FREE), (f"λ = {LAM}, {FITTED}", LAM, FITTED)):
        drawn[title] = gr.denoise_curve(polygon, lam=lam, max_iter=iterations, **settings)
    area, length = abs(gr.metrics.curve_area(polygon)), gr.metrics.curve_length(polygon)
    numbers: dict[str, Any] = {
        "polygon": name,
        "vertices": len(polygon),
        "lam": [0.0, LAM],
        "iterations": [FREE, FITTED],
    }
    titles = {}
    for title, points in drawn.items():
        found = {
            "share of the area": round(abs(gr.metrics.curve_area(points)) / area, 4),
            "share of the length": round(gr.metrics.curve_length(points) / length, 4),
        }
        numbers[title] = found
        titles[f"{title}\narea {100 * found['share of the area']:.1f} %"] = points
    caption = (
        f"Figure 5: {name}, {len(polygon)} vertices; p = 2, w = 1. What shrinks without the fit term stays with it"
    )
    return gr.plot.curves(titles, caption=caption, vertices=False), numbers
