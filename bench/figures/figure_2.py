"""Figure 2: the results of figure 1 for p < 1 in false colours, one for each grey level."""

from __future__ import annotations

from typing import Any

import numpy as np

from .levelling import GRAPHS, SIDES, numbers, runs


def draw(quick: bool, backend: str) -> tuple[Any, dict[str, Any]]:
    """The figure and its numbers."""
    from matplotlib.colors import hsv_to_rgb
    from matplotlib.figure import Figure

    side = SIDES[quick]
    shown = [run for run in runs(side, backend) if run.p < 1]
    columns = len(shown) // len(GRAPHS)
    # neighbouring levels get colours that are far apart
    order = np.random.default_rng(0).permutation(256) / 256
    palette = hsv_to_rgb(np.stack([order, 0.45 + 0.55 * order[::-1], 0.6 + 0.4 * np.roll(order, 128)], axis=-1))
    figure = Figure(figsize=(3 * columns + 0.3, 3.2 * len(GRAPHS) + 0.3), dpi=110, layout="constrained")
    for k, (axes, run) in enumerate(zip(figure.subplots(len(GRAPHS), columns).flat, shown, strict=True)):
        axes.imshow(palette[np.clip(np.rint(run.value), 0, 255).astype(int)], interpolation="nearest")
        c = run.counts
        axes.set_title(f"p = {run.p:g}: {c.levels} levels, {c.flat_zones} flat zones", fontsize=10)
        axes.set(xticks=[], yticks=[])
        if k % columns == 0:
            axes.set_ylabel(f"${run.graph}$", fontsize=12)
    figure.suptitle("Figure 2: figure 1 for p < 1, a colour for each grey level", fontsize=13)
    return figure, numbers(side, shown)
