"""Figure 9: a polygon, its skeleton, and the skeleton after ten iterations on the polygon."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..curves.skeletons import simplify_skeleton
from ..graphs.csr import Graph
from ..plot import skeleton
from .inputs import Inputs
from .sheet import Drawn, caption

ITERATIONS, LAM = 10, 0.1


def draw(inputs: Inputs) -> Drawn:
    """Draw the figure, and return it with its numbers."""
    source = inputs.outline()
    found = simplify_skeleton(source.points, lam=LAM, max_iter=ITERATIONS, backend=inputs.backend)
    numbers: dict[str, Any] = {
        "polygon": source.name, "vertices": len(source.points), "iterations": ITERATIONS, "lam": LAM
    }  # fmt: skip
    # the polygon alone: a skeleton without edges
    bare = replace(
        found.before,
        graph=Graph(np.zeros(2, int), np.zeros(0, int), None, found.before.positions[:1]),
        radii=np.zeros(1),
    )
    shown = {f"the polygon, {len(source.points)} vertices": bare}
    for which, each in (("its skeleton", found.before), ("simplified", found.after)):
        told = {"branches": each.n_branches, "ends": each.n_ends, "junctions": each.n_junctions}
        numbers[which] = told
        shown[f"{which}: {told['branches']} branches, {told['ends']} ends"] = each
    before, after = numbers["its skeleton"], numbers["simplified"]
    title = "Figure 9. The skeleton of a polygon, simplified by smoothing the polygon"
    settings = (
        f"{source.name}; p = 2, w = 1, lam = {LAM:g}, {ITERATIONS} iterations on its vertices, then its skeleton "
        f"again. The paper does not give lam."
    )
    see = (
        f"{before['branches']} branches before, {after['branches']} after; in the paper those of smooth parts "
        f"are not affected, while the others are simplified."
    )
    figure = skeleton(shown, upright=source.upright, caption=caption(title, settings, see))
    return Drawn(title, settings, see, numbers, figure)
