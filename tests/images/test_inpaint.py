"""The door for missing pixels: inpaint_image."""

from __future__ import annotations

import warnings

import cases
import numpy as np
import pytest
from scipy import sparse
from scipy.ndimage import distance_transform_edt
from scipy.sparse.linalg import spsolve
from skimage import data, metrics, restoration

import gpureg as gr
from gpureg.regularization.harmonic import harmonic


def holes(shape: tuple[int, ...], seed: int = 3) -> np.ndarray:
    """Two blocks, one at the border, and scattered pixels."""
    mask = cases.rng(seed).random(shape) < 0.05
    mask[(slice(4, 9), *[slice(5, 11)] * (len(shape) - 1))] = True
    mask[(slice(0, 3), *[slice(0, 4)] * (len(shape) - 1))] = True
    return mask


def dirichlet(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """L f = 0 in the hole, f = image outside it, on the nearest neighbours, directly solved."""
    W = gr.GridGraph(mask.shape, 1, "cityblock").to_graph().to_scipy().astype(float)
    L = sparse.csr_array(sparse.diags_array(W.sum(axis=1)) - W)
    hole, known = np.flatnonzero(mask), np.flatnonzero(~mask)
    f = image.ravel().astype(float).copy()
    f[hole] = spsolve(L[hole][:, hole].tocsc(), -(L[hole][:, known] @ f[known]))
    return f.reshape(image.shape)


@pytest.mark.parametrize("shape", [(23, 31), (11, 13, 15)])
def test_harmonic_fill(device: str, shape: tuple[int, ...]) -> None:
    image, mask = cases.rng(5).random(shape), holes(shape)
    exact = dirichlet(image, mask)
    filled = gr.inpaint_image(np.where(mask, np.nan, image), mask, backend=device)
    assert np.array_equal(filled[~mask], image[~mask])  # to the bit
    assert np.abs(filled - exact).max() < 1e-5  # float32, from a start that is exact to 1e-7


@pytest.mark.parametrize("p", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("norm", ["vertex", "edge"])
def test_linear_pictures_come_back(p: float, norm: str) -> None:
    """For p > 1 with the edge norm a slope is the minimiser on G_0; others come near it inside the hole."""
    slope = np.add.outer(np.arange(20.0), 2 * np.arange(24.0))
    mask = np.zeros(slope.shape, bool)
    mask[6:12, 7:15] = True
    given = {"p": p, "norm": norm, "backend": "numpy", "dtype": np.float64}
    filled = gr.inpaint_image(np.where(mask, 0, slope), mask, **given)
    assert np.abs(filled - slope).max() < (1e-3 if p > 1 else 8)


def test_the_lipschitz_fill_of_a_slope() -> None:
    """At p = inf the norm is that of edges, and a slope is its own absolutely minimal extension."""
    slope = np.add.outer(np.arange(9.0), 2 * np.arange(10.0))
    mask = np.zeros(slope.shape, bool)
    mask[3:6, 4:8] = True
    filled, result = gr.inpaint_image(np.where(mask, 0, slope), mask, p=np.inf, return_result=True, backend="numpy")
    assert np.abs(filled - slope).max() < 1e-5
    assert result.stop is gr.Stop.BALANCED


def test_kinds_of_image() -> None:
    """uint8 rounded and clipped, colour on any axis, only the hole is touched, the input is not."""
    image = (cases.rng(7).random((19, 22, 3)) * 255).astype(np.uint8)
    mask = holes((19, 22))
    kept = image.copy()
    filled = gr.inpaint_image(image, mask, channel_axis=-1, backend="numpy")
    assert filled.dtype == np.uint8
    assert np.array_equal(image, kept)
    assert np.array_equal(filled[~mask], image[~mask])
    first = gr.inpaint_image(np.moveaxis(image, -1, 0), mask, channel_axis=0, backend="numpy")
    assert np.array_equal(np.moveaxis(first, 0, -1), filled)
    exact = np.stack([dirichlet(image[..., c], mask) for c in range(3)], axis=-1)
    assert np.abs(filled - exact)[mask].max() <= 0.5 + 1e-3
    assert np.array_equal(gr.inpaint_image(image, np.zeros((19, 22), bool), channel_axis=-1), image)


def test_weights_and_updates() -> None:
    """Weights that look at values come from the first fill, and may be computed anew."""
    step = np.where(np.arange(24) < 12, 0.0, 1.0) * np.ones((20, 1))
    mask = np.zeros(step.shape, bool)
    mask[8:12, 9:15] = True
    weights = gr.weights.bilateral(4.0, 0.2)
    given = {"weights": weights, "radius": 4, "backend": "numpy"}
    plain = gr.inpaint_image(step, mask, backend="numpy")
    bilateral = gr.inpaint_image(step, mask, **given)
    anew = gr.inpaint_image(step, mask, update_weights=5, max_iter=60, **given)
    errors = [np.abs(x - step).sum() for x in (plain, bilateral, anew)]
    assert errors[0] > errors[1] > errors[2]


@pytest.mark.parametrize("p", [2.0, 1.5])
@pytest.mark.parametrize("weights", [None, gr.weights.bilateral(2.0, 0.3), gr.weights.patch(2, 1.0)])
def test_no_more_of_the_image_than_matters(p: float, weights: gr.weights.Weights | None) -> None:
    """The window around a hole gives what the whole image does: a mask of two far corners takes all of it."""
    image = cases.rng(5).random((32, 38))
    near, corners = np.zeros(image.shape, bool), np.zeros(image.shape, bool)
    near[14:19, 16:22] = True
    corners[0, 0] = corners[-1, -1] = True
    settings = {"p": p, "weights": weights, "radius": 2, "eps": 1e-2, "tol": 1e-12 if p == 2 else 1e-8}
    settings |= {"backend": "numpy", "dtype": "float64"}
    window = gr.inpaint_image(image, near, **settings)
    whole = gr.inpaint_image(image, near | corners, **settings)
    # Both stop at a gap of 1e-12 (p = 2) or 1e-8 of the energy, 1e2: measured 2e-7 and 2e-6.
    assert np.abs(window - whole)[near].max() < 1e-5
    # so that the above can fail: a window without its rim is another problem
    cut = gr.inpaint_image(image[13:20, 15:23], near[13:20, 15:23], **settings)
    assert np.abs(cut - window[13:20, 15:23]).max() > 1e-4


def test_a_guide_tells_where_colours_end() -> None:
    step = np.where(np.arange(24) < 12, 0.0, 1.0) * np.ones((20, 1))
    mask = np.ones(step.shape, bool)
    mask[10, [2, 21]] = False
    weights = gr.weights.guided(gr.weights.bilateral(3.0, 0.2), step.ravel())
    filled = gr.inpaint_image(np.where(mask, np.nan, step), mask, weights=weights, radius=2, backend="numpy")
    assert np.abs(filled - step).max() < 1e-3  # weights across the step: exp(-25) = 1e-11


def test_weights_that_differ_widely() -> None:
    """On a path the resistances 1/w add up."""
    weights = np.where(np.arange(60) % 3, 1e2, 1e-2)
    path = gr.Graph.from_edges([[k, k + 1] for k in range(60)], weights)
    known = np.zeros(61, bool)
    known[[0, 60]] = True
    f0 = np.where(np.arange(61) == 60, 1.0, 0.0)[:, None]
    steps = 1 / weights
    exact = np.concatenate([[0], np.cumsum(steps) / steps.sum()])
    # float32: the ratio of two sums of 60 steps
    assert np.abs(harmonic(f0, path, known, backend="numpy")[0][:, 0] - exact).max() < 1e-6


@pytest.mark.parametrize("thread", [1.0, 1e-6, 1e-12, 1e-13, 1e-14])
def test_vertices_on_threads_have_their_value(thread: float) -> None:
    """Two joined by 1, and by a thread to 0 and one three times as strong to 1: 3/4, however thin the threads.

    Below 1e-12 rounding of A, 1e-16, over the thread's share is what is left.
    """
    graph = gr.Graph.from_edges([[0, 1], [1, 2], [2, 3]], [thread, 1.0, 3 * thread])
    known = np.array([True, False, False, True])
    f, _ = harmonic(np.array([[0.0], [0], [0], [1]]), graph, known, dtype=np.float64, backend="numpy")
    # three edges in a row, of resistances 1/thread, 1 and 1/(3 thread)
    expected = (1 / thread) / (1 / thread + 1 + 1 / (3 * thread))
    assert f[1, 0] == pytest.approx(expected, abs=1e-9 + 4e-16 / thread)


def test_pixels_that_hang_by_a_thread() -> None:
    """Pixels joined to each other, and by weights of 1e-20 to all else, make the system singular to the last digit.

    Conjugate gradients made 1110 of a picture in 0..0.9, and warned; factors alone make infinities.
    """
    image = data.astronaut()[:160:4, 90:250:4].mean(axis=-1) / 255
    known = cases.rng(0).random(image.shape) < 0.02
    weights = gr.weights.guided(gr.weights.bilateral(np.inf, 0.02), image)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        filled = gr.inpaint_image(np.where(known, image, 0), ~known, radius=1, weights=weights)
    assert image[known].min() <= filled.min() and filled.max() <= image[known].max() + 1e-6
    plain = gr.inpaint_image(np.where(known, image, 0), ~known)
    # a guide that knows the picture does better than none
    assert np.abs(filled - image).mean() < np.abs(plain - image).mean()


def test_weights_are_computed_anew_before_a_tolerance_ends_it() -> None:
    """At p = 2 the run starts at the solution of the first weights: it used to stop there, the second never seen."""
    image = data.brick()[:64, :64].astype(np.float32)
    mask = np.zeros(image.shape, bool)
    mask[30:36] = True
    settings = {"weights": gr.weights.patch(2, 60.0), "radius": 5, "max_iter": 12, "backend": "numpy"}
    once, anew = (gr.inpaint_image(image, mask, update_weights=k, **settings) for k in (None, 10))
    assert np.abs(once - anew).max() > 0.1


@pytest.mark.parametrize("spacing", [2, (1,), (0, 1), "a"])
@pytest.mark.parametrize("radius", [None, 2])
def test_wrong_spacing(spacing, radius) -> None:
    with pytest.raises(ValueError, match="spacing must hold 2"):
        gr.inpaint_image(np.zeros((9, 9)), np.eye(9, dtype=bool), spacing=spacing, radius=radius)


def test_photograph_with_scratches() -> None:
    """Thin scratches through a photograph; PSNR over the hole beside scikit-image's biharmonic fill."""
    image = data.camera()[150:300, 150:300] / 255
    mask = np.zeros(image.shape, bool)
    rows = np.arange(image.shape[0])
    for slope, offset in ((0.4, 20), (-0.7, 130), (0.1, 70)):
        at = np.clip((slope * rows + offset).astype(int), 1, image.shape[1] - 2)
        for shift in (-1, 0, 1):
            mask[rows, at + shift] = True
    torn = np.where(mask, 0, image)

    def psnr(x: np.ndarray) -> float:
        return float(metrics.peak_signal_noise_ratio(image[mask], x[mask], data_range=1))

    harmonic = psnr(gr.inpaint_image(torn, mask))
    nearest = psnr(
        np.where(mask, image[tuple(distance_transform_edt(mask, return_distances=False, return_indices=True))], image)
    )
    biharmonic = psnr(restoration.inpaint_biharmonic(torn, mask))
    # Sweeps start at the harmonic fill, so that none is needed at p = 2.
    assert psnr(gr.inpaint_image(torn, mask, solver="jacobi", max_iter=0)) == pytest.approx(harmonic, abs=0.05)
    # Measured: 25.6 dB harmonic, 26.6 biharmonic (of fourth order, smoother), 3 dB less for the nearest pixel.
    assert harmonic > biharmonic - 1.5
    assert harmonic > nearest + 1


@pytest.mark.parametrize(
    ("image", "mask", "error", "says"),
    [
        (np.zeros((4, 5)), np.ones((4, 5), bool), ValueError, "every pixel is missing"),
        (np.zeros((4, 5)), np.ones((4, 6), bool), ValueError, "missing"),
        (np.zeros((4, 5)), np.zeros((4, 5)), (ValueError, TypeError), "missing"),
        (np.full((4, 5), np.nan), np.eye(4, 5, dtype=bool), ValueError, "finite"),
    ],
)
def test_wrong_arguments(image, mask, error, says) -> None:
    with pytest.raises(error, match=says):
        gr.inpaint_image(image, mask)
