"""The case list: what is timed, beside whom, and what must agree before a time is printed.

A case is a function that takes a :class:`Setup` and gives :class:`Entry` objects, ours and the peers', one per row of
the table. To add one: a function here and its name in ``CASES``.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

import gpureg as gr
from gpureg import backends

Image = npt.NDArray[Any]

SEED = 7
EXTRA = "pip install 'gpureg[bench]'"

# Relative to the data's range: float32 sums of 8 neighbours and conductances up to 1/eps, against float64.
SWEEP_TOLERANCE = 1e-4
# Grey levels, notes on the peers, "Benchmarks": half a level is OpenCV's rounding of its result.
OPENCV_TOLERANCE = 0.54


@dataclass
class Setup:
    """What all cases share.

    Parameters
    ----------
    quick : bool
        Small sizes, to see that everything runs; the times mean little.
    devices : list of str
        Names of our devices that are wanted.
    """

    quick: bool
    devices: list[str]

    def picture(self, side: int) -> tuple[Image, str]:
        """A clean picture of 0..255, (side, side) float64, and its name; drawn where scikit-image is missing."""
        skimage = peer("skimage.data")
        if skimage is None:
            y, x = np.mgrid[:side, :side] / side
            return 40 + 120 * ((x - 0.5) ** 2 + (y - 0.4) ** 2 < 0.09) + 80 * (x + y > 1.2), "a drawn disk and edge"
        camera = skimage.camera().astype(np.float64)
        if side <= len(camera):
            step = len(camera) // side
            return camera[::step, ::step], "camera"
        return np.tile(camera, (side // len(camera),) * 2), "camera, tiled"


@dataclass
class Entry:
    """A row of the table: one way to do the work of a case.

    Parameters
    ----------
    who : str
        A device of ours, or a peer.
    call : callable or None
        Does the work once; None where it cannot be done, and `note` says why.
    finish : callable
        Waits until the work asked for is done.
    check : callable or None
        Gives whether the result agrees with the reference, and a sentence; called before timing.
    bytes : float or None
        Bytes that one call must move at least, each array counted once per pass.
    is_peer : bool
        Whether our times are divided by this one's.
    note : str
    """

    who: str
    call: Callable[[], Any] | None
    finish: Callable[[], Any] = lambda: None
    check: Callable[[], tuple[bool, str]] | None = None
    bytes: float | None = None
    is_peer: bool = False
    note: str = ""


@dataclass
class Case:
    """Rows that do the same work.

    Parameters
    ----------
    name, work : str
        A short name, and what one call does.
    entries : list of Entry
    notes : list of str
        What a reader must know of the numbers.
    """

    name: str
    work: str
    entries: list[Entry]
    notes: list[str] = field(default_factory=list)


def peer(module: str) -> Any:
    """A peer's module, or None where it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        return None


def _missing(who: str) -> Entry:
    return Entry(who, None, is_peer=True, note=f"not installed: {EXTRA}")


def _psnr(image: Image, clean: Image, peak: float) -> float:
    return 10 * math.log10(peak**2 / float(((image - clean) ** 2).mean()))


class _Sweeps:
    """Iterations of p = 1 on one device, from array to array that stay there."""

    def __init__(self, device: str, graph: Any, weights: Any, f0: Image, dtype: Any = np.float32) -> None:
        self.graph, self.backend = graph, backends.get(device, dtype)
        if isinstance(weights, gr.weights.Weights):
            self.weighted = weights.prepare(self.backend, graph, f0)
        else:
            self.weighted = self.backend.prepare(graph, weights)
        self.f0 = self.backend.put(graph, f0)
        self.f, self.out = self.backend.put(graph, f0), self.backend.empty(graph, 1)
        self.g = self.backend.empty(graph, 1)

    def __call__(self) -> None:
        self.backend.sweep(
            self.weighted, self.f, self.f0, 1.0, p=1.0, eps=1e-3, coupled=True, theta=1.0, g=self.g, out=self.out
        )
        self.f, self.out = self.out, self.f

    def value(self) -> Image:
        """The current iterate, on the host."""
        return self.backend.get(self.graph, self.f)

    def differs_from(self, reference: Image) -> tuple[bool, str]:
        """Whether the first iteration agrees with that of numpy in float64."""
        self()
        difference = float(np.abs(self.value() - reference).max())
        return difference <= SWEEP_TOLERANCE, f"{difference:.1e} from numpy float64 (at most {SWEEP_TOLERANCE:g})"


