"""The door for images: with no parameter, with every one, masked, in every dtype; and the noise it finds."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace

import numpy as np
import pytest
from cases import TOLERANCES, rng

import gpureg as gr
from gpureg.images import guides as pixels
from gpureg.images import noise as found
from gpureg.images import on_device


def blocks(shape: tuple[int, ...] = (48, 64), size: int = 16) -> np.ndarray:
    """A clean picture: a checkerboard of large cells, 60 and 190."""
    cells = sum(np.indices(shape)[d] // size for d in range(len(shape)))
    return np.where(cells % 2, 190.0, 60.0)


def noisy(clean: np.ndarray, sigma: float, seed: int = 3) -> np.ndarray:
    return clean + rng(seed).standard_normal(clean.shape) * sigma


def psnr(image: np.ndarray, clean: np.ndarray) -> float:
    return 10 * np.log10(255**2 / np.mean((np.asarray(image, float) - clean) ** 2))


# Measured at three seeds: 8.5 to 9.2 dB in grey, 14.4 to 14.8 in colour.
@pytest.mark.parametrize(("channels", "gain"), [(1, 8), (3, 14)])
def test_without_parameters(device: str, channels: int, gain: float) -> None:
    clean = blocks()
    picture = clean if channels == 1 else np.stack([clean, 255 - clean, 0.5 * clean], axis=-1)
    before = noisy(picture, 20)
    after = gr.denoise_image(before, channel_axis=None if channels == 1 else -1, backend=device)
    assert after.shape == before.shape
    assert after.dtype == before.dtype
    assert psnr(after, picture) > psnr(before, picture) + gain


@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint16", "int32", "float16", "float32", "float64"])
def test_dtype_comes_back(dtype: str) -> None:
    scale = {"uint8": 1, "int8": 0.5, "uint16": 200, "int32": 1e6, "float16": 1}.get(dtype, 1 / 255)
    clean = blocks() * scale
    before = noisy(clean, 15 * scale)
    kind = np.dtype(dtype)
    if kind.kind in "iu":
        before = np.clip(np.rint(before), np.iinfo(kind).min, np.iinfo(kind).max)
        clean = np.clip(clean, np.iinfo(kind).min, np.iinfo(kind).max)
    before = before.astype(kind)
    after = gr.denoise_image(before, backend="numpy", passes=1)
    assert after.dtype == kind
    assert np.std(after.astype(float) - clean) < 0.5 * np.std(before.astype(float) - clean)


def test_values_are_not_rescaled() -> None:
    """The same picture in other units gives the same picture in those units."""
    before = noisy(blocks(), 20)
    whole = gr.denoise_image(before, backend="numpy", dtype="float64", passes=2)
    shifted = gr.denoise_image(before / 255 + 7, backend="numpy", dtype="float64", passes=2)
    assert np.abs(255 * (shifted - 7) - whole).max() < 1e-4  # the contrast is taken in float32: 7.7 * 2^-24 of it


def test_strided_and_readonly_input() -> None:
    before = noisy(blocks(), 20)
    frozen = before.copy()
    frozen.flags.writeable = False
    padded = np.zeros((96, 128))
    padded[::2, ::2] = before
    expected = gr.denoise_image(before, backend="numpy", passes=1)
    assert np.array_equal(gr.denoise_image(frozen, backend="numpy", passes=1), expected)
    assert np.array_equal(gr.denoise_image(padded[::2, ::2], backend="numpy", passes=1), expected)
    assert np.array_equal(gr.denoise_image(before.T, backend="numpy", passes=1).shape, before.T.shape)


def test_channels_may_lie_anywhere() -> None:
    before = noisy(np.stack([blocks(), 255 - blocks(), blocks() / 2], axis=-1), 20)
    last = gr.denoise_image(before, channel_axis=-1, backend="numpy", passes=1)
    first = gr.denoise_image(np.moveaxis(before, -1, 0), channel_axis=0, backend="numpy", passes=1)
    assert np.array_equal(np.moveaxis(first, 0, -1), last)


ONE_SWEEP = {
    "bilateral": {"weights": gr.weights.bilateral(2.0, 60.0), "radius": 2},
    "patches": {"weights": gr.weights.patch(1, 150.0, sigma=20.0), "radius": 3, "metric": "euclidean"},
    "opponent colours": {},
}


@pytest.mark.parametrize("name", ONE_SWEEP)
@pytest.mark.parametrize("channels", [None, -1])
def test_one_sweep_is_that_of_regularize(device: str, name: str, channels: int | None) -> None:
    """At p = 2 one iteration of weights that are not stored: the same as with stored ones, but for the energies."""
    picture = blocks((35, 43)) if channels is None else np.stack([blocks((35, 43))] * 3, -1)
    before = noisy(picture, 20).astype(np.float32)
    mask = np.ones(before.shape[:2], bool)
    mask[3:9, 30:] = False
    lam = np.where(rng(5).random(mask.shape) < 0.1, np.inf, rng(7).random(mask.shape) + 0.5)
    chosen = gr.plan_denoising(before, sigma=20.0, lam=lam, mask=mask, channel_axis=channels, **ONE_SWEEP[name])
    chosen = replace(chosen, average_patches=False)  # which is no sweep of the process
    result = gr.run_plan(chosen, before, mask=mask, channel_axis=channels, backend=device)
    assert len(result.energy) == len(result.checks) == 0
    assert (result.iterations, result.stop) == (1, gr.Stop.MAX_ITER)
    data = pixels.filled(before.reshape(*mask.shape, -1), mask)
    grid = gr.GridGraph(mask.shape, chosen.radius, chosen.metric, mask=mask)
    stored = gr.regularize(
        data, grid, p=2, lam=lam, weights=chosen.weights, max_iter=1, backend="numpy", dtype="float64"
    )
    far = np.abs(result.value - stored.value.reshape(before.shape))[mask]
    assert far.max() <= TOLERANCES["float32"] * np.abs(before).max()


def test_a_plain_sweep_alone_goes_without_stored_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any other wish needs what the one step does not give, and runs as ever."""
    before = noisy(blocks((20, 24)), 20)
    calls = []
    step = on_device.device_step
    monkeypatch.setattr(on_device, "device_step", lambda *a, **k: calls.append(1) or step(*a, **k))
    call = {"weights": gr.weights.bilateral(2.0, 60.0), "radius": 2, "sigma": 20.0, "backend": "numpy"}
    for wish in ({}, {"lam": 0, "solver": gr.Jacobi(damping=1)}, {"dtype": "float64"}, {"solver": gr.Jacobi()}):
        gr.denoise_image(before, **{**call, **wish})
    assert len(calls) == 4
    for wish in (
        {"max_iter": 2},
        {"p": 1, "lam": 0.1, "max_iter": 1},
        {"tol": 1e-3},
        {"callback": lambda check: None},
        {"solver": gr.Jacobi(damping=0.5)},
        {"solver": "euler"},
        {"lam": 0},  # the default may be damped there
        {"weights": gr.weights.constant()},
    ):
        gr.denoise_image(before, **{**call, **wish})
    assert len(calls) == 4


