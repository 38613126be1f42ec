"""The rows of the table: the kernels that are iterated, the filters of one step, and the doors that users call."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

import gpureg as gr
from gpureg import backends
from gpureg.backends import PatchForm, Smoothness

from ..iterations import Sweeps, scale_free
from ..model import SEED, data, peer, shared

Kind = Literal["iterated", "one step", "door"]


@dataclass(frozen=True)
class Row:
    """One kernel or door on data of one size.

    Attributes
    ----------
    name : str
        As in :data:`bench.gpu.counts.COUNTS`.
    kind : {"iterated", "one step", "door"}
    size : str
        The data, in words.
    vertices : int
    prepare : callable
        Takes the name of a device; gives a call that queues the work, and one that waits for it.
    bytes : float
        What a call must move at least, over all vertices; 0 for what no bandwidth limits.
    """

    name: str
    kind: Kind
    size: str
    vertices: int
    prepare: Callable[[str], tuple[Callable[[], Any], Callable[[], None]]]
    bytes: float = 0.0


def _function(n: int, m: int, seed: int = SEED) -> Any:
    return shared.rng(seed).random((n, m), dtype=np.float32)


def road_like(n: int) -> gr.Graph:
    """A seeded graph of mean degree 2.4, like roads: a lattice without half of its edges, in random order of blocks."""
    side = int(n**0.5)
    generator = shared.rng(SEED)
    number = np.arange(side * side).reshape(side, side)
    pairs = [number[:, :-1], number[:, 1:]], [number[:-1], number[1:]]
    edges = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in pairs])
    edges = edges[generator.random(len(edges)) < 0.6]
    weights = 0.5 + generator.random(len(edges), dtype=np.float32) / 2
    return gr.Graph.from_edges(edges, weights, n_vertices=side * side)


class _Arrays(Sweeps):
    """Functions and weights of a graph on a device, for the primitives of an iteration."""

    def __init__(self, device: str, graph: Any, channels: int, weights: Any) -> None:
        super().__init__(device, graph, weights, _function(graph.n_vertices, channels), lam=4.0)
        self.model = Smoothness(self.p, self.eps)

    @property
    def f(self) -> Any:
        """The current iterate."""
        return self.pair[0]

    @property
    def out(self) -> Any:
        """The other one."""
        return self.pair[1]

    def edges(self) -> Any:
        """A dual variable of zeros."""
        return self.backend.empty_edges(self.graph, 1)


_Work = Callable[[_Arrays], Callable[[], Any]]


def _iterated(name: str, work: _Work, graph: Any, moved: float, channels: int = 1, weights: Any = None) -> Row:
    """A row of a primitive; `moved` are the bytes of a vertex."""

    def prepare(device: str) -> tuple[Callable[[], Any], Callable[[], None]]:
        arrays = _Arrays(device, graph, channels, weights)
        return work(arrays), arrays.backend.finish

    n = graph.n_vertices
    size = " x ".join(map(str, graph.shape)) if isinstance(graph, gr.GridGraph) else f"{n} vertices"
    return Row(name, "iterated", size, n, prepare, moved * n)


def _dual(arrays: _Arrays) -> Callable[[], Any]:
    y, before = arrays.edges(), arrays.edges()
    on, f = arrays.backend, arrays.f

    def step() -> None:
        nonlocal y, before
        on.dual_step(arrays.weighted, y, before, f, f, arrays.model, beta=0.0, sigma=0.1)
        y, before = before, y

    return step


def _primal(arrays: _Arrays) -> Callable[[], Any]:
    y = arrays.edges()
    return lambda: arrays.backend.primal(arrays.weighted, y, arrays.f0, 4.0, out=arrays.out)


def _gap(arrays: _Arrays) -> Callable[[], Any]:
    y, model = arrays.edges(), Smoothness(1.0, 0.0)
    return lambda: arrays.backend.duality_gap(arrays.weighted, arrays.f, y, arrays.f0, 4.0, model)


def _dot(arrays: _Arrays) -> Callable[[], Any]:
    return lambda: arrays.backend.dot(arrays.graph, arrays.f, arrays.f0)


def _energy(arrays: _Arrays) -> Callable[[], Any]:
    return lambda: arrays.backend.energy(arrays.weighted, arrays.f, arrays.f0, 4.0, arrays.model)


def _combine(arrays: _Arrays) -> Callable[[], Any]:
    return lambda: arrays.backend.combine(arrays.graph, 1.0, arrays.f, 0.5, arrays.f0, out=arrays.out)


def iterated(side: int, depth: int, stored: int, hub: int) -> Iterator[Row]:
    """The kernels of iterations, on grids and on stored graphs."""
    grid, square = gr.GridGraph((side, side), 1, "cityblock"), gr.GridGraph((side, side), 1)
    weights = shared.half_weights(square).astype(np.float32)

    def sweep(arrays: _Arrays) -> Callable[[], Any]:
        return arrays  # a call is an iteration, recorded as a solver does

    yield _iterated("sweep, 4 neighbours", sweep, grid, 12)
    yield _iterated("sweep, 8 neighbours, weights", sweep, square, 28, weights=weights)
    yield _iterated("sweep, 4 neighbours, RGB", sweep, grid, 36, channels=3)
    volume = gr.GridGraph((depth,) * 3, 1, "cityblock")
    yield _iterated("sweep, volume, 6 neighbours", sweep, volume, 12)
    yield _iterated("dot", _dot, grid, 8)
    yield _iterated("energy", _energy, grid, 8)
    yield _iterated("combine", _combine, grid, 12)
    yield _iterated("dual step, p = 1", _dual, grid, 4 * (3 * 4 + 1))
    yield _iterated("primal", _primal, grid, 4 * (4 + 2))
    yield _iterated("duality gap, p = 1", _gap, grid, 4 * (4 + 2))
    path = data("graphs", "luxembourg_osm.mtx.gz")
    roads = {"CSR sweep, roads": road_like(stored), "CSR sweep, scale-free": scale_free(stored, hub)}
    if path is not None:
        roads["CSR sweep, Luxembourg"] = gr.read_graph(path, symmetrize="max")
    for name, graph in roads.items():
        # an index and a weight for each directed edge, f, f0, the result
        yield _iterated(name, sweep, graph, 8 * graph.n_edges / graph.n_vertices + 16)


def one_step(side: int) -> Iterator[Row]:
    """Filters of one step, from array to array on the device where the backend takes one."""
    grid, patch = gr.GridGraph((side, side), 10), np.ones(7)
    spatial = np.exp(-(np.linalg.norm(grid.forward_offsets, axis=1) ** 2) / 18)
    forms = {
        "nonlocal means, 7x7": (PatchForm(patch, 0.0, 0.02), 1),
        "nonlocal means, 7x7, averaged": (PatchForm(patch, 0.0, 0.02, average=1), 1),
        "nonlocal means, 7x7, RGB": (PatchForm(patch, 0.0, 0.02), 3),
        "bilateral, 21x21": (PatchForm(np.ones(1), 0.0, 25.0, spatial), 1),
    }
    for name, (form, m) in forms.items():

        def prepare(device: str, form: PatchForm = form, m: int = m) -> tuple[Callable[[], Any], Callable[[], None]]:
            on = backends.get(device, np.float32)
            f0, out = on.put(grid, _function(grid.n_vertices, m)), on.empty(grid, m)
            lam: Any = 2.0
            if form.average:
                if not on.averages:
                    raise backends.BackendUnavailable("this backend averages stored weights")
                lam = on.put(grid, np.full((grid.n_vertices, 1), 9.0))
            return lambda: on.similarity_step(grid, f0, form, f0, lam, out=out), on.finish

        yield Row(name, "one step", f"{side} x {side}", grid.n_vertices, prepare, 8.0 * m * grid.n_vertices)


def picture(side: int, channels: int) -> Any:
    """A tiled picture of 0..255 with noise of 20, float32."""
    skimage = peer("skimage.data")
    y, x = np.mgrid[:512, :512] / 512
    clean = 40 + 120 * ((x - 0.5) ** 2 + (y - 0.4) ** 2 < 0.09) + 80 * (x + y > 1.2)
    if skimage is not None:
        clean = skimage.camera() if channels == 1 else skimage.astronaut()
    clean = np.tile(clean, (-(-side // 512), -(-side // 512), *(1,) * (clean.ndim - 2)))[:side, :side]
    if channels > 1 and clean.ndim == 2:
        clean = np.stack([clean] * channels, axis=-1)
    return (clean + 20 * shared.rng(SEED).standard_normal(clean.shape)).astype(np.float32)


def doors(side: int, large: int) -> Iterator[Row]:
    """Public calls, from a numpy array to a numpy array."""

    def row(name: str, call: Callable[[str, Any], Any], side: int, channels: int = 1) -> Row:
        def prepare(device: str) -> tuple[Callable[[], Any], Callable[[], None]]:
            image = picture(side, channels)
            return lambda: call(device, image), lambda: None

        return Row(name, "door", f"{side} x {side}", side * side, prepare)

    def fast(device: str, image: Any) -> Any:
        return gr.denoise_image(image, quality="fast", backend=device)

    for size in (side, large):
        yield row("denoise_image, grey, quality fast", fast, size)
        yield row("denoise_image, grey", lambda b, x: gr.denoise_image(x, backend=b), size)
    yield row("denoise_image, RGB", lambda b, x: gr.denoise_image(x, channel_axis=-1, backend=b), side, 3)
    yield row("denoise_image, grey, device array", _on_device, side)

    def certified(device: str, image: Any) -> Any:
        grid = gr.GridGraph(image.shape, 1, "cityblock")
        solver = gr.Certified(tol=1e-3)
        return gr.regularize(image / 255, grid, p=1, lam=28, solver=solver, max_iter=5000, backend=device)

    yield row("certified total variation, gap 1e-3", certified, side)


def _on_device(device: str, image: Any) -> Any:
    """The filter of an array that is on the device already, and stays there."""
    if device.startswith("warp"):
        import warp as wp

        found = wp.array(image, device=device.partition(":")[2])
    elif device.startswith("opencl"):
        import pyopencl.array as cl_array

        found = cl_array.to_device(backends.get(device)._shared.queue, image)
    else:
        raise backends.BackendUnavailable("numpy has no arrays elsewhere")
    result = gr.denoise_image(found)
    if isinstance(result, np.ndarray):
        raise backends.BackendUnavailable("the result came back as numpy's")
    return result


def opencv_seconds(side: int) -> Iterator[tuple[str, Callable[[], Any]]]:
    """The like by OpenCV on the CPU: nonlocal means of 8-bit pictures, the bilateral filter of float32."""
    cv2 = peer("cv2")
    if cv2 is None:
        return
    grey, colour = picture(side, 1), picture(side, 3)
    eight, eights = (np.clip(x, 0, 255).astype(np.uint8) for x in (grey, colour))
    yield "OpenCV nonlocal means 7x7 in 21x21, 8-bit grey", lambda: cv2.fastNlMeansDenoising(eight, None, 14, 7, 21)
    yield "OpenCV the same, 8-bit RGB", lambda: cv2.fastNlMeansDenoisingColored(eights, None, 14, 14, 7, 21)
    yield "OpenCV bilateral 21x21, float32", lambda: cv2.bilateralFilter(grey, 21, 50, 5)