def iteration(setup: Setup) -> Iterator[Case]:
    """One p = 1 iteration, on a grid and on the same graph as CSR, beside one sparse product of scipy."""
    side = 128 if setup.quick else 1024
    clean, name = setup.picture(side)
    noise = np.random.default_rng(SEED).normal(0, 20, clean.shape)
    f0 = ((clean + noise) / 255).astype(np.float32).reshape(-1, 1)
    grid = gr.GridGraph((side, side), 1)
    w1 = gr.weights.bilateral(2.0, 0.2)
    oracle = backends.get("numpy", np.float32)
    half = oracle.get_weights(w1.prepare(oracle, grid, f0))
    graph = grid.to_graph(half)
    exact = _Sweeps("numpy", grid, half, f0, np.float64)
    exact()
    reference = exact.value()

    matrix = graph.to_scipy().astype(np.float32)
    # 32-bit indices are enough here and the best scipy can do
    matrix.indices, matrix.indptr = matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)
    vector = f0[:, 0].copy()
    n, edges = grid.n_vertices, graph.n_edges
    product_bytes = matrix.data.nbytes + matrix.indices.nbytes + matrix.indptr.nbytes + 2 * vector.nbytes
    # Numbers of 4 bytes. Gradient norm: the weights and f in, g out. Jacobi step: the weights, f, f0, g in, f out.
    functions = 4 * n * (2 + 4)
    layouts = {
        "grid": (grid, functions + 2 * 4 * n * grid.half_window),
        # indptr is counted as 4 bytes, whatever a device makes of it
        "CSR": (graph, functions + 2 * (4 * edges + 4 * edges + 4 * n)),
    }
    for kind, (layout, traffic) in layouts.items():
        entries = [
            Entry("scipy CSR product", lambda: matrix @ vector, bytes=product_bytes, is_peer=True, note="one thread")
        ]
        for device in setup.devices:
            sweeps = _Sweeps(device, layout, w1 if kind == "grid" else None, f0)
            entries.append(
                Entry(
                    device,
                    sweeps,
                    sweeps.backend.finish,
                    lambda sweeps=sweeps: sweeps.differs_from(reference),
                    traffic,
                )
            )
        per_vertex = traffic / n
        yield Case(
            f"iteration-{kind.lower()}",
            f"one p = 1 iteration, {side}x{side}, 8 neighbours, bilateral weights, as {kind}",
            entries,
            [
                f"picture: {name}, noise of standard deviation 20 of 255; weights made and arrays on the device before",
                f"bytes per vertex: {per_vertex:.0f} in the two passes, {product_bytes / n:.0f} in scipy's product",
            ],
        )


def _fast_mode_formula(f: Image, part: tuple[slice, slice], k: int, radius: int, H: float) -> Image:
    """What scikit-image's fast mode computes in a part away from the border, from its formula, in float64.

    A patch reaches from -k + 1 to k, its distance counts over (2 k + 1)^2 H^2; where that is above 5 the weight is 0.
    """
    f = f.astype(np.float64)
    (top, bottom), (left, right) = ((s.start, s.stop) for s in part)

    def shifted(dy: int, dx: int, margin: int) -> Image:
        return f[top - margin + dy : bottom + margin + dy, left - margin + dx : right + margin + dx]

    total, weight = np.zeros((bottom - top, right - left)), np.zeros((bottom - top, right - left))
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            square = (shifted(dy, dx, k) - shifted(0, 0, k)) ** 2
            # the square of the cell at offset j from a vertex lies k + j further in
            box = np.lib.stride_tricks.sliding_window_view(square[1:, 1:], (2 * k, 2 * k)).sum(axis=(2, 3))
            exponent = box / ((2 * k + 1) * H) ** 2
            w = np.where(exponent > 5, 0, np.exp(-exponent))
            total += w * shifted(dy, dx, 0)
            weight += w
    return total / weight