def test_noise_is_not_looked_for_where_it_decides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    before = noisy(blocks(), 20)
    looked = []
    estimate = found.survey
    monkeypatch.setattr(found, "survey", lambda *a, **k: looked.append(1) or estimate(*a, **k))
    given = gr.plan_denoising(before, weights=gr.weights.bilateral(2.0, 60.0), lam=2)
    assert given.sigma is None and not given.estimated
    assert "bilateral" in given.describe()
    assert gr.plan_denoising(before, p=1, lam=0.1, weights=gr.weights.constant()).sigma is None
    assert gr.plan_denoising(before, weights=gr.weights.bilateral(2.0, 60.0), sigma=5.0).sigma == 5.0
    assert not looked
    deciding = ({}, {"p": 1}, {"weights": gr.weights.constant()}, {"lam": 2})
    assert [some for some in deciding if not gr.plan_denoising(before, **some).estimated] == []
    assert len(looked) == 4


def test_mask_and_nan() -> None:
    clean = blocks()
    before = noisy(clean, 20)
    mask = np.ones(clean.shape, bool)
    mask[10:20, 5:30] = False
    before[~mask] = np.nan
    after = gr.denoise_image(before, mask=mask, backend="numpy")
    assert np.isnan(after[~mask]).all()
    assert psnr(after[mask], clean[mask]) > psnr(before[mask], clean[mask]) + 7
    with pytest.raises(ValueError, match="image must be finite, got nan"):
        gr.denoise_image(before, backend="numpy")
    with pytest.raises(ValueError, match="mask must be boolean of shape"):
        gr.denoise_image(before, mask=mask.astype(int))


