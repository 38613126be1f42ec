"""Figure 8: a surface simplified with p < 1, to convergence; vertices that meet are merged."""

from __future__ import annotations

from typing import Any

from .. import metrics
from ..meshes.simplify import simplified
from ..plot import meshes
from ..shapes.surface import surface_of
from ..weights import constant
from .fig6 import mean_edge
from .inputs import Inputs
from .sheet import Drawn, caption, share

P, LAM = 0.1, 0.001


def draw(inputs: Inputs) -> Drawn:
    """Draw the figure, and return it with its numbers."""
    source = inputs.surface(cad=True)
    # an STL stores the vertices of each face separately
    surface, _ = surface_of(source.mesh).welded()
    first = (surface.vertices, surface.faces)
    edge = mean_edge(first)
    made = {
        "w = 1": simplified(surface, p=P, lam=LAM, weights=constant(), backend=inputs.backend),
        "w by the normals": simplified(surface, p=P, lam=LAM, backend=inputs.backend),
    }
    drawn: dict[str, Any] = {"initial": first} | {name: (found.vertices, found.faces) for name, found in made.items()}
    numbers: dict[str, Any] = {"mesh": source.name, "lam": LAM, "p": P}
    titles = {}
    for name, pair in drawn.items():
        told: dict[str, Any] = {
            "vertices": len(pair[0]),
            "share of the volume": share(metrics.volume(pair), metrics.volume(first)),
            "Hausdorff distance in edges": round(metrics.hausdorff(pair, first) / edge, 3),
            "closed": metrics.is_watertight(pair),
        }
        if name in made:
            told["iterations"] = [result.iterations for result in made[name].results]
        numbers[name] = told
        titles[
            f"{name}: {told['vertices']} vertices\nvolume {100 * told['share of the volume']:.1f} %, "
            f"Hausdorff distance {told['Hausdorff distance in edges']:.2f} edges"
        ] = pair
    ones, normals, before = numbers["w = 1"], numbers["w by the normals"], numbers["initial"]
    title = "Figure 8. A surface simplified: for p < 1 its vertices meet, and those that meet are one"
    settings = (
        f"{source.name}; p = {P:g}, lam = {LAM:g} in mean edges, to convergence; with w = 1, as in the paper, which "
        f"does not give p, and with the weights that simplify_mesh takes by itself. Vertices closer than a tenth of "
        f"the mean edge have met; edges between them are collapsed where the surface stays one."
    )
    see = (
        f"Of {before['vertices']} vertices {ones['vertices']} are left, {100 * ones['share of the volume']:.1f} % of "
        f"the volume, {'closed' if ones['closed'] else 'open'} as before, {ones['Hausdorff distance in edges']:.2f} "
        f"edges off at most; with weights by the normals, which are for creases, {normals['vertices']} vertices and "
        f"{normals['Hausdorff distance in edges']:.2f} edges."
    )
    return Drawn(title, settings, see, numbers, meshes(titles, edges=True, caption=caption(title, settings, see)))
