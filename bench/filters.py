"""One-step filters and digital TV of pictures, beside OpenCV and scikit-image."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import gpureg as gr
from gpureg import backends
from gpureg.backends import PatchForm

from .iterations import Sweeps
from .model import DEVICE, EXP, HOST, TOLERANCE, Bar, Case, Entry, Image, Setup, apart, missing, peer

# Grey levels, for 8-bit data: half a level is OpenCV's rounding of its result.
OPENCV_TOLERANCE = 0.54
# Relative. OpenCV tabulates the exp of float32 data and interpolates; measured 5e-7 with sums in another order.
BILATERAL_TOLERANCE = 2e-6

OPENCV_NLM, SKIMAGE_NLM = "OpenCV 8-bit", "scikit-image fast"
OPENCV_BILATERAL, CHAMBOLLE = "OpenCV float32", "scikit-image Chambolle"


def psnr(image: Image, clean: Image, peak: float) -> float:
    """Peak signal-to-noise ratio in dB."""
    return 10 * math.log10(peak**2 / float(((image - clean) ** 2).mean(dtype=np.float64)))


def one_step(device: str, f0: Image, grid: gr.GridGraph, weights: gr.weights.Weights, **settings: Any) -> Image:
    """Ours, from host to host: one sweep at p = 2; lam = 2 counts the centre once, as the peers do."""
    return gr.denoise_image(
        f0,
        p=2,
        lam=2,
        max_iter=1,
        radius=grid.radius,
        metric=grid.metric,
        weights=weights,
        backend=device,
        **settings,
    )


class StepOnDevice:
    """The device part of a one-step filter: data and result stay there, the weights' picture goes up at each call."""

    def __init__(self, device: str, f0: Image, grid: gr.GridGraph, form: Callable[[Any], PatchForm]) -> None:
        self.backend = backends.get(device, np.float32)
        self.grid, self.host, self.form = grid, f0.reshape(-1, 1), form(grid)
        self.f0: Any = None

    def __call__(self) -> Any:
        """One step."""
        if self.f0 is None:
            self.f0 = self.backend.put(self.grid, self.host)
            self.out = self.backend.empty(self.grid, 1)
        return self.backend.similarity_step(self.grid, self.host, self.form, self.f0, 2.0, out=self.out)

    def value(self) -> Image:
        """The result on the host."""
        return self.backend.get(self.grid, self()).reshape(self.grid.shape)


def patch_form(patch_radius: int, h: float) -> Callable[[Any], PatchForm]:
    """The weights w2 of a flat patch as a backend takes them."""
    return lambda grid: PatchForm(np.ones(2 * patch_radius + 1), 0.0, h**-2)


def bilateral_form(sigma_space: float, sigma_value: float) -> Callable[[Any], PatchForm]:
    """The weights w1 as a backend takes them."""

    def form(grid: gr.GridGraph) -> PatchForm:
        spatial = np.exp(-((grid.forward_offsets / sigma_space) ** 2).sum(axis=1))
        return PatchForm(np.ones(1), 0.0, sigma_value**-2, spatial)

    return form


def nlm_operations(grid: gr.GridGraph) -> float:
    """Operations of nonlocal means by running sums, per vertex and neighbour: README.md lists them."""
    return grid.n_vertices * (2.0 * grid.half_window * (2 + 2 + 2 + 1 + EXP + 3) + 4)


def bilateral_operations(grid: gr.GridGraph) -> float:
    """Operations of a bilateral filter, per vertex and neighbour: README.md lists them."""
    return grid.n_vertices * (2.0 * grid.half_window * (2 + 1 + EXP + 1 + 3) + 4)