def test_patches_over_the_mask_see_the_nearest_pixel() -> None:
    """What stands outside the mask does not matter, and tiles agree with the whole image there too."""
    before = noisy(blocks((60, 40)), 20)
    mask = np.ones(before.shape, bool)
    mask[20:34, 8:22] = False
    call = {"mask": mask, "sigma": 20.0, "backend": "numpy"}
    averaged = gr.denoise_image(np.where(mask, before, np.nan), **call)
    assert np.array_equal(gr.denoise_image(np.where(mask, before, -9999.0), **call)[mask], averaged[mask])
    # the same by hand: the nearest values put there, weights computed from them
    call |= {"weights": gr.weights.patch(2, 50.0, sigma=20.0), "lam": 1.0}
    filled = pixels.filled(before[..., None], mask)[..., 0]
    whole = gr.denoise_image(np.where(mask, before, np.nan), **call)
    grid = gr.GridGraph(before.shape, 7, mask=mask)
    settings = {"weights": call["weights"], "lam": 1.0, "max_iter": 1, "backend": "numpy"}
    by_hand = gr.regularize(filled.astype(np.float32), grid, **settings)
    near = TOLERANCES["float32"] * np.abs(before).max()  # sums in another order
    assert np.abs(by_hand.value[mask] - whole[mask]).max() <= near
    zeros = np.where(mask, before, 0).astype(np.float32)
    darker = gr.regularize(zeros, grid, **settings)
    assert np.abs(darker.value[mask] - whole[mask]).max() > 100 * near  # so that the above can fail
    tiled = gr.denoise_image(np.where(mask, before, np.nan), **call, memory=900_000)
    assert np.array_equal(tiled[mask], whole[mask])


def test_volume_without_parameters() -> None:
    clean = blocks((12, 32, 32), 8)
    before = noisy(clean, 20)
    plan = gr.plan_denoising(before)
    assert "5x5x5 window, 5x5x5" in plan.describe()
    after = gr.denoise_image(before, backend="numpy")
    # Measured at three seeds: 11.2 to 11.3 dB.
    assert psnr(after, clean) > psnr(before, clean) + 10


def test_volume_with_spacing() -> None:
    clean = blocks((10, 24, 26), 8)
    before = noisy(clean, 20)
    settings = {"weights": gr.weights.bilateral(1.5, 70.0), "radius": 3, "metric": "euclidean", "backend": "numpy"}
    after = gr.denoise_image(before, spacing=(3, 1, 1), **settings)
    assert psnr(after, clean) > psnr(before, clean) + 5
    assert not np.array_equal(after, gr.denoise_image(before, **settings))


def test_plan_is_what_is_done() -> None:
    before = noisy(blocks(), 20)
    plan = gr.plan_denoising(before)
    result = gr.run_plan(plan, before, backend="numpy")
    assert np.array_equal(result.value, gr.denoise_image(before, backend="numpy"))
    assert plan.estimated
    assert "nonlocal" in plan.describe()
    assert gr.plan_denoising(before, sigma=5.0).sigma == 5.0


def test_given_parameters_are_kept() -> None:
    before = noisy(blocks(), 20)
    plan = gr.plan_denoising(before, p=1.0, lam=0.3, radius=2, metric="euclidean", max_iter=7, tol=1e-3, eps=0.5)
    assert (plan.p, plan.lam, plan.radius, plan.metric) == (1.0, 0.3, 2, "euclidean")
    assert (plan.max_iter, plan.tol, plan.eps) == (7, 1e-3, 0.5)
    local = gr.plan_denoising(before, p=1)
    assert (local.radius, local.metric) == (1, "cityblock")
    # lam follows the scale law: 255 times the values, lam times 255^(p - 2)
    scaled = gr.plan_denoising(before / 255, p=1)
    assert scaled.lam == pytest.approx(255 * local.lam, rel=1e-9)


