"""Choosing parameters: the discrepancy principle, SURE, J-invariance, calibration, IPOL's table."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import rng
from scipy import ndimage

import gpureg as gr
from gpureg import tuning
from gpureg.tuning.fidelity import gradient_to_noise, least
from gpureg.tuning.principle import match

NUMPY = {"backend": "numpy", "dtype": "float64"}


def scene(shape: tuple[int, ...] = (32, 40), sigma: float = 0.3, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """A wave, and the same with noise."""
    clean = np.sin(sum(np.indices(shape)) / 5)
    return clean, clean + rng(seed).normal(0, sigma, shape)


def ring(n: int = 60) -> gr.Graph:
    u = np.arange(n)
    edges = np.concatenate([np.stack([u, (u + 1) % n], 1), np.stack([u, (u + 7) % n], 1)])
    return gr.Graph.from_edges(edges, rng(1).uniform(0.2, 2, 2 * n))


@pytest.mark.parametrize("p", [0.7, 1.0, 1.5, 2.0, 3.0])
def test_discrepancy_on_any_graph(p: float) -> None:
    graph, sigma = ring(), 0.4
    f0 = np.stack([np.sin(np.arange(60) / 5), np.cos(np.arange(60) / 9)], 1) + rng(2).normal(0, sigma, (60, 2))
    found = tuning.discrepancy(f0, graph, sigma, p=p, start=30, **NUMPY)
    assert np.mean((found.result.value - f0) ** 2) / sigma**2 == pytest.approx(found.ratio, rel=1e-12)
    assert abs(found.ratio - 1) <= 0.01
    assert 2 <= found.evaluations <= 12
    assert f"{found.evaluations} evaluation" in str(found) and f"{found.lam:.4g}" in str(found)
    # without `tol` it is a process of 100 sweeps, and nothing else than regularize with this lam
    again = gr.regularize(f0, graph, p=p, lam=found.lam, **NUMPY)
    assert np.array_equal(again.value, found.result.value)


def test_discrepancy_counts_no_masked_cells() -> None:
    _, f0 = scene()
    mask = np.ones(f0.shape, bool)
    mask[5:20, 8:30] = False
    torn = np.where(mask, f0, np.nan)
    grid = gr.GridGraph(f0.shape, mask=mask)
    found = tuning.discrepancy(torn, grid, 0.3, p=1, max_iter=400, tol=1e-5, **NUMPY)
    ratio = np.mean((found.result.value - torn)[mask] ** 2) / 0.3**2
    assert ratio == pytest.approx(found.ratio, rel=1e-12)
    assert abs(found.ratio - 1) <= 0.01
    # each run but the first begins at the last outcome, and comes to the same end
    cold = gr.regularize(torn, grid, p=1, lam=found.lam, max_iter=3000, tol=1e-7, **NUMPY)
    # measured: 0.4 percent, what the sweeps left to do at tol = 1e-5 make up
    assert np.mean((cold.value - torn)[mask] ** 2) / 0.3**2 == pytest.approx(1, abs=0.03)


def test_discrepancy_with_a_map_of_noise() -> None:
    clean, _ = scene()
    sigma = np.where(np.arange(40) < 20, 0.1, 0.5) * np.ones((32, 1))
    f0 = clean + rng(4).standard_normal(clean.shape) * sigma
    found = tuning.discrepancy(f0, gr.GridGraph(f0.shape), sigma, p=2, max_iter=300, **NUMPY)
    assert np.mean(((found.result.value - f0) / sigma) ** 2) == pytest.approx(found.ratio, rel=1e-12)
    assert abs(found.ratio - 1) <= 0.01
    lam = found.lam.reshape(f0.shape)
    assert lam[0, 0] / lam[0, -1] == pytest.approx(25, rel=1e-12)
    assert " to " in str(found)
    same = tuning.discrepancy(f0, gr.GridGraph(f0.shape), np.full(f0.shape, 0.3), p=2, **NUMPY)
    number = tuning.discrepancy(f0, gr.GridGraph(f0.shape), 0.3, p=2, **NUMPY)
    assert same.lam == pytest.approx(number.lam, rel=1e-9)
    # what the map holds outside the mask does not matter
    mask = np.arange(40) < 39 * np.ones((32, 1))
    grid = gr.GridGraph(f0.shape, mask=mask)
    some = [tuning.discrepancy(f0, grid, np.where(mask, sigma, x), **NUMPY).ratio for x in (np.nan, 0, 7)]
    assert some[0] == some[1] == some[2]


def test_more_noise_than_there_is_to_take_away() -> None:
    _, f0 = scene()
    found = tuning.discrepancy(f0, gr.GridGraph(f0.shape), 50.0, max_iter=50, **NUMPY)
    assert found.ratio < 0.01
    assert found.result.value.std() < f0.std()


@pytest.mark.parametrize(
    ("call", "error", "says"),
    [
        ({"sigma": 0}, ValueError, "sigma must be finite and > 0, got 0"),
        ({"sigma": np.nan}, ValueError, "sigma must be finite"),
        ({"sigma": "a"}, TypeError, "sigma must be a real number"),
        ({"sigma": np.ones(3)}, ValueError, r"sigma must be a number or one per vertex, shape \(32, 40\)"),
        ({"lam": 1}, TypeError, "lam is set by the search"),
        ({"initial": np.zeros((32, 40))}, TypeError, "initial is set by the search"),
        ({"start": 0.0}, ValueError, "start must be finite and > 0"),
        ({"rtol": 0.0}, ValueError, "rtol must be finite and > 0"),
        ({"p": -1}, ValueError, "p must be finite and > 0"),
        ({"gamma": "round"}, ValueError, 'gamma must be "sqrt"'),
    ],
)
def test_discrepancy_says_what_is_wrong(call: dict, error: type, says: str) -> None:
    _, f0 = scene()
    call = {"sigma": 0.3, **NUMPY, **call}
    with pytest.raises(error, match=says):
        tuning.discrepancy(f0, gr.GridGraph(f0.shape), call.pop("sigma"), **call)


@pytest.mark.parametrize("start", [1e-4, 1.0, 1e5])
def test_the_root_is_found_from_afar(start: float) -> None:
    """A ratio that levels off on one side and falls as lam^-2 on the other, like that of Tikhonov's at p = 2."""
    seen = []
    lam, ratio, evaluations = match(lambda x: seen.append(x) or 4 / (1 + x / 3) ** 2, start)
    assert lam == pytest.approx(3, rel=0.02)
    assert abs(ratio - 1) < 0.01 + 1e-12
    assert evaluations == len(seen) == len(set(seen)) <= 16