def one_step_entries(
    setup: Setup,
    f0: Image,
    grid: gr.GridGraph,
    weights: gr.weights.Weights,
    form: Callable[[Any], PatchForm],
    count: float,
    agrees: Callable[[Image, Callable[..., Image]], tuple[bool, str]],
) -> list[Entry]:
    """Two rows per device: host to host, and the device part.

    `agrees` takes a result, and for the first row a function that gives our result for other weights.
    """
    entries = []
    moved = 2.0 * 4 * grid.n_vertices
    for device in setup.devices:

        def ours(device: str = device, weights: gr.weights.Weights = weights) -> Image:
            return one_step(device, f0, grid, weights)

        step = StepOnDevice(device, f0, grid, form)

        def check(ours: Callable[..., Image] = ours) -> tuple[bool, str]:
            return agrees(ours(), ours)

        def check_step(ours: Callable[..., Image] = ours, step: StepOnDevice = step) -> tuple[bool, str]:
            return apart(step.value(), ours(), TOLERANCE["float32"], "host to host")

        entries += [
            Entry(device, ours, check=check, transfers=HOST, bytes=moved, operations=count),
            Entry(device, step, step.backend.finish, check_step, DEVICE, moved, count),
        ]
    return entries


def _fast_mode_formula(f: Image, part: tuple[slice, slice], k: int, radius: int, H: float) -> Image:
    """What scikit-image's fast mode computes in a part away from the border, from its formula, in float64.

    A patch reaches from -k + 1 to k, its distance counts over (2 k + 1)^2 H^2; where that is above 5 the weight is 0.
    """
    f = f.astype(np.float64)
    (top, bottom), (left, right) = ((s.start, s.stop) for s in part)

    def at(dy: int, dx: int, margin: int) -> Image:
        return f[top - margin + dy : bottom + margin + dy, left - margin + dx : right + margin + dx]

    total, weight = np.zeros((bottom - top, right - left)), np.zeros((bottom - top, right - left))
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            square = (at(dy, dx, k) - at(0, 0, k)) ** 2
            # the square of the cell at offset j from a vertex lies k + j further in
            box = np.lib.stride_tricks.sliding_window_view(square[1:, 1:], (2 * k, 2 * k)).sum(axis=(2, 3))
            exponent = box / ((2 * k + 1) * H) ** 2
            w = np.where(exponent > 5, 0, np.exp(-exponent))
            total += w * at(dy, dx, 0)
            weight += w
    return total / weight


