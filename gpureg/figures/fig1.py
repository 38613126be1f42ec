"""Figure 1: local, semilocal and nonlocal smoothing for p from 2 to 0.01, and total variation to convergence."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..plot.canvas import new_figure
from ..regularization.regularize import regularize
from ..weights import bilateral
from .inputs import Inputs
from .levelling import DEGREES, GRAPHS, ITERATIONS, SIDES, WEIGHTS, Run, count, grid_of, numbers, runs
from .sheet import Drawn, Panel, caption, show, write_below

# Fidelity of (b) and (c), per grey level, the tolerance of convergence, and the maximum number of iterations.
LAM, TOLERANCE, MOST = 0.02, 1e-6, 20000
# Share of the edges, the steepest ones, that count as discontinuities.
STEEP = 0.02


def total_variation(picture: FloatArray, backend: str) -> list[Run]:
    """Compute (b) and (c): p = 1 on G_0 without and with weights, with the same fidelity."""
    done = []
    for name, weights in (("G_0", None), ("G_0, w_1", bilateral(4, 20))):
        result = regularize(
            picture, grid_of("G_0", picture.shape), p=1, lam=LAM, weights=weights, tol=TOLERANCE, max_iter=MOST,
            backend=backend,
        )  # fmt: skip
        done.append(Run(name, 1.0, result.value, count(result.value), result))
    return done


def contrast_kept(value: FloatArray, picture: FloatArray) -> float:
    """Compute the share of the picture's steepest differences between neighbours that is left."""
    before = np.concatenate([np.diff(picture, axis=axis).ravel() for axis in (0, 1)])
    after = np.concatenate([np.diff(value, axis=axis).ravel() for axis in (0, 1)])
    steep = np.abs(before) >= np.quantile(np.abs(before), 1 - STEEP)
    # differences of the other sign are subtracted
    return float((after * np.sign(before))[steep].sum() / np.abs(before)[steep].sum())


def draw(inputs: Inputs) -> Drawn:
    """Draw the figure, and return it with its numbers."""
    picture = inputs.grey(SIDES[inputs.quick])
    shown, variation = runs(inputs), total_variation(picture.pixels, inputs.backend)
    kept = [contrast_kept(run.value, picture.pixels) for run in variation]
    title = "Figure 1. From smoothing to simplification: p and the graph decide"
    settings = (
        f"{picture.name}; (b), (c) until convergence; (d) to (f) lam = 0, {ITERATIONS} iterations of (31). {WEIGHTS}; "
        f"eps = 2.55. The paper does not give these, nor the lam of (b) and (c)."
    )
    first, last = ({graph: _zones(shown, graph, p) for graph in GRAPHS} for p in (DEGREES[0], DEGREES[-1]))
    see = (
        f"With the same lam, weights keep {100 * kept[1]:.0f} % of the contrast across the steepest {100 * STEEP:g} % "
        f"of the edges, plain TV {100 * kept[0]:.0f} %. "
        f"Flat zones from p = {DEGREES[0]:g} to {DEGREES[-1]:g}: "
        + ", ".join(f"{first[graph]} to {last[graph]} on {graph}" for graph in GRAPHS)
        + ". The larger, weighted neighbourhoods keep edges sharp where G_0 blurs them at p = 2."
    )
    columns, (height, width) = len(DEGREES), picture.pixels.shape
    tall = 2.3 * height / max(height, width) + 0.45
    figure = new_figure(2.5 * columns + 0.4, tall * (1 + len(GRAPHS)) + 1.1, "constrained")
    # separate subfigures, so that the tick labels of the counts do not move the pictures below
    halves: Any = figure.subfigures(2, 1, height_ratios=(1, len(GRAPHS)))
    above, below = halves
    grid = above.add_gridspec(1, columns)
    titles = ["(a) initial", f"(b) TV on $G_0$, lam = {LAM:g}", f"(c) TV on $G_0$, $w_1$, lam = {LAM:g}"]
    for k, (value, name) in enumerate(zip([picture.pixels, *(run.value for run in variation)], titles, strict=True)):
        show(above.add_subplot(grid[k]), Panel(name, value))
    _counts(above.add_subplot(grid[len(titles) :]), shown)
    for k, (axes, run) in enumerate(zip(below.subplots(len(GRAPHS), columns).flat, shown, strict=True)):
        show(axes, Panel(f"p = {run.p:g}: {run.counts.flat_zones} flat zones", run.value))
        if k % columns == 0:
            axes.set_ylabel(f"({'def'[k // columns]}) ${run.graph}$", fontsize=12)
    write_below(figure, caption(title, settings, see))
    found = numbers(inputs, shown) | {
        "until convergence": [
            {**run.numbers(), "lam": LAM, "stop": str(run.result.stop), "contrast kept": round(share, 4)}
            for run, share in zip(variation, kept, strict=True)
        ]
    }
    return Drawn(title, settings, see, found, figure)


def _zones(shown: list[Run], graph: str, p: float) -> int:
    return next(run.counts.flat_zones for run in shown if run.graph == graph and run.p == p)


def _counts(axes: Any, shown: list[Run]) -> None:
    """Plot the numbers of flat zones and main levels against p."""
    for name, line, what in (("flat_zones", "-", "flat zones"), ("main_levels", "--", "levels of 95 % of the pixels")):
        for k, graph in enumerate(GRAPHS):
            counted = [getattr(run.counts, name) for run in shown if run.graph == graph]
            axes.plot(counted, line, color=f"C{k}", marker="o", markersize=4, label=f"${graph}$: {what}")
    axes.set_xticks(range(len(DEGREES)), [f"{p:g}" for p in DEGREES])
    axes.set(yscale="log", xlabel="p")
    axes.grid(True, axis="y", color="#dddddd", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * 30)  # room for the legend
    axes.legend(frameon=False, fontsize=8, loc="upper right", ncols=2)