@pytest.mark.parametrize("start", [1.0, 5.0, 70.0])
def test_the_least_is_found(start: float) -> None:
    """Also where it is beyond the range that is looked at first."""
    at, loss, evaluations = least(lambda x: 7 + abs(math.log(x / 3)) ** 1.5, start)
    assert abs(math.log(at / 3)) < 0.1  # what is asked for
    assert loss == pytest.approx(7, abs=0.04)
    assert evaluations < 25


def test_sure_of_a_linear_filter_is_steins_with_the_exact_trace() -> None:
    """With y -> Ky the estimate is that of Stein but for b'Kb in the trace's place, for any step."""
    _, noisy = scene((24, 20))

    def kernel(y: np.ndarray) -> np.ndarray:
        return ndimage.uniform_filter(y, 3, mode="constant")

    trace = sum(kernel(np.eye(1, 480, k).reshape(24, 20)).flat[k] for k in range(480))
    assert trace == pytest.approx(480 / 9)
    exact = np.mean((kernel(noisy) - noisy) ** 2) - 0.09 + 2 * 0.09 * trace / 480
    # b'Kb has the trace for its mean and the variance 2 sum_(u != v) K_uv^2, here below 2 * 480 * 8/81
    scatter = 2 * 0.09 / 480 * math.sqrt(2 * 480 * 8 / 81)
    found = [tuning.sure(kernel, noisy, 0.3, seed=seed) for seed in range(40)]
    assert abs(np.mean(found) - exact) < 4 * scatter / math.sqrt(40)
    assert np.std(found) < 1.5 * scatter
    assert tuning.sure(kernel, noisy, 0.3, step=3.0) == pytest.approx(found[0], rel=1e-9)
    assert tuning.sure(kernel, noisy, 0.0) == pytest.approx(np.mean((kernel(noisy) - noisy) ** 2), rel=1e-12)


