"""Figure 2: the results of figure 1 for p < 1 in false colours, one for each grey level."""

from __future__ import annotations

import numpy as np

from .inputs import Inputs
from .levelling import GRAPHS, ITERATIONS, WEIGHTS, numbers, runs
from .sheet import Drawn, Panel, caption, pictures


def draw(inputs: Inputs) -> Drawn:
    """Draw the figure, and return it with its numbers."""
    shown = [run for run in runs(inputs) if run.p < 1]
    columns = len(shown) // len(GRAPHS)
    # random colours, so that neighbouring levels differ
    palette = np.random.default_rng(0).integers(40, 256, (256, 3)).astype(np.float64)
    panels = [
        Panel(
            f"p = {run.p:g}: {run.counts.levels} levels,\n{run.counts.flat_zones} flat zones",
            palette[np.clip(np.rint(run.value), 0, 255).astype(int)],
        )
        for run in shown
    ]
    found = numbers(inputs, shown)
    title = "Figure 2. Figure 1 for p < 1 in false colours: a colour for each grey level"
    settings = f"{found['picture']}; lam = 0, {ITERATIONS} iterations. {WEIGHTS}; eps = 2.55."
    ends = [[run.counts for run in shown if run.graph == graph] for graph in GRAPHS]
    see = (
        "One colour is one level. Levels that hold 95 % of the pixels, from p = "
        f"{shown[0].p:g} to {shown[columns - 1].p:g}: "
        + ", ".join(
            f"{counts[0].main_levels} to {counts[-1].main_levels} on {graph}"
            for graph, counts in zip(GRAPHS, ends, strict=True)
        )
        + ". The large neighbourhoods level the picture as a whole, far apart pixels alike; G_0 levels it zone by zone."
    )
    rows = [panels[k : k + columns] for k in range(0, len(panels), columns)]
    figure = pictures(rows, caption(title, settings, see), [f"${graph}$" for graph in GRAPHS])
    return Drawn(title, settings, see, found, figure)