# Measured at three seeds: 8.5 to 9.2, 6.5 to 6.9 and 4.3 to 4.6 dB; larger p blurs the edges.
@pytest.mark.parametrize(
    ("options", "gain"),
    [
        ({"p": 0.7}, 8),
        ({"p": 1}, 6),
        ({"p": 1.5}, 4),
        ({"weights": gr.weights.bilateral(3.0, 60.0)}, 5),
        ({"weights": gr.weights.patch(2, 60.0, sigma=20.0)}, 5),
        ({"weights": gr.weights.constant()}, 1.5),
    ],
    ids=str,
)
def test_given_parameters_denoise(options: dict, gain: float) -> None:
    before = noisy(blocks(), 20)
    after = gr.denoise_image(before, **options, backend="numpy")
    assert psnr(after, blocks()) > psnr(before, blocks()) + gain


@pytest.mark.parametrize(
    "clean",
    # a number that float32 does not hold: the image must not take the way through the device
    [blocks() + 1e-9, blocks().astype(np.uint8), np.full((20, 20), 7.0), np.zeros((5, 5), np.uint16)],
    ids=["float64", "uint8", "flat", "zero"],
)
def test_clean_pictures_stay_as_they_are(clean: np.ndarray) -> None:
    plan = gr.plan_denoising(clean)
    assert plan.max_iter == 0
    assert "nothing to do" in plan.describe()
    assert np.array_equal(gr.denoise_image(clean, backend="numpy"), clean)


@pytest.mark.parametrize("settings", [{}, {"sigma": 10.0}, {"p": 1, "sigma": 10.0}], ids=str)
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (2, 2), (3, 5), (2, 30)])
def test_tiny_pictures(shape: tuple[int, int], settings: dict) -> None:
    tiny = noisy(np.full(shape, 100.0), 10)
    unknown = "sigma" not in settings and 1 < tiny.size < 50
    told = pytest.warns(match="cannot be told") if unknown else contextlib.nullcontext()
    with told:
        after = gr.denoise_image(tiny, backend="numpy", **settings)
    assert after.shape == shape
    assert np.isfinite(after).all()
    if unknown:
        assert np.array_equal(after, tiny)


@pytest.mark.parametrize(
    ("wrong", "error", "says"),
    [
        ({"image": np.zeros(5)}, ValueError, "two or more axes"),
        ({"image": np.zeros((0, 5))}, ValueError, "empty"),
        ({"image": np.zeros((5, 5), bool)}, TypeError, "integers or real numbers, got bool"),
        ({"image": np.zeros((5, 5), complex)}, TypeError, "got complex"),
        ({"channel_axis": 2}, ValueError, "channel_axis must lie in -2..1, got 2"),
        ({"sigma": -1}, ValueError, "sigma must be finite and >= 0, got -1"),
        ({"sigma": math.nan}, ValueError, "sigma must be finite"),
        ({"sigma": "a"}, ValueError, "sigma must be a number, numbers, a map, .* got 'a'"),
        ({"p": "2"}, TypeError, "p must be a number, got '2'"),
        ({"channel_axis": True}, TypeError, "channel_axis must be an integer"),
        ({"image": np.ma.masked_array(np.zeros((5, 5)))}, TypeError, "masked array"),
        ({"spacing": 2, "sigma": 1}, ValueError, "spacing must hold 2 numbers"),
        ({"p": -1}, ValueError, "p must be finite and >"),
        ({"p": 0}, ValueError, "p must be finite and > 0"),
        ({"lam": -1, "sigma": 1}, ValueError, "lam must be >= 0"),
        ({"radius": 0, "sigma": 1}, ValueError, "radius must be > 0, got 0"),
        ({"metric": "round", "sigma": 1}, ValueError, 'metric must be "chebyshev", "euclidean" or "cityblock"'),
        ({"max_iter": -1, "sigma": 1}, ValueError, "max_iter must be >= 0"),
        ({"spacing": (1,), "sigma": 1}, ValueError, "spacing must hold 2"),
        ({"backend": "cuda"}, ValueError, "unknown backend"),
    ],
)
def test_wrong_arguments_get_a_sentence(wrong: dict, error: type, says: str) -> None:
    call = {"image": noisy(blocks((12, 12), 4), 20), "backend": "numpy", **wrong}
    with pytest.raises(error, match=says):
        gr.denoise_image(call.pop("image"), **call)


