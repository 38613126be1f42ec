"""Figure 6: a noisy mesh, its positions regularized with p = 2 and w = 1/|u - v|^2, without fit term and with it."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import metrics
from ..graphs.of_shapes import mesh_graph
from ..meshes.denoise import denoise_mesh
from ..meshes.noise import estimate_mesh_noise
from ..plot import meshes
from ..shapes.surface import surface_of, vertex_normals
from ..weights import inverse_distance
from .inputs import Inputs, Pair
from .sheet import Drawn, caption, share

ITERATIONS = 8
# Noise along the normals, in units of the mean edge.
NOISE = 0.2


def draw(inputs: Inputs) -> Drawn:
    """Draw the figure, and return it with its numbers."""
    source = inputs.surface(cad=False)
    # an STL stores the vertices of each face separately
    surface, _ = surface_of(source.mesh).welded()
    mesh: Pair = (surface.vertices, surface.faces)
    edge = mean_edge(mesh)
    drawn = {"original": mesh} if inputs.noise else {}
    if inputs.noise:
        noise = np.random.default_rng(6).normal(0, NOISE * edge, (len(mesh[0]), 1))
        mesh = (mesh[0] + noise * vertex_normals(*mesh), mesh[1])
    drawn |= {"noisy": mesh}
    # the rule of denoise_mesh for weights of 1, in the unit of these weights; noise of at least 0.001 edges
    fit = 0.5 / max(estimate_mesh_noise(mesh) / edge, 1e-3) / edge**2
    for name, lam in (("lam = 0", 0.0), ("with the fit term", fit)):
        drawn[name] = denoise_mesh(
            mesh, filter="positions", weights=inverse_distance(2), lam=lam, max_iter=ITERATIONS, backend=inputs.backend
        )
    first = next(iter(drawn.values()))
    numbers: dict[str, Any] = {"mesh": source.name, "vertices": len(mesh[0]), "iterations": ITERATIONS, "lam": [0, fit]}
    titles = {}
    for name, each in drawn.items():
        told = {"share of the volume": share(metrics.volume(each), metrics.volume(first))}
        words = [f"volume {100 * told['share of the volume']:.1f} %"]
        if inputs.noise:
            told["normal angle error"] = round(metrics.normal_angle_error(each, first), 3)
            told["vertex error in edges"] = round(metrics.vertex_error(each, first), 4)
            words.insert(0, f"normals off by {told['normal angle error']:.1f} degrees")
        numbers[name] = told
        titles[f"{name}\n{', '.join(words)}"] = each
    free, fitted = numbers["lam = 0"], numbers["with the fit term"]
    title = "Figure 6. A mesh denoised by the positions of its vertices"
    noise_said = f", noise of {NOISE:g} mean edges along the normals" if inputs.noise else ""
    settings = (
        f"{source.name}, {len(mesh[0])} vertices{noise_said}; p = 2, w = 1/|u - v|^2, {ITERATIONS} iterations; "
        f"lam = 0 and, with the fit term, {fit * edge**2:.3g} over the mean edge squared, from the noise. The paper "
        f"does not give its lam."
    )
    see = (
        f"With the fit term {100 * fitted['share of the volume']:.1f} % of the volume are left, without it "
        f"{100 * free['share of the volume']:.1f} %."
    )
    if inputs.noise:
        see += (
            f" Vertices are {numbers['noisy']['vertex error in edges']:.3f} edges from their place before, "
            f"{free['vertex error in edges']:.3f} without, {fitted['vertex error in edges']:.3f} with it."
        )
    return Drawn(title, settings, see, numbers, meshes(titles, caption=caption(title, settings, see)))


def mean_edge(mesh: Pair) -> float:
    """Compute the mean length of the edges."""
    graph = mesh_graph(*mesh)
    return float(np.linalg.norm(mesh[0][graph.edge_rows()] - mesh[0][graph.indices], axis=1).mean())