@pytest.mark.parametrize("name", ["total variation", "nonlocal means"])
def test_sure_tells_the_error_of_our_filters(name: str) -> None:
    """Mean over ten noises of estimate less truth; one scatters by sigma^2 sqrt(2/N), 2 percent of sigma^2."""
    clean, _ = scene((64, 64))
    grid = gr.GridGraph(clean.shape, 1, "cityblock")
    weights = gr.weights.patch(1, 0.3 * 2.4, sigma=0.3)

    def denoise(y: np.ndarray) -> np.ndarray:
        if name == "total variation":
            return gr.regularize(y, grid, p=1, lam=8, max_iter=60, eps=0.02, **NUMPY).value
        return gr.regularize(y, gr.GridGraph(y.shape, 3), lam=2, weights=weights, max_iter=1, **NUMPY).value

    off = []
    for seed in range(10):
        noisy = clean + rng(seed).normal(0, 0.3, clean.shape)
        off.append(tuning.sure(denoise, noisy, 0.3, seed=seed) - np.mean((denoise(noisy) - clean) ** 2))
    assert abs(np.mean(off)) < 3 * 0.09 * math.sqrt(2 / 4096 / 10)
    assert np.std(off) < 2 * 0.09 * math.sqrt(2 / 4096)


def test_sure_with_mask_channels_integers_and_a_map() -> None:
    _, noisy = scene((30, 30))
    mask = np.ones((30, 30), bool)
    mask[:, 20:] = False
    torn = np.where(mask, noisy, np.nan)

    def half(y: np.ndarray) -> np.ndarray:
        return np.where(np.isnan(y), 0, y) / 2

    # for y/2 the probe gives the trace exactly: b'b/2
    exact = np.mean(noisy[:, :20] ** 2) / 4 - 0.09 + 0.09
    assert tuning.sure(half, torn, 0.3, mask=mask) == pytest.approx(exact, rel=1e-9)
    colour = np.stack([torn, torn])
    assert tuning.sure(half, colour, 0.3, mask=mask, channel_axis=0) == pytest.approx(exact, rel=1e-9)
    sigma = np.where(np.arange(30) < 10, 0.1, 0.5)
    assert tuning.sure(half, noisy, sigma) == pytest.approx(np.mean(noisy**2) / 4, rel=1e-9)
    types = []
    integers = np.rint(100 * noisy).astype(np.int16)
    found = tuning.sure(lambda y: types.append(y.dtype) or y / 2, integers, 30)
    assert set(types) == {np.dtype(np.float64)}
    assert found == pytest.approx(np.mean(integers.astype(float) ** 2) / 4, rel=1e-9)


def literal_j_invariance(
    denoise, noisy: np.ndarray, stride: int, spacing: tuple[float, ...], mask: np.ndarray
) -> float:
    """Pixel by pixel: the mean of mirrored neighbours inside the mask, weighted by the inverse square of distance."""
    losses = []
    for offset in np.ndindex((stride,) * noisy.ndim):
        shown, hidden = noisy.copy(), []
        for at in np.ndindex(noisy.shape):
            if all((a - o) % stride == 0 for a, o in zip(at, offset, strict=True)) and mask[at]:
                hidden.append(at)
                total = weight = 0.0
                for axis, size in enumerate(noisy.shape):
                    for step in (-1, 1):
                        there = list(at)
                        there[axis] = size - 1 - abs(size - 1 - abs(at[axis] + step))
                        if mask[tuple(there)]:
                            total += noisy[tuple(there)] / spacing[axis] ** 2
                            weight += 1 / spacing[axis] ** 2
                shown[at] = total / weight
        told = denoise(shown)
        losses += [(told[at] - noisy[at]) ** 2 for at in hidden]
    return float(np.mean(losses))


