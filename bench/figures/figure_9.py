"""Figure 9: the skeleton of a polygon, before and after ten iterations on its vertices."""

from __future__ import annotations

from typing import Any

import gpureg as gr

from ..model import data

ITERATIONS, LAM = 10, 0.1


def _polygon(quick: bool) -> tuple[str, Any]:
    """An elephant's outline of the test data, or scikit-image's horse."""
    path = data("curves", "mpeg7_elephant_5.csv")
    if not quick and path is not None:
        return "elephant", gr.read_curves(path).curves[0].points
    import skimage.data
    from skimage.measure import find_contours

    outline = max(find_contours(~skimage.data.horse(), 0.5), key=len)[:-1, ::-1]
    return "horse", outline[:: 4 if quick else 1]


def draw(quick: bool, backend: str) -> tuple[Any, dict[str, Any]]:
    """The figure and its numbers."""
    name, polygon = _polygon(quick)
    found = gr.simplify_skeleton(polygon, lam=LAM, max_iter=ITERATIONS, backend=backend)
    numbers: dict[str, Any] = {"polygon": name, "vertices": len(polygon), "iterations": ITERATIONS, "lam": LAM}
    shown = {}
    for which, skeleton in (("before", found.before), ("after", found.after)):
        told = {"branches": skeleton.n_branches, "ends": skeleton.n_ends, "junctions": skeleton.n_junctions}
        numbers[which] = told
        shown[f"{which}: {told['branches']} branches, {told['ends']} ends"] = skeleton
    caption = f"Figure 9: {name}; p = 2, w = 1, lam = {LAM}, {ITERATIONS} iterations on the polygon"
    return gr.plot.skeleton(shown, upright=False, caption=caption), numbers
