"""Figure 8: a surface simplified by p < 1, to convergence: vertices that meet become one."""

from __future__ import annotations

from typing import Any

import numpy as np

import gpureg as gr
from gpureg.mesh_simplify import simplified
from gpureg.surface import Surface, surface_of

from ..model import data


def _mesh(quick: bool) -> tuple[str, Any]:
    """The fandisk of the test data, or a box with many vertices."""
    path = data("meshes", "fandisk_original.ply")
    if not quick and path is not None:
        read = gr.read_mesh(path)
        return "fandisk", (read.vertices, read.faces)
    import trimesh

    box = trimesh.creation.box((2, 1.4, 1))
    for _ in range(3 if quick else 4):
        box = box.subdivide()
    return "box", (np.array(box.vertices), np.array(box.faces))


def draw(quick: bool, backend: str) -> tuple[Any, dict[str, Any]]:
    """The figure and its numbers."""
    name, mesh = _mesh(quick)
    surface = surface_of(mesh)
    edges = surface.vertices[surface.faces] - surface.vertices[np.roll(surface.faces, -1, axis=1)]
    edge = float(np.linalg.norm(edges, axis=2).mean())
    made = {"to convergence": simplified(surface, backend=backend)}
    half = len(surface.vertices) // 2
    made[f"{half} vertices asked for"] = simplified(surface, n_vertices=half, backend=backend)
    drawn: dict[str, Any] = {"initial": (surface.vertices, surface.faces)}
    for title, found in made.items():
        drawn[title] = _pair(Surface(found.vertices, found.faces, surface.make))
    numbers: dict[str, Any] = {"mesh": name, "lam": 0.001, "p": 0.1}
    titles = {}
    for title, pair in drawn.items():
        told = {
            "vertices": len(pair[0]),
            "share of the volume": round(gr.metrics.volume(pair) / gr.metrics.volume(drawn["initial"]), 4),
            "Hausdorff distance in edges": round(gr.metrics.hausdorff(pair, drawn["initial"]) / edge, 3),
            "closed": gr.metrics.is_watertight(pair),
        }
        numbers[title] = told
        titles[
            f"{title}: {told['vertices']} vertices\nvolume {100 * told['share of the volume']:.1f} %, "
            f"Hausdorff distance {told['Hausdorff distance in edges']:.2f} edges"
        ] = pair
    caption = f"Figure 8: {name}; p = 0.1, lam = 0.001; vertices that meet become one, the surface stays closed"
    return gr.plot.meshes(titles, edges=True, caption=caption), numbers


def _pair(surface: Surface) -> tuple[Any, Any]:
    return surface.vertices, surface.faces