@pytest.mark.parametrize("scale", [1e-6, 0.1, 100.0])
def test_windows_follow_the_spacing(scale: float) -> None:
    """No radius given: the window is one of cells, whatever unit these are measured in."""
    before = noisy(blocks(), 20)
    plain, scaled = gr.plan_denoising(before), gr.plan_denoising(before, spacing=(scale, scale))
    assert scaled.window == plain.window == (21, 21)
    assert scaled.describe() == plain.describe()
    assert np.array_equal(
        gr.denoise_image(before, spacing=(scale, scale), backend="numpy"), gr.denoise_image(before, backend="numpy")
    )
    volume = noisy(blocks((9, 20, 20), 8), 20)
    thick = gr.plan_denoising(volume, spacing=(3 * scale, scale, scale))
    assert thick.window == (3, 7, 7)  # the neighbouring slices take part
    nearest = gr.plan_denoising(volume, p=1, spacing=(3 * scale, scale, scale))
    assert nearest.window == (3, 3, 3)
    assert "6 neighbours" in nearest.describe()
    assert gr.plan_denoising(before, radius=1e9).window == (95, 127)


@pytest.mark.parametrize("settings", [{}, {"p": 1}], ids=str)
def test_no_noise_given_or_found_is_the_same(settings: dict) -> None:
    before = noisy(blocks(), 20)
    assert np.array_equal(gr.denoise_image(before, sigma=0, backend="numpy", **settings), before)


def test_interruption_gives_an_image(monkeypatch: pytest.MonkeyPatch) -> None:
    before = noisy(blocks(), 20).astype(np.uint8)

    def press(check: gr.Check) -> None:
        if check.iteration >= 20:
            raise KeyboardInterrupt

    with pytest.raises(gr.Interrupted) as caught:
        gr.denoise_image(before, p=1, max_iter=100, backend="numpy", callback=press)
    assert caught.value.result.iterations == 20
    assert caught.value.result.value.dtype == np.uint8
    assert caught.value.result.value.shape == before.shape


@pytest.mark.parametrize(("name", "sigma"), [("camera", 10), ("set12_02_house", 20), ("set12_02_house", 40)])
def test_photographs_beside_tuned_nonlocal_means(name: str, sigma: int, data_folder) -> None:
    """No parameter, noise unknown: not under scikit-image's fast one, which is told the noise and tuned per picture."""
    restoration = pytest.importorskip("skimage.restoration", reason="scikit-image is not installed")
    from skimage import color, io

    clean = io.imread(data_folder / "images" / f"{name}.png")
    clean = (255 * color.rgb2gray(clean) if clean.ndim == 3 else clean).astype(np.float32)
    before = (clean + np.random.default_rng(0).standard_normal(clean.shape) * sigma).astype(np.float32)
    peer = max(
        psnr(restoration.denoise_nl_means(before, 5, 10, h * sigma, fast_mode=True, sigma=sigma), clean)
        for h in (0.5, 0.6, 0.7)
    )
    ours = psnr(gr.denoise_image(before), clean)
    assert ours > peer, f"{ours:.2f} dB beside {peer:.2f}"


@pytest.mark.parametrize(("name", "gain"), [("kodim08", 7.0), ("kodim19", 8.5)])
def test_colour_photographs(name: str, gain: float, data_folder) -> None:
    """kodim08 is texture all over: scikit-image's best gains 5.95 dB there, state of the art (BM3D) 9.0."""
    from skimage import io

    pytest.importorskip("skimage.io", reason="scikit-image is not installed")
    clean = io.imread(data_folder / "images" / f"{name}.png").astype(np.float32)
    before = (clean + np.random.default_rng(0).standard_normal(clean.shape) * 20).astype(np.float32)
    after = gr.denoise_image(before, channel_axis=-1)
    assert psnr(after, clean) > psnr(before, clean) + gain


def test_a_wrong_limit_is_told_even_where_nothing_is_to_be_done() -> None:
    with pytest.raises(ValueError, match="memory must be >= 1, got -1"):
        gr.denoise_image(np.zeros((9, 9)), memory=-1, backend="numpy")
