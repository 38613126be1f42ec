"""Calls of the public doors on tiny data: between them they build every program that a public call builds on a device.

A door that gets a kernel of its own, or an option that changes a kernel, gets a line here.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import cases
import numpy as np

import gpureg as gr

Door = Callable[[str], Any]

SHAPE = (24, 40)
# More than 32 pixels along each axis, so that passes follow.
WIDE = (40, 48)


@functools.cache
def image(shape: tuple[int, ...]) -> Any:
    """A step from dark to bright with noise of 0.05, float32."""
    values = np.where(np.arange(shape[1]) > shape[1] // 2, 0.75, 0.25)
    values = np.broadcast_to(values.reshape(1, -1, *(1,) * (len(shape) - 2)), shape)
    return (values + 0.05 * cases.rng(3).standard_normal(shape)).astype(np.float32)


@functools.cache
def points() -> tuple[Any, Any]:
    """A random cloud, (150, 3), and its 6 nearest neighbours."""
    positions = cases.rng(5).random((150, 3))
    return positions, gr.knn_graph(positions, 6)


def _grid(radius: float = 1, metric: str = "cityblock", shape: tuple[int, ...] = SHAPE) -> Any:
    return gr.GridGraph(shape, radius, metric)


def _on_grid(p: float, grid: Any = None, **options: Any) -> Door:
    def call(backend: str) -> Any:
        given = {"lam": 4, "max_iter": 2, "tol": 1e-9} | options
        return gr.regularize(image(SHAPE), grid or _grid(), p=p, backend=backend, **given)

    return call


def _on_points(p: float, channels: int = 3, **options: Any) -> Door:
    def call(backend: str) -> Any:
        positions, graph = points()
        given = {"lam": 4, "max_iter": 2, "tol": 1e-9} | options
        return gr.regularize(positions[:, :channels], graph, p=p, backend=backend, **given)

    return call


def _image(door: Callable[..., Any], shape: tuple[int, ...] = SHAPE, **options: Any) -> Door:
    if len(shape) == 3 and shape[2] == 3:
        options["channel_axis"] = -1
    return lambda backend: door(image(shape), backend=backend, **options)


def _mesh(backend: str) -> Any:
    vertices, faces = sphere()
    return gr.denoise_mesh(vertices, faces, backend=backend)


@functools.cache
def sphere() -> tuple[Any, Any]:
    """A sphere of 162 vertices with noise."""
    import trimesh

    mesh = trimesh.creation.icosphere(2)
    noise = 0.01 * cases.rng(7).standard_normal(mesh.vertices.shape)
    return np.asarray(mesh.vertices) + noise, np.asarray(mesh.faces)


def _labels(backend: str) -> Any:
    _, graph = points()
    labels = np.full(graph.n_vertices, -1)
    labels[:2] = 0, 1
    return gr.propagate_labels(labels, graph, p=1.5, max_iter=2, backend=backend)


def _compared_points(backend: str) -> Any:
    positions, graph = points()
    values = gr.weights.patch(0, h=0.3)
    return gr.regularize(positions[:, 0], graph, p=1, lam=4, weights=values, max_iter=2, backend=backend)


LAM = np.where(np.indices(SHAPE).sum(axis=0) % 3, 4.0, np.inf)
PATCH = gr.weights.patch(2, h=0.3, sigma=0.05)

DOORS: dict[str, Door] = {
    # filters of one step
    "image": _image(gr.denoise_image, quality="fast"),
    "colours": _image(gr.denoise_image, (*SHAPE, 3), quality="fast"),
    "colours, float64": _image(gr.denoise_image, (*SHAPE, 3), quality="fast", dtype="float64"),
    "volume": _image(gr.denoise_image, (6, 12, 14), quality="fast", sigma=0.05),
    "sigma map": _image(gr.denoise_image, sigma=np.full(SHAPE, 0.05)),
    "mask": _image(gr.denoise_image, mask=LAM < 5, quality="fast"),
    "nonlocal means": _image(gr.denoise_nl_means),
    "nonlocal means, averaged": _image(gr.denoise_nl_means, average_patches=True),
    "nonlocal means, colours": _image(gr.denoise_nl_means, (*SHAPE, 3)),
    "bilateral": _image(gr.denoise_bilateral),
    "bilateral, colours": _image(gr.denoise_bilateral, (*SHAPE, 3)),
    # passes with groups of patches
    "passes": _image(gr.denoise_image, WIDE, sigma=0.05, passes=3),
    "passes, colours": _image(gr.denoise_image, (*WIDE, 3), sigma=0.05, passes=3),
    "passes, volume": _image(gr.denoise_image, (8, 34, 34), sigma=0.05, passes=2),
    # iterations on a grid
    "total variation": _image(gr.denoise_tv, max_iter=3),
    "total variation, colours": _image(gr.denoise_tv, (*SHAPE, 3), max_iter=3),
    "grid, p = 2": _on_grid(2),
    "grid, p = 1": _on_grid(1),
    "grid, p = 1, lam by pixel": _on_grid(1, lam=LAM),
    "grid, p = 1, all 8": _on_grid(1, _grid(1, "chebyshev")),
    "grid, p = 0.7": _on_grid(0.7),
    "grid, p = 3": _on_grid(3),
    "grid, p = 1, edges": _on_grid(1, norm="edge"),
    "grid, gamma": _on_grid(1, gamma="normalized"),
    "grid, Euler": _on_grid(1, solver="euler"),
    "grid, accelerated": _on_grid(1, solver=gr.Jacobi(accelerate=True), max_iter=9),
    "grid, float64": _on_grid(1, dtype="float64"),
    "volume, p = 1": lambda backend: gr.regularize(
        image((5, 8, 9)), _grid(shape=(5, 8, 9)), p=1, lam=4, max_iter=2, backend=backend
    ),
    "nonlocal total variation": _on_grid(1, _grid(4, "chebyshev"), weights=PATCH, lam=20),
    "k nearest patches": _image(gr.denoise_image, p=1, weights="patch", k=6, max_iter=2),
    "inpainting": _image(gr.inpaint_image, missing=LAM > 5, max_iter=3),
    # certified
    "certified, p = 1": _on_grid(1, solver="certified", max_iter=20),
    "certified, p = 1.5": _on_grid(1.5, solver="certified", max_iter=20),
    "certified, p = 2": _on_grid(2, solver="certified", max_iter=20),
    "certified, p = 3": _on_grid(3, solver="certified", max_iter=20),
    # a stored graph
    "points, p = 1": _on_points(1),
    "points, p = 2": _on_points(2),
    "points, float64": _on_points(1, dtype="float64"),
    "points, gamma": _on_points(1, gamma="normalized"),
    "points, edges": _on_points(1, 1, norm="edge"),
    "points, Euler": _on_points(1, 1, solver="euler"),
    "points, certified, p = 1": _on_points(1, 1, solver="certified", max_iter=20),
    "points, certified, p = 2": _on_points(2, 1, solver="certified", max_iter=20),
    "points, certified, p = 1.5": _on_points(1.5, 1, solver="certified", max_iter=5),
    "points, weights of values": _compared_points,
    "cloud": lambda backend: gr.denoise_points(points()[0], backend=backend),
    "mesh": _mesh,
    "labels": _labels,
    # partitions
    "simplified": _image(gr.simplify_image, p=2, lam=0.05),
    "regions": _image(gr.simplify_image, (*SHAPE, 3), p=1, lam=0.05),
}
"""Every door by a name that says what is special of it; each takes the name of a backend."""
