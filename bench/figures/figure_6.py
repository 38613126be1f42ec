"""Figure 6: a noisy mesh, its positions regularized with p = 2 and w = 1/|u - v|^2, without fit term and with it."""

from __future__ import annotations

from typing import Any

import numpy as np

import gpureg as gr
from gpureg.mesh_io import read_mesh

from ..model import data

ITERATIONS = 8


def _pair(quick: bool) -> tuple[str, Any, Any]:
    """A name, a mesh and the same with noise: the bunny of the test data, or a torus."""
    clean, noisy = (data("meshes", f"bunny34834_{which}.ply") for which in ("original", "noisy02"))
    if not quick and clean is not None and noisy is not None:
        return "bunny, noise of 0.2 edges", *(_mesh(read_mesh(path)) for path in (clean, noisy))
    import trimesh

    torus = trimesh.creation.torus(2, 1, major_sections=60, minor_sections=30)
    vertices, faces = np.array(torus.vertices), np.array(torus.faces)
    noise = np.random.default_rng(6).normal(0, 0.2 * torus.edges_unique_length.mean(), (len(vertices), 1))
    return "torus, noise of 0.2 edges", (vertices, faces), (vertices + noise * torus.vertex_normals, faces)


def _mesh(file: Any) -> tuple[Any, Any]:
    return file.vertices, file.faces


def draw(quick: bool, backend: str) -> tuple[Any, dict[str, Any]]:
    """The figure and its numbers."""
    name, clean, noisy = _pair(quick)
    graph = gr.mesh_graph(*noisy)
    edge = float(np.linalg.norm(noisy[0][graph.edge_rows()] - noisy[0][graph.indices], axis=1).mean())
    # the door's rule for weights of 1, in the unit of these
    fit = 0.5 / (gr.estimate_mesh_noise(noisy) / edge) / edge**2
    settings = {"filter": "vertices", "weights": gr.weights.inverse_distance(2), "max_iter": ITERATIONS}
    drawn = {"original": clean, "noisy": noisy}
    for title, lam in (("lam = 0", 0.0), ("with the fit term", fit)):
        drawn[title] = gr.denoise_mesh(noisy, lam=lam, backend=backend, **settings)
    numbers: dict[str, Any] = {"mesh": name, "vertices": len(clean[0]), "iterations": ITERATIONS, "lam": [0.0, fit]}
    titles = {}
    for title, mesh in drawn.items():
        found = {
            "normal angle error": round(gr.metrics.normal_angle_error(mesh, clean), 3),
            "vertex error in edges": round(gr.metrics.vertex_error(mesh, clean), 4),
            "share of the volume": round(gr.metrics.volume(mesh) / gr.metrics.volume(clean), 4),
        }
        numbers[title] = found
        percent = 100 * found["share of the volume"]
        titles[f"{title}\n{found['normal angle error']:.1f} degrees, {percent:.1f} % of the volume"] = mesh
    caption = f"Figure 6: {name}; p = 2, w = 1/|u - v|^2, {ITERATIONS} iterations on the positions"
    return gr.plot.meshes(titles, caption=caption), numbers
