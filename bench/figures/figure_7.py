"""Figure 7: a curve simplified by p < 1: corners stay, other vertices go; beside Douglas and Peucker."""

from __future__ import annotations

from typing import Any

import numpy as np

import gpureg as gr

from ..model import data


def _coast(quick: bool) -> tuple[str, Any]:
    """Great Britain's coast of the test data, in degrees of latitude, or a made one."""
    path = data("curves", "great_britain_ne10m.csv")
    if not quick and path is not None:
        points = gr.read_curves(path).curves[0].points
        return "Great Britain", points * [np.cos(np.radians(points[:, 1].mean())), 1]
    random = np.random.default_rng(7)
    n = 600
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    waves = sum(
        amplitude * np.cos(k * angle + random.uniform(0, 2 * np.pi))
        for k, amplitude in ((2, 0.2), (5, 0.1), (13, 0.05), (31, 0.03), (70, 0.02))
    )
    return "a made coast", (1 + waves)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def douglas_peucker(points: Any, count: int) -> Any:
    """scikit-image's, with the tolerance that leaves so many vertices, or the next fewer."""
    from skimage.measure import approximate_polygon

    closed = np.concatenate([points, points[:1]])
    low, high = 0.0, float(np.ptp(points, axis=0).max())
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if len(approximate_polygon(closed, middle)) - 1 > count else (low, middle)
    return approximate_polygon(closed, high)[:-1]


def measured(points: Any, before: Any) -> dict[str, float]:
    """What was kept."""
    return {
        "vertices": len(points),
        "share of the vertices": round(len(points) / len(before), 4),
        "share of the area": round(abs(gr.metrics.curve_area(points) / gr.metrics.curve_area(before)), 5),
        "Hausdorff distance": round(gr.metrics.curve_hausdorff(points, before), 5),
    }


def draw(quick: bool, backend: str) -> tuple[Any, dict[str, Any]]:
    """The figure and its numbers."""
    name, coast = _coast(quick)
    directions = gr.simplify_curve(coast, backend=backend)
    drawn = {
        "initial": coast,
        "p = 0.5, directions": directions,
        "p = 0.5, positions": gr.simplify_curve(coast, function="positions", backend=backend),
        "Douglas and Peucker": douglas_peucker(coast, len(directions)),
    }
    numbers: dict[str, Any] = {"curve": name}
    titles = {}
    for title, points in drawn.items():
        found = numbers[title] = measured(points, coast)
        titles[
            f"{title}\n{len(points)} vertices\narea {100 * found['share of the area']:.2f} %\n"
            f"Hausdorff {found['Hausdorff distance']:.3g}"
        ] = points
    return gr.plot.curves(titles, caption=f"Figure 7: {name}; fewer vertices by p < 1", vertices=quick), numbers