@pytest.mark.parametrize("spacing", [(1.0, 1.0), (3.0, 1.0)])
@pytest.mark.parametrize("torn", [False, True])
def test_j_invariance_is_the_literal_one(spacing: tuple[float, float], torn: bool) -> None:
    _, noisy = scene((9, 11))
    inside = np.ones(noisy.shape, bool)
    inside[2:5, 3:6] = not torn

    def denoise(y: np.ndarray) -> np.ndarray:
        return ndimage.gaussian_filter(y, 0.8)

    expected = literal_j_invariance(denoise, noisy, 3, spacing, inside)
    found = tuning.j_invariance(denoise, noisy, stride=3, every=True, spacing=spacing, mask=inside)
    assert found == pytest.approx(expected, rel=1e-12)


def test_j_invariance_leaves_out_what_is_masked() -> None:
    _, noisy = scene((20, 24))
    mask = np.ones(noisy.shape, bool)
    mask[4:9, 6:15] = False

    def denoise(y: np.ndarray) -> np.ndarray:
        return gr.denoise_image(y, mask=mask, p=1, lam=8, sigma=0.3, max_iter=20, backend="numpy", dtype="float64")

    torn = [tuning.j_invariance(denoise, np.where(mask, noisy, x), mask=mask) for x in (np.nan, 9.0)]
    assert torn[0] == torn[1]
    colour = np.stack([noisy, noisy], 1)
    both = tuning.j_invariance(lambda y: ndimage.gaussian_filter(y, (1, 0, 1)), colour, channel_axis=1)
    assert both == pytest.approx(tuning.j_invariance(lambda y: ndimage.gaussian_filter(y, 1), noisy), rel=1e-12)


@pytest.mark.parametrize("shape", [(32, 40), (12, 14, 16)])
@pytest.mark.parametrize("approximate", [True, False])
def test_losses_are_those_of_scikit_image(shape: tuple[int, ...], approximate: bool) -> None:
    restoration = pytest.importorskip("skimage.restoration", reason="scikit-image is not installed")
    _, noisy = scene(shape)
    widths, denoise = {"sigma": [0.5, 1.0, 2.0]}, ndimage.gaussian_filter
    _, (tried, losses) = restoration.calibrate_denoiser(
        noisy, denoise, widths, approximate_loss=approximate, extra_output=True
    )
    found = tuning.calibrate(denoise, noisy, widths, method="j-invariance", every=not approximate, refine=False)
    assert [trial.parameters for trial in found.table] == list(tried)
    assert [trial.loss for trial in found.table] == pytest.approx(losses, rel=1e-12)


def test_calibration_tries_all_and_once_more() -> None:
    clean, noisy = scene((64, 64))
    calls = []

    def denoise(y: np.ndarray, sigma: float, truncate: int) -> np.ndarray:
        calls.append((sigma, truncate))
        return ndimage.gaussian_filter(y, sigma, truncate=truncate)

    grid = {"sigma": [0.5, 1.0, 2.0, 4.0], "truncate": [2, 3, 4]}
    found = tuning.calibrate(denoise, noisy, grid, sigma=0.3)
    assert len(found.table) == 13
    assert len(calls) == 26
    assert found.loss == min(trial.loss for trial in found.table)
    assert {trial.parameters["truncate"] for trial in found.table} == {2, 3, 4}  # integers stay those of the grid
    truth = {s: np.mean((ndimage.gaussian_filter(noisy, s) - clean) ** 2) for s in np.geomspace(0.5, 4, 31)}
    assert abs(math.log(found.parameters["sigma"] / min(truth, key=truth.__getitem__))) < math.log(2) / 2
    assert "SURE" in str(found) and "least of 13" in str(found)
    assert tuning.calibrate(denoise, noisy, grid, sigma=0.3) == found  # the same seed, the same outcome
    assert tuning.calibrate(denoise, noisy, grid).sigma == gr.estimate_noise(noisy)
    # the best at the grid's end has no neighbour beyond it
    assert len(tuning.calibrate(denoise, noisy, {"sigma": [8.0, 12.0], "truncate": [4]}, sigma=0.3).table) == 2


