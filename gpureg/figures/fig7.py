"""Figure 7: a polygon whose vertices meet as p falls below 1; the vertices above, the polygons below."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .. import metrics
from ..arrays import FloatArray
from ..curves.simplify import simplified
from ..graphs.of_shapes import curve_graph
from ..plot.canvas import new_figure
from ..regularization.pieces import met
from ..regularization.regularize import regularize
from .inputs import Inputs
from .sheet import Drawn, caption, share, write_below

DEGREES = (1.0, 0.5, 0.1)
# Fidelity and eps in the unit of the mean segment, the maximum number of iterations, the tolerance, and the distance
# below which vertices have met.
LAM, EPS, MOST, TOLERANCE, MET = 0.001, 1e-3, 4000, 1e-7, 0.05


def draw(inputs: Inputs) -> Drawn:
    """Draw the figure, and return it with its numbers."""
    source = inputs.coast()
    polygon = source.points
    drawn: dict[str, FloatArray] = {"initial": polygon}
    places = {"initial": polygon}
    graph = curve_graph(polygon)
    unit = metrics.curve_length(polygon) / len(polygon)
    middle = polygon.mean(axis=0)
    runs = {}
    for p in DEGREES:
        name = f"p = {p:g}"
        result = regularize(
            (polygon - middle) / unit, graph, p=p, lam=LAM, eps=EPS, norm="edge", max_iter=MOST, tol=TOLERANCE,
            dtype=np.float64, backend=inputs.backend,
        )  # fmt: skip
        runs[name] = result
        drawn[name] = result.value * unit + middle
        places[name] = _met(drawn[name], met(result.value, graph, MET))
    [simple] = simplified(polygon, method="process", backend=inputs.backend).parts
    kept = simple.points
    drawn["p = 0.5, directions"] = places["p = 0.5, directions"] = kept
    numbers: dict[str, Any] = {"curve": source.name, "lam": LAM, "eps": EPS}
    for name in drawn:
        numbers[name] = measured(places[name], polygon)
        if name in runs:
            numbers[name] |= {"iterations": runs[name].iterations, "stop": str(runs[name].stop)}
    peer = douglas_peucker(polygon, len(kept))
    numbers["Douglas and Peucker"] = measured(peer, polygon)
    title = "Figure 7. A polygon simplified: for p < 1 its vertices aggregate"
    settings = (
        f"{source.name}; the graph is the polygon, w = 1, lam = {LAM:g} and eps = {EPS:g} in mean segments, each edge "
        f"by itself (eq. 30), until convergence. The paper gives neither p nor lam. Last: "
        f"simplify_curve(method='process'), which regularizes the directions of segments instead."
    )
    one, last, ours = (numbers[name] for name in ("p = 1", f"p = {DEGREES[-1]:g}", "p = 0.5, directions"))
    see = (
        f"Of {len(polygon)} vertices {last['vertices']} places are left at p = {DEGREES[-1]:g}, with "
        f"{100 * last['share of the area']:.2f} % of the area; at p = 1 {one['vertices']} places and "
        f"{100 * one['share of the area']:.2f} %. By directions "
        f"{ours['vertices']} vertices, {100 * ours['share of the area']:.2f} % and a Hausdorff distance of "
        f"{ours['Hausdorff distance']:.3g}; Douglas and Peucker's at as many: "
        f"{numbers['Douglas and Peucker']['Hausdorff distance']:.3g}."
    )
    figure = _sheet(drawn, places, source.upright, caption(title, settings, see))
    return Drawn(title, settings, see, numbers, figure)


def _met(points: FloatArray, label: npt.NDArray[Any]) -> FloatArray:
    """Return the mean (k, 2) of each set of vertices that have met, in the order of the polygon."""
    first = np.sort(np.unique(label, return_index=True)[1])
    sums = [np.bincount(label, weights=x) for x in points.T]
    means: FloatArray = np.stack(sums, axis=1) / np.bincount(label)[:, None]
    in_order: FloatArray = means[label[first]]
    return in_order


def douglas_peucker(points: Any, count: int) -> Any:
    """Simplify with scikit-image to `count` vertices, or to the largest possible number below."""
    from skimage.measure import approximate_polygon

    closed = np.concatenate([points, points[:1]])
    low, high = 0.0, float(np.ptp(points, axis=0).max())
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if len(approximate_polygon(closed, middle)) - 1 > count else (low, middle)
    return approximate_polygon(closed, high)[:-1]


def measured(points: Any, before: Any) -> dict[str, float]:
    """Compare a simplified curve (k, 2) with the curve (n, 2) before."""
    return {
        "vertices": len(points),
        "share of the vertices": round(len(points) / len(before), 4),
        "share of the area": share(abs(metrics.curve_area(points)), abs(metrics.curve_area(before)), 5),
        "Hausdorff distance": round(metrics.curve_hausdorff(points, before), 5),
    }


def _sheet(drawn: dict[str, FloatArray], places: dict[str, FloatArray], upright: bool, words: str) -> Any:
    """Draw two rows: the vertices, and the polygons through the places where they met."""
    figure = new_figure(3.2 * len(drawn), 7.6, "constrained")
    every = next(iter(drawn.values()))
    low, high = every.min(axis=0), every.max(axis=0)
    middle, half = (low + high) / 2, 0.53 * float((high - low).max())
    rows = figure.subplots(2, len(drawn))
    for above, below, (name, points) in zip(*rows, drawn.items(), strict=True):
        above.plot(points[:, 0], points[:, 1], ".", color="#c0392b", markersize=2.2)
        closed = np.concatenate([places[name], places[name][:1]])
        below.plot(closed[:, 0], closed[:, 1], color="#1f4e79", linewidth=0.9)
        above.set_title(f"{name}\n{len(places[name])} places", fontsize=11)
        for axes in (above, below):
            axes.set_xlim(middle[0] - half, middle[0] + half)
            axes.set_ylim(*sorted((middle[1] - half, middle[1] + half), reverse=not upright))
            axes.set_aspect("equal")
            axes.set_axis_off()
    write_below(figure, words)
    return figure
