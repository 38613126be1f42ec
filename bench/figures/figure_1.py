"""Figure 1: local, semilocal and nonlocal smoothing for p from 2 to 0.01, and total variation until convergence."""

from __future__ import annotations

from typing import Any

import gpureg as gr

from .levelling import DEGREES, GRAPHS, ITERATIONS, SIDES, Run, camera, count, grid_of, numbers, runs

# Fidelity of (b) and (c), per grey level, the tolerance that is taken for convergence, and the sweeps allowed for it.
LAM, TOLERANCE, MOST = 0.02, 1e-6, 20000


def total_variation(side: int, backend: str) -> list[Run]:
    """(b) and (c): p = 1 on G_0 without and with weights, the same fidelity."""
    picture, done = camera(side), []
    for name, weights in (("G_0", None), ("G_0, w_1", gr.weights.bilateral(4, 20))):
        result = gr.regularize(
            picture, grid_of("G_0", side), p=1, lam=LAM, weights=weights, tol=TOLERANCE, max_iter=MOST, backend=backend
        )
        done.append(Run(name, 1.0, result.value, count(result.value), result))
    return done


def draw(quick: bool, backend: str) -> tuple[Any, dict[str, Any]]:
    """The figure and its numbers."""
    from matplotlib.figure import Figure

    side = SIDES[quick]
    shown, variation = runs(side, backend), total_variation(side, backend)
    columns = len(DEGREES)
    figure = Figure(figsize=(2.5 * columns + 0.4, 2.75 * (1 + len(GRAPHS)) + 0.3), dpi=110, layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1, len(GRAPHS)))
    titles = ["(a) initial", f"(b) TV on $G_0$, λ = {LAM:g}", f"(c) TV on $G_0$, $w_1$, λ = {LAM:g}"]
    grid = above.add_gridspec(1, 2 * len(titles))
    for k, (value, title) in enumerate(zip([camera(side), *(run.value for run in variation)], titles, strict=True)):
        _panel(above.add_subplot(grid[k]), value, title)
    _counts(above.add_subplot(grid[len(titles) :]), shown)
    for k, (axes, run) in enumerate(zip(below.subplots(len(GRAPHS), columns).flat, shown, strict=True)):
        _panel(axes, run.value, f"p = {run.p:g}: {run.counts.flat_zones} flat zones")
        if k % columns == 0:
            axes.set_ylabel(f"({'def'[k // columns]}) ${run.graph}$", fontsize=12)
    figure.suptitle(f"Figure 1: (d) to (f) λ = 0, {ITERATIONS} iterations of (31)", fontsize=13)
    return figure, numbers(side, shown) | {
        "until convergence": [{**run.numbers(), "lam": LAM, "stop": str(run.result.stop)} for run in variation]
    }


def _panel(axes: Any, value: Any, title: str) -> None:
    axes.imshow(value, cmap="gray", vmin=0, vmax=255)
    axes.set_title(title, fontsize=10)
    axes.set(xticks=[], yticks=[])


def _counts(axes: Any, shown: list[Run]) -> None:
    """Flat zones and main levels against p."""
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