def nonlocal_means(setup: Setup) -> Iterator[Case]:
    """Nonlocal means, the whole job, beside OpenCV's on 8 bits and scikit-image's fast mode."""
    side = 128 if setup.quick else 512
    patch_radius, radius, H = 3, 10, 20.0
    size, window = 2 * patch_radius + 1, 2 * radius + 1
    clean, name = setup.picture(side)
    noise = np.random.default_rng(SEED).normal(0, 20, clean.shape)
    grey = np.clip(np.rint(clean + noise), 0, 255).astype(np.uint8)
    f0 = grey.astype(np.float32)
    inner = (slice(radius + patch_radius, -radius - patch_radius),) * 2

    def ours(device: str, strength: float = H) -> Image:
        # One channel: h^2 = s^2 H^2 for the flat patch of s x s; lam = 2 counts the centre once.
        w2 = gr.weights.patch(patch_radius, size * strength)
        grid = gr.GridGraph(f0.shape, radius)
        return gr.regularize(f0, grid, p=2, lam=2, weights=w2, max_iter=1, backend=device, dtype=np.float32).value

    entries = []
    opencv, restoration = peer("cv2"), peer("skimage.restoration")
    # OpenCV drops weights below 1e-3 and tabulates distances in steps of 64/49: with this H no weight is that small and
    # a step does not count, so what is left is its rounding.
    mild = 100.0
    theirs: dict[str, Image] = {}
    truth: Image | None = None
    if opencv is None:
        entries.append(_missing("OpenCV 8-bit"))
    else:
        truth = opencv.fastNlMeansDenoising(grey, None, mild, size, window)
        theirs["OpenCV"] = opencv.fastNlMeansDenoising(grey, None, H, size, window)
        entries.append(
            Entry(
                "OpenCV 8-bit",
                lambda: opencv.fastNlMeansDenoising(grey, None, H, size, window),
                is_peer=True,
                note=f"{opencv.getNumThreads()} thread(s), PSNR {_psnr(theirs['OpenCV'], clean, 255):.2f}",
            )
        )
    if restoration is None:
        entries.append(_missing("scikit-image fast"))
    else:

        def fast() -> Image:
            return restoration.denoise_nl_means(f0, size, radius, H, fast_mode=True, preserve_range=True)

        theirs["scikit-image"] = fast()
        there = (slice(side // 2 - 32, side // 2 + 32),) * 2
        formula = _fast_mode_formula(f0, there, patch_radius, radius, H)
        apart = float(np.abs(theirs["scikit-image"][there] - formula).max())
        entries.append(
            Entry(
                "scikit-image fast",
                fast,
                is_peer=True,
                note=f"one thread, {apart:.2f} from its formula, PSNR {_psnr(theirs['scikit-image'], clean, 255):.2f}",
            )
        )

    def agrees(device: str) -> tuple[bool, str]:
        good, said = True, []
        if truth is None:
            said.append("not checked: OpenCV is not installed")
        else:
            difference = float(np.abs(ours(device, mild) - truth)[inner].max())
            good = difference <= OPENCV_TOLERANCE
            said.append(f"{difference:.3f} from OpenCV at H = {mild:g} (at most {OPENCV_TOLERANCE:g})")
        value = ours(device)
        for who, other in theirs.items():
            d = (value - other)[inner]
            said.append(f"as timed {np.abs(d).max():.1f} max, {math.sqrt((d**2).mean()):.2f} rms from {who}")
        said.append(f"PSNR {_psnr(value, clean, 255):.2f}")
        return good, "; ".join(said)

    for device in setup.devices:
        entries.append(Entry(device, lambda device=device: ours(device), check=lambda device=device: agrees(device)))
    yield Case(
        "nonlocal-means",
        f"nonlocal means, {side}x{side}, {size}x{size} flat patch, {window}x{window} window, one step, host to host",
        entries,
        [
            f"picture: {name}, noise of standard deviation 20, rounded to 8 bits; H = {H:g}, grey levels 0..255",
            f"compared {radius + patch_radius} pixels and more from the border: nearer, reflected pixels vote too",
            "OpenCV drops weights below 0.001, some grey levels' difference beside edges at the timed H; equality is "
            f"asserted at H = {mild:g}, where it drops none and its rounding is all that is left",
            "scikit-image's fast mode compares 6x6 patches off the centre and drops weights below exp(-5): other work "
            "than ours, so its result is compared with its own formula instead, in grey levels",
        ],
    )


def digital_tv(setup: Setup) -> Iterator[Case]:
    """Digital TV beside Chambolle's projection with as many iterations: other functional, for information."""
    side, steps, lam = (128, 20, 10.0) if setup.quick else (512, 100, 10.0)
    clean, name = setup.picture(side)
    clean = clean / 255
    f0 = (clean + np.random.default_rng(SEED).normal(0, 20 / 255, clean.shape)).astype(np.float32)

    def ours(device: str) -> Image:
        grid = gr.GridGraph(f0.shape, 1, "cityblock")
        return gr.regularize(f0, grid, p=1, lam=lam, max_iter=steps, backend=device, dtype=np.float32).value

    restoration = peer("skimage.restoration")
    entries = [_missing("scikit-image Chambolle")]
    if restoration is not None:

        def chambolle() -> Image:
            return restoration.denoise_tv_chambolle(f0, weight=1 / lam, eps=0, max_num_iter=steps)

        note = f"one thread, PSNR {_psnr(chambolle(), clean, 1):.2f}"
        entries = [Entry("scikit-image Chambolle", chambolle, is_peer=True, note=note)]
    for device in setup.devices:

        def quality(device: str = device) -> tuple[bool, str]:
            value = ours(device)
            return bool(np.isfinite(value).all()), f"PSNR {_psnr(value, clean, 1):.2f}"

        entries.append(Entry(device, lambda device=device: ours(device), check=quality))
    yield Case(
        "digital-tv",
        f"digital TV (p = 1, G_0), {side}x{side}, {steps} iterations, lam = {lam:g}, host to host",
        entries,
        [
            f"picture: {name}, noise of standard deviation 20 of 255, values of 0..1",
            "information only: Chambolle minimises TV of forward differences, by another process",
        ],
    )


CASES: dict[str, Callable[[Setup], Iterator[Case]]] = {
    "iteration-grid iteration-csr": iteration,
    "nonlocal-means": nonlocal_means,
    "digital-tv": digital_tv,
}