def nonlocal_means(setup: Setup) -> Iterator[Case]:
    """Nonlocal means beside OpenCV's on 8 bits and scikit-image's fast mode."""
    side, patch_radius, radius = setup.pick((512, 3, 10), (128, 3, 10), (41, 2, 4))
    H = 20.0
    size, width = 2 * patch_radius + 1, 2 * radius + 1
    clean, noisy, name = setup.noisy(side)
    grey = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    f0 = grey.astype(np.float32)
    grid = gr.GridGraph(f0.shape, radius)
    inner = (slice(radius + patch_radius, -radius - patch_radius),) * 2

    def w2(strength: float = H) -> gr.weights.Weights:
        # One channel: h^2 = s^2 H^2 for the flat patch of s x s.
        return gr.weights.patch(patch_radius, size * strength)

    entries = []
    opencv, restoration = peer("cv2"), peer("skimage.restoration")
    # OpenCV drops weights below 1e-3 and tabulates distances in steps of 64/49: with this H no weight is that small and
    # a step does not count, so what is left is its rounding.
    mild = 100.0
    theirs: dict[str, Image] = {}
    truth: Image | None = None
    if opencv is None:
        entries.append(missing(OPENCV_NLM))
    else:
        truth = opencv.fastNlMeansDenoising(grey, None, mild, size, width)
        theirs["OpenCV"] = opencv.fastNlMeansDenoising(grey, None, H, size, width)
        entries.append(
            Entry(
                OPENCV_NLM,
                lambda: opencv.fastNlMeansDenoising(grey, None, H, size, width),
                is_peer=True,
                note=f"{opencv.getNumThreads()} thread(s), PSNR {psnr(theirs['OpenCV'], clean, 255):.2f}",
            )
        )
    if restoration is None:
        entries.append(missing(SKIMAGE_NLM))
    else:

        def fast() -> Image:
            return restoration.denoise_nl_means(f0, size, radius, H, fast_mode=True, preserve_range=True)

        theirs["scikit-image"] = fast()
        reach = min(32, side // 2 - radius - patch_radius)
        there = (slice(side // 2 - reach, side // 2 + reach),) * 2
        formula = _fast_mode_formula(f0, there, patch_radius, radius, H)
        off = float(np.abs(theirs["scikit-image"][there] - formula).max())
        quality = psnr(theirs["scikit-image"], clean, 255)
        entries.append(
            Entry(SKIMAGE_NLM, fast, is_peer=True, note=f"one thread, {off:.2f} from its formula, PSNR {quality:.2f}")
        )

    exact = one_step("numpy", f0, grid, w2(), dtype=np.float64)

    def agrees(value: Image, ours: Callable[..., Image]) -> tuple[bool, str]:
        good, said = apart(value, exact, TOLERANCE["float32"], "numpy float64")
        parts = [said]
        if truth is None:
            parts.append("not compared with OpenCV, which is not installed")
        else:
            difference = float(np.abs(ours(weights=w2(mild)) - truth)[inner].max())
            good = good and difference <= OPENCV_TOLERANCE
            parts.append(f"{difference:.3f} from OpenCV at H = {mild:g} (at most {OPENCV_TOLERANCE:g})")
        parts.append(f"PSNR {psnr(value, clean, 255):.2f}")
        return good, "; ".join(parts)

    # The exact result stands for ours, which must be near it.
    timed = []
    for who, other in theirs.items():
        d = (exact - other)[inner]
        timed.append(f"{np.abs(d).max():.1f} max, {math.sqrt((d**2).mean()):.2f} rms from {who}")
    form = patch_form(patch_radius, size * H)
    entries += one_step_entries(setup, f0, grid, w2(), form, nlm_operations(grid), agrees)
    yield Case(
        "nonlocal-means",
        f"nonlocal means, {side}x{side}, {size}x{size} flat patch, {width}x{width} window, one step",
        entries,
        [
            f"picture: {name}, noise of standard deviation 20, rounded to 8 bits; H = {H:g}, grey levels 0..255",
            f"as timed, ours is {' and '.join(timed)}" if timed else "no peer is installed",
            f"compared {radius + patch_radius} pixels and more from the border: nearer, reflected pixels vote too",
            "OpenCV drops weights below 0.001, some grey levels' difference beside edges at the timed H; equality is "
            f"asserted at H = {mild:g}, where it drops none and its rounding is all that is left",
            "scikit-image's fast mode compares 6x6 patches off the centre and drops weights below exp(-5): other work "
            "than ours, so its result is compared with its own formula instead, in grey levels",
        ],
        [Bar(OPENCV_NLM, 0.35), Bar(SKIMAGE_NLM, 0.12)],
        f"{side}x{side}",
        grid.n_vertices,
    )


def bilateral(setup: Setup) -> Iterator[Case]:
    """The bilateral filter on a disk, beside OpenCV's on float32."""
    side, radius = setup.pick((512, 8), (128, 8), (41, 3))
    sigma_color, sigma_space = 0.1, radius / 2
    clean, noisy, name = setup.noisy(side)
    clean, f0 = clean / 255, noisy / 255
    grid = gr.GridGraph(f0.shape, radius, "euclidean")
    inner = (slice(radius, -radius),) * 2
    # OpenCV's exponents have a factor 1/2, ours have not.
    sigmas = (math.sqrt(2) * sigma_space, math.sqrt(2) * sigma_color)
    w1 = gr.weights.bilateral(*sigmas)
    exact = one_step("numpy", f0, grid, w1, dtype=np.float64)

    opencv = peer("cv2")
    truth: Image | None = None
    entries = [missing(OPENCV_BILATERAL)]
    if opencv is not None:

        def filtered() -> Image:
            return opencv.bilateralFilter(f0, 2 * radius + 1, sigma_color, sigma_space)

        truth = filtered()
        note = f"{opencv.getNumThreads()} thread(s), PSNR {psnr(truth, clean, 1):.2f}"
        entries = [Entry(OPENCV_BILATERAL, filtered, is_peer=True, note=note)]

    def agrees(value: Image, ours: Callable[..., Image]) -> tuple[bool, str]:
        good, said = apart(value, exact, TOLERANCE["float32"], "numpy float64")
        parts = [said]
        if truth is not None:
            same, said = apart(value[inner], truth[inner], BILATERAL_TOLERANCE, "OpenCV inside")
            good = good and same
            parts.append(said)
        return good, "; ".join([*parts, f"PSNR {psnr(value, clean, 1):.2f}"])

    entries += one_step_entries(setup, f0, grid, w1, bilateral_form(*sigmas), bilateral_operations(grid), agrees)
    yield Case(
        "bilateral",
        f"bilateral filter, {side}x{side} float32, disk of radius {radius}, one step",
        entries,
        [
            f"picture: {name}, noise of standard deviation 20 of 255, values of 0..1; sigmas {sigma_color:g} and "
            f"{sigma_space:g} in OpenCV's convention",
            f"compared {radius} pixels and more from the border: nearer, reflected pixels vote in OpenCV",
        ],
        [Bar(OPENCV_BILATERAL, 0.6)],
        f"{side}x{side}",
        grid.n_vertices,
    )


def digital_tv(setup: Setup) -> Iterator[Case]:
    """Digital TV beside Chambolle's projection with as many iterations."""
    side, steps = setup.pick((512, 100), (128, 20), (37, 10))
    lam = 10.0
    clean, noisy, name = setup.noisy(side)
    clean, f0 = clean / 255, noisy / 255
    grid = gr.GridGraph(f0.shape, 1, "cityblock")

    def ours(device: str, dtype: Any = np.float32) -> Any:
        return gr.regularize(f0, grid, p=1, lam=lam, max_iter=steps, backend=device, dtype=dtype)

    exact = ours("numpy", np.float64)

    restoration = peer("skimage.restoration")
    entries = [missing(CHAMBOLLE)]
    if restoration is not None:

        def chambolle() -> Image:
            return restoration.denoise_tv_chambolle(f0, weight=1 / lam, eps=0, max_num_iter=steps)

        entries = [
            Entry(CHAMBOLLE, chambolle, is_peer=True, note=f"one thread, PSNR {psnr(chambolle(), clean, 1):.2f}")
        ]
    # f in, g out; f, f0, g in, f out. The weights are 1.
    moved = steps * 4.0 * grid.n_vertices * 6
    count = steps * grid.n_vertices * (7.0 * 4 + 12)
    for device in setup.devices:

        def check(device: str = device) -> tuple[bool, str]:
            value = ours(device).value
            good, said = apart(value, exact.value, TOLERANCE["float32"], "numpy float64")
            return good, f"{said}; PSNR {psnr(value, clean, 1):.2f}"

        sweeps = Sweeps(device, grid, None, f0.reshape(-1, 1), lam=lam, eps=exact.eps, steps=steps)

        def check_sweeps(sweeps: Sweeps = sweeps) -> tuple[bool, str]:
            sweeps()
            return apart(sweeps.value().reshape(f0.shape), exact.value, TOLERANCE["float32"], "numpy float64")

        note = "the sweeps alone, without looks at the energy"
        entries += [
            Entry(device, lambda d=device: ours(d), lambda: None, check, HOST, moved, count),
            Entry(device, sweeps, sweeps.backend.finish, check_sweeps, DEVICE, moved, count, note=note),
        ]
    yield Case(
        "digital-tv",
        f"digital TV (p = 1, G_0), {side}x{side}, {steps} iterations, lam = {lam:g}",
        entries,
        [
            f"picture: {name}, noise of standard deviation 20 of 255, values of 0..1",
            "the same number of passes, not the same result: Chambolle minimises TV of forward differences, by "
            "another process",
        ],
        [Bar(CHAMBOLLE, 0.35)],
        f"{side}x{side}",
        grid.n_vertices,
    )