def test_the_vertex_of_a_parabola() -> None:
    """A loss that is one in log h has its least exactly where the refinement looks."""

    def denoise(y: np.ndarray, h: float) -> np.ndarray:
        return y + math.log(h / 3)

    found = tuning.calibrate(denoise, np.zeros((8, 8)), {"h": [1.0, 2.0, 5.0, 9.0]}, sigma=0.0)
    assert found.parameters["h"] == pytest.approx(3, rel=1e-6)
    assert found.loss == pytest.approx(0, abs=1e-12)


def fails(y: np.ndarray) -> np.ndarray:
    return np.full_like(y, np.nan)


@pytest.mark.parametrize(
    ("work", "error", "says"),
    [
        (lambda y: tuning.sure(fails, y, 1), ValueError, "not finite"),
        (lambda y: tuning.sure(lambda x: x[1:], y, 1), ValueError, "must return an array of shape"),
        (lambda y: tuning.sure(abs, y, -1), ValueError, "sigma must be finite and >= 0"),
        (lambda y: tuning.sure(abs, y, "1"), TypeError, "sigma must be a real number"),
        (lambda y: tuning.sure(abs, y, np.ones(3)), ValueError, "sigma must be a number or broadcast to shape"),
        (lambda y: tuning.sure(abs, y, 1, step=0.0), ValueError, "step must be finite and > 0"),
        (lambda y: tuning.sure(abs, y * np.nan, 1), ValueError, "image must be finite; a mask"),
        (lambda y: tuning.sure(abs, y, 1, mask=np.ones(3, bool)), ValueError, "mask must be boolean of shape"),
        (lambda y: tuning.sure(abs, y, 1, mask=np.zeros(y.shape, bool)), ValueError, "the mask is False everywhere"),
        (lambda y: tuning.sure(abs, y, 1, channel_axis=5), ValueError, "channel_axis must lie in"),
        (lambda y: tuning.sure(abs, y > 0, 1), TypeError, "integers or real numbers, got bool"),
        (lambda y: tuning.j_invariance(abs, y, stride=1), ValueError, "stride must be >= 2"),
        (lambda y: tuning.j_invariance(abs, y, stride=2.5), TypeError, "stride must be an integer"),
        (lambda y: tuning.j_invariance(abs, y, spacing=(1,)), ValueError, "spacing must hold 2"),
        (lambda y: tuning.j_invariance(abs, y[:1, :1]), ValueError, "too small for the stride"),
        (lambda y: tuning.calibrate(abs, y, {}), ValueError, "grid must name"),
        (lambda y: tuning.calibrate(abs, y, {"h": []}), ValueError, "grid must name"),
        (lambda y: tuning.calibrate(abs, y, {"h": [1]}, method="luck"), ValueError, "method must be"),
        (lambda y: tuning.nl_means_parameters(0), ValueError, "sigma must be finite and > 0"),
        (lambda y: tuning.nl_means_parameters(101), ValueError, "the table ends at 100"),
        (lambda y: tuning.nl_means_parameters("1"), TypeError, "sigma must be a number"),
        (lambda y: tuning.nl_means_parameters(1, data_range=-1), ValueError, "data_range must be finite and > 0"),
    ],
)
def test_wrong_arguments_get_a_sentence(work, error: type, says: str) -> None:
    with pytest.raises(error, match=says):
        work(scene((8, 9))[1])


