"""The table of doors for the metamorphic tests: a row says how to call a door, and on what.

To add a door, add a :class:`Subject` with a name to ``SUBJECTS``: a call, a way to make its input, the sort of the
input, and the distance over which one sample can have an effect. ``relations.py`` says what must hold for each sort.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import gpureg as gr

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Subject:
    """A door and its input.

    Attributes
    ----------
    call : callable
        ``call(values, unit, backend)`` runs the door on values that were multiplied by `unit`, with all parameters in
        the data's units multiplied by it too; the result has the shape of the values.
    sort : {"image", "colours", "graph"}
        An image (H, W), an image of separate channels (H, W, C), or a function on the vertices of a graph (n,).
    reach : int or None
        The distance, in pixels, beyond which a sample has no effect; None if there is no such distance.
    exact : bool
        Whether a power of two as the unit gives the same bits.
    without : tuple of str
        Relations that this call does not have, such as "flipped" for one with a place of its own.
    """

    call: Callable[[Array, float, str], Array]
    sort: str = "image"
    reach: int | None = None
    exact: bool = True
    without: tuple[str, ...] = ()


def picture(seed: int, shape: tuple[int, ...] = (24, 26)) -> Array:
    """Flat tiles of 0.3 to 1 with noise of 0.08, (H, W) or (H, W, C): float64 values that float32 holds exactly."""
    rng = np.random.default_rng(seed)
    tiles = rng.uniform(0.3, 1, tuple(-(-n // 8) for n in shape[:2]) + shape[2:])
    clean = np.kron(tiles, np.ones((8, 8, *(1,) * (len(shape) - 2))))[: shape[0], : shape[1]]
    return (clean + rng.normal(0, 0.08, shape)).astype(np.float32).astype(np.float64)


def _sides(values: Array) -> int:
    """Return the number of axes of an image."""
    return values.ndim


def _tv(values: Array, unit: float, backend: str) -> Array:
    return gr.denoise_tv(values, lam=12 / unit, eps=1e-3 * unit, max_iter=3, backend=backend)


def _tv_of_its_own(values: Array, unit: float, backend: str) -> Array:
    return gr.denoise_tv(values, lam=12 / unit, max_iter=30, tol=1e-3, backend=backend)


def _nl_means(values: Array, unit: float, backend: str) -> Array:
    h = 0.06 * unit * 3 ** (_sides(values) / 2)
    return gr.denoise_nl_means(values, patch_radius=1, radius=3, h=h, sigma=0.05 * unit, backend=backend)


def _bilateral(values: Array, unit: float, backend: str) -> Array:
    return gr.denoise_bilateral(values, radius=3, sigma_space=2, sigma_value=0.3 * unit, backend=backend)


def _default(values: Array, unit: float, backend: str) -> Array:
    # the filter alone: groups of patches are found on a lattice, which a flip moves
    return gr.denoise_image(values, passes=1, backend=backend)


def _with_sigma(values: Array, unit: float, backend: str) -> Array:
    return gr.denoise_image(values, sigma=0.08 * unit, radius=3, passes=1, backend=backend)


def _rough(values: Array, unit: float, backend: str) -> Array:
    options: dict[str, Any] = {"lam": 12 * unit**-1.5, "eps": 0.01 * unit, "max_iter": 3}
    return gr.denoise_image(values, p=0.5, norm="edge", backend=backend, **options)


def _inpainting(values: Array, unit: float, backend: str) -> Array:
    holes = np.zeros(values.shape, bool)
    holes[tuple(slice(n // 3, n // 3 + 2) for n in values.shape)] = True
    return gr.inpaint_image(values, holes, p=1, backend=backend, max_iter=40)


def _regions(values: Array, unit: float, backend: str) -> Array:
    return gr.simplify_image(values, sources=6, lam=0.5, max_iter=4, backend=backend).value


def _by_colour(values: Array, unit: float, backend: str) -> Array:
    return gr.denoise_tv(values, lam=12 / unit, coupled=False, max_iter=30, tol=1e-3, channel_axis=-1, backend=backend)


RING = gr.Graph.from_edges([(k, (k + step) % 40) for k in range(40) for step in (1, 7)])


def on_graph(values: Array, graph: gr.Graph, unit: float, backend: str, **options: Any) -> Array:
    """Regularize a function on a graph, with settings that do not depend on the data."""
    model: dict[str, Any] = {"p": 1, "lam": 6 / unit, "max_iter": 12, **options}
    return gr.regularize(values, graph, backend=backend, **model).value


SUBJECTS: dict[str, Subject] = {
    "denoise_image": Subject(_default),
    "denoise_image(sigma)": Subject(_with_sigma),
    "denoise_image(p=0.5)": Subject(_rough, reach=6, exact=False),
    "denoise_nl_means": Subject(_nl_means, reach=4),
    "denoise_bilateral": Subject(_bilateral, reach=3),
    "denoise_tv": Subject(_tv, reach=6),
    "denoise_tv(eps=None)": Subject(_tv_of_its_own),
    "inpaint_image": Subject(_inpainting, without=("flipped", "transposed", "thickened")),
    "simplify_image": Subject(_regions, without=("flipped", "transposed", "thickened")),
    "denoise_tv(coupled=False)": Subject(_by_colour, sort="colours"),
    "regularize": Subject(lambda values, unit, backend: on_graph(values, RING, unit, backend), sort="graph"),
    "regularize(certified)": Subject(
        lambda values, unit, backend: on_graph(values, RING, unit, backend, solver="certified", max_iter=30),
        sort="graph",
    ),
    "regularize(bilateral)": Subject(
        lambda values, unit, backend: on_graph(
            values, RING, unit, backend, weights=gr.weights.bilateral(float("inf"), 0.3 * unit)
        ),
        sort="graph",
    ),
}