# IPOL 2011, doi 10.5201/ipol.2011.bcm_nlm: sigma, side of the patch, side of the window, h / sigma.
IPOL_GREY = [(0.1, 3, 21, 0.4), (15, 3, 21, 0.4), (15.1, 5, 21, 0.4), (30, 5, 21, 0.4), (31, 7, 35, 0.35)]
IPOL_GREY += [(45, 7, 35, 0.35), (46, 9, 35, 0.35), (75, 9, 35, 0.35), (76, 11, 35, 0.3), (100, 11, 35, 0.3)]
IPOL_COLOUR = [(25, 3, 21, 0.55), (26, 5, 35, 0.4), (55, 5, 35, 0.4), (56, 7, 35, 0.35), (100, 7, 35, 0.35)]


@pytest.mark.parametrize(
    ("color", "row"), [*((False, row) for row in IPOL_GREY), *((True, row) for row in IPOL_COLOUR)]
)
def test_the_table_of_ipol(color: bool, row: tuple[float, int, int, float]) -> None:
    sigma, patch, window, factor = row
    found = tuning.nl_means_parameters(sigma, color=color)
    assert (2 * found.patch_radius + 1, 2 * found.radius + 1, found.sigma) == (patch, window, sigma)
    # theirs divides the distance by the samples
    assert found.h == pytest.approx(factor * sigma * math.sqrt((3 if color else 1) * patch**2), rel=1e-12)
    unit = tuning.nl_means_parameters(sigma / 255, color=color, data_range=1)
    assert unit.h == pytest.approx(found.h / 255, rel=1e-12)
    assert unit.radius == found.radius


def test_the_table_denoises_as_ipol_weighs() -> None:
    """w = exp(-max(mean squared difference - 2 sigma^2, 0)/(k sigma)^2), with the patch inside the image."""
    image = rng(8).normal(128, 22, (9, 9))  # so that some distances are beyond 2 sigma^2, and not far
    found = tuning.nl_means_parameters(20)
    grid = gr.GridGraph((9, 9), 1)
    one = gr.regularize(image, grid, weights=found.weights, lam=0, max_iter=1, solver=gr.Jacobi(damping=1), **NUMPY)
    total = weight = 0.0
    for dy, dx in grid.offsets:
        a, b = image[2:7, 2:7], image[2 + dy : 7 + dy, 2 + dx : 7 + dx]
        w = math.exp(-max(np.mean((a - b) ** 2) - 2 * 20**2, 0) / (0.4 * 20) ** 2)
        total, weight = total + w * image[4 + dy, 4 + dx], weight + w
    assert one.value[4, 4] == pytest.approx(total / weight, rel=1e-9)


def test_gradient_to_noise() -> None:
    """A slope of 3 and 4 a pixel is 5/sqrt(2) in the root mean square over the axes, whatever the noise."""
    slope = np.add.outer(3.0 * np.arange(200), 4.0 * np.arange(210))
    noisy = slope + rng(1).normal(0, 2, slope.shape)
    found = gradient_to_noise(noisy, 2.0, channel_axis=None, mask=None)
    assert found == pytest.approx(5 / math.sqrt(2) / 2, rel=0.02)  # mean square of 42,000 differences: 1 percent
    mask = np.ones(slope.shape, bool)
    mask[50:90, 20:100] = False
    torn = np.where(mask, noisy, np.nan)
    assert gradient_to_noise(torn, 2.0, channel_axis=None, mask=mask) == pytest.approx(found, rel=0.02)
    colour = np.stack([noisy, noisy])
    assert gradient_to_noise(colour, 2.0, channel_axis=0, mask=None) == pytest.approx(found, rel=1e-12)
    assert gradient_to_noise(rng(1).normal(0, 1.9, (50, 50)), 2.0, channel_axis=None, mask=None) == 0
