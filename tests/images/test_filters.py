"""The doors for nonlocal means, the bilateral filter and total variation: against loops, with every option."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math

import numpy as np
import paper
import pytest
from cases import rng
from numpy.testing import assert_allclose, assert_array_equal

import gpureg as gr

# On [0, 1] data with weights of float32: a few hundred roundings of 6e-8 at most.
CLOSE = {"rtol": 0, "atol": 1e-5}


def picture(*shape: int, seed: int = 5) -> np.ndarray:
    """Noise over a step: values in about [0, 1]."""
    step = np.where(np.indices(shape[:2])[0] < shape[0] // 2, 0.25, 0.75).reshape(*shape[:2], *(1,) * (len(shape) - 2))
    return step + 0.1 * rng(seed).standard_normal(shape)


def functions(image, channel_axis):
    """The image's channels, each as a function of the pixel."""
    cells = image[..., None] if channel_axis is None else np.moveaxis(image, channel_axis, -1)
    return [{p: float(cells[(*p, c)]) for p in np.ndindex(cells.shape[:-1])} for c in range(cells.shape[-1])]


def filtered(image, weight, *, radius, metric="chebyshev", lam=2.0, largest=False, channel_axis=None, spacing=None):
    """One sweep at p = 2, pixel by pixel; `weight(u, v)` says what it weighs."""
    f0s = functions(image, channel_axis)
    pixels = list(f0s[0])
    out = np.empty((len(f0s), *np.shape(image if channel_axis is None else np.moveaxis(image, channel_axis, 0)[0])))
    lams = np.broadcast_to(lam, out.shape[1:])
    for u in pixels:
        w = {v: weight(u, v) for v in paper.k_neighbourhood(pixels, u, radius, metric, spacing)}
        own = lams[u] * (max(w.values(), default=0.0) if largest else 1.0)
        total = own + 2 * sum(w.values())
        for c, f0 in enumerate(f0s):
            out[(c, *u)] = (own * f0[u] + 2 * sum(w[v] * f0[v] for v in w)) / total if total > 0 else f0[u]
    return out[0] if channel_axis is None else np.moveaxis(out, 0, channel_axis)


def w2_of(image, h, radius, a=None, sigma=0.0, channel_axis=None):
    """exp(-max(rho - noise, 0)/(h(u) h(v))), with maps or numbers."""
    f0s = functions(image, channel_axis)
    shape = image.shape if channel_axis is None else tuple(np.delete(image.shape, channel_axis))
    g = paper.flat_patch(radius, len(shape)) if a is None else paper.gaussian_patch(radius, len(shape), a)
    hs, sigmas = np.broadcast_to(h, shape), np.broadcast_to(sigma, shape)

    def weight(u, v):
        noise = (sigmas[u] ** 2 + sigmas[v] ** 2) * sum(g.values()) * len(f0s)
        return math.exp(-max(paper.rho(u, v, f0s, shape, g) - noise, 0) / (hs[u] * hs[v]))

    return weight


CASES = [
    ({}, (7, 8), None),
    ({"metric": "euclidean", "patch_sigma": 0.8, "h": 0.12}, (7, 8), None),
    ({"metric": "cityblock", "sigma": 0.1, "h": 0.2}, (7, 8), None),
    ({"lam": 0.7}, (7, 8), None),
    ({"centre": "largest"}, (7, 8), None),
    ({"centre": "largest", "lam": 0.5}, (5, 6, 2), -1),
    ({"centre": "none"}, (7, 8), None),
    ({}, (2, 5, 6), 0),
    ({"patch_radius": 1, "h": 0.8}, (3, 4, 5), None),
    ({"patch_radius": 1, "h": 0.8, "radius": 3, "spacing": (3.0, 1.0, 1.0), "metric": "euclidean"}, (3, 4, 4), None),
]


@pytest.mark.parametrize(("options", "shape", "channel_axis"), CASES)
def test_nl_means_pixel_by_pixel(device, options, shape, channel_axis):
    image = picture(*shape)
    settings = {"patch_radius": 2, "radius": 2, "h": 0.6} | options
    loops = {k: settings[k] for k in ("radius", "metric", "lam", "spacing") if k in settings}
    if settings.get("centre") == "none":
        loops["lam"] = 0.0
    weight = w2_of(
        image,
        settings["h"],
        settings["patch_radius"],
        settings.get("patch_sigma"),
        settings.get("sigma", 0.0),
        channel_axis,
    )
    expected = filtered(image, weight, largest=settings.get("centre") == "largest", channel_axis=channel_axis, **loops)
    actual = gr.denoise_nl_means(image, channel_axis=channel_axis, backend=device, **settings)
    assert_allclose(actual, expected, **CLOSE)


def test_maps_of_h_sigma_and_lam(device):
    image = picture(7, 8)
    h = np.linspace(0.3, 1.2, 56).reshape(7, 8)
    sigma, lam = np.linspace(0, 0.15, 56).reshape(8, 7).T, np.tile([0.0, 0.5, 2.0, np.inf], 14).reshape(7, 8)
    expected = filtered(image, w2_of(image, h, 1, sigma=sigma), radius=2, lam=np.where(np.isinf(lam), 1e12, lam))
    actual = gr.denoise_nl_means(image, patch_radius=1, radius=2, h=h, sigma=sigma, lam=lam, backend=device)
    assert_allclose(actual, expected, **CLOSE)
    assert_array_equal(actual[np.isinf(lam)], image[np.isinf(lam)])


def test_a_map_of_one_value_is_that_value(device):
    image = picture(31, 37)
    number = gr.denoise_nl_means(image, h=0.7, sigma=0.1, backend=device)
    maps = {"h": np.full(image.shape, 0.7), "sigma": np.full(image.shape, 0.1), "lam": np.full(image.shape, 2.0)}
    assert_allclose(gr.denoise_nl_means(image, backend=device, **maps), number, **CLOSE)
    sigma_value = np.full(image.shape, 0.3)
    both = [gr.denoise_bilateral(image, sigma_value=s, backend=device) for s in (0.3, sigma_value)]
    assert_allclose(both[0], both[1], **CLOSE)


def test_maps_go_through_tiles(device):
    image, h = picture(61, 43), np.linspace(0.3, 1.2, 61 * 43).reshape(61, 43)
    for options in ({}, {"average_patches": True}, {"average_patches": "weighted"}, {"centre": "largest"}):
        settings = {"patch_radius": 1, "radius": 3, "h": h, "sigma": h / 10, "lam": h, "backend": device} | options
        whole = gr.denoise_nl_means(image, **settings)
        cut = gr.denoise_nl_means(image, memory=_little(device), **settings)
        assert_array_equal(cut, whole)


def _little(device):
    """So little memory that the picture above is cut: half of what a step with stored weights takes."""
    grid, weights = gr.GridGraph((61, 43), 3), gr.weights.patch(1, 1.0)
    return gr.memory_needed(grid, weights=weights, stored=False, backend=device) // 2 + (1 << 19)


def averaged(image, weight, pixels, radius, patch_radius, by_weight):
    """Estimates of whole patches, and their mean over all patches that cover a pixel (IPOL 2011, patchwise)."""
    total, count = np.zeros((2, *image.shape))
    for u in pixels:
        w = {v: weight(u, v) for v in paper.k_neighbourhood(pixels, u, radius, "chebyshev", None)}
        w[u] = 1.0
        scale = 1.0 if by_weight else 1 / sum(w.values())
        for j in itertools.product(range(-patch_radius, patch_radius + 1), repeat=image.ndim):
            x = tuple(a + b for a, b in zip(u, j, strict=True))
            for v, share in w.items():
                y = tuple(a + b for a, b in zip(v, j, strict=True))
                if x in pixels and y in pixels:
                    total[x] += scale * share * image[y]
                    count[x] += scale * share
    return total / count


@pytest.mark.parametrize("by_weight", [False, True])
@pytest.mark.parametrize(
    ("shape", "radius", "average_radius"), [((7, 8), 2, None), ((7, 8), 2, 1), ((3, 4, 5), 1, None)]
)
def test_averaged_patches(device, shape, radius, average_radius, by_weight):
    image = picture(*shape)
    patch_radius = 2 if len(shape) == 2 else 1
    pixels = dict.fromkeys(np.ndindex(shape))
    weight = w2_of(image, 0.8, patch_radius)
    expected = averaged(image, weight, pixels, radius, average_radius or patch_radius, by_weight)
    actual = gr.denoise_nl_means(
        image,
        patch_radius=patch_radius,
        radius=radius,
        h=0.8,
        average_patches="weighted" if by_weight else True,
        average_radius=average_radius,
        backend=device,
    )
    assert_allclose(actual, expected, **CLOSE)


@pytest.mark.parametrize("metric", ["chebyshev", "euclidean", "cityblock"])
@pytest.mark.parametrize(("shape", "channel_axis"), [((7, 8), None), ((6, 7, 3), 2), ((3, 4, 5), None)])
def test_bilateral_pixel_by_pixel(device, shape, channel_axis, metric):
    image = picture(*shape)
    f0s = functions(image, channel_axis)
    expected = filtered(
        image, lambda u, v: paper.w1(u, v, f0s, 2.0, 0.3), radius=2, metric=metric, channel_axis=channel_axis
    )
    actual = gr.denoise_bilateral(
        image, radius=2, metric=metric, sigma_space=2.0, sigma_value=0.3, channel_axis=channel_axis, backend=device
    )
    assert_allclose(actual, expected, **CLOSE)


NUMPY_NAMES = {
    "reflect": "reflect",
    "symmetric": "symmetric",
    "nearest": "edge",
    "wrap": "wrap",
    "constant": "constant",
}


@pytest.mark.parametrize("border", list(NUMPY_NAMES))
def test_borders_are_numpys(border):
    """The filter of a picture that was padded by hand, wider than window and patch reach."""
    image, guide = picture(13, 11), picture(13, 11, seed=7)
    kind = {"constant_values": 0.4} if border == "constant" else {}
    by_hand = np.pad(image, 9, mode=NUMPY_NAMES[border], **kind)
    settings = {"border": border, "constant": 0.4, "backend": "numpy"}
    for options in ({}, {"average_patches": True}, {"centre": "largest"}):
        options = {"patch_radius": 2, "radius": 3, "h": 0.6, "backend": "numpy"} | options
        expected = gr.denoise_nl_means(by_hand, **options)[9:-9, 9:-9]
        assert_allclose(gr.denoise_nl_means(image, **options | settings), expected, **CLOSE)
    options = {"radius": 3, "sigma_value": 0.4, "backend": "numpy"}
    expected = gr.denoise_bilateral(by_hand, guide=np.pad(guide, 9, mode=NUMPY_NAMES[border], **kind), **options)
    actual = gr.denoise_bilateral(image, guide=guide, **options | settings)
    assert_allclose(actual, expected[9:-9, 9:-9], **CLOSE)


def test_a_guide_decides(device):
    """The joint bilateral filter: flat where the guide is, whatever the image has there; in colour, any axis."""
    image, guide = picture(6, 7), np.where(np.arange(7) < 3, 0.0, 1.0) + np.zeros((6, 1))
    g = functions(guide, None)
    expected = filtered(image, lambda u, v: paper.w1(u, v, g, 3.0, 0.2), radius=2)
    settings = {"radius": 2, "sigma_space": 3.0, "sigma_value": 0.2, "backend": device}
    assert_allclose(gr.denoise_bilateral(image, guide=guide, **settings), expected, **CLOSE)
    colour = np.stack([image, 1 - image], axis=0)
    both = gr.denoise_bilateral(colour, guide=guide, channel_axis=0, **settings)
    assert_allclose(both, np.stack([expected, 1 - expected]), **CLOSE)
    same = gr.denoise_bilateral(image, guide=np.stack([guide] * 2, -1) / math.sqrt(2), **settings)
    assert_allclose(same, expected, **CLOSE)


MASKED = {
    "nonlocal means": (gr.denoise_nl_means, {"h": 0.6}),
    "averaged patches": (gr.denoise_nl_means, {"h": 0.6, "average_patches": True}),
    "largest centre": (gr.denoise_nl_means, {"h": 0.6, "centre": "largest", "border": "nearest"}),
    "bilateral": (gr.denoise_bilateral, {"sigma_value": 0.3}),
    "total variation": (gr.denoise_tv, {"lam": 5, "max_iter": 20}),
    "image": (gr.denoise_image, {"sigma": 0.1, "passes": 1}),
}


@pytest.mark.parametrize("name", MASKED)
def test_masked_pixels_take_no_part(device, name):
    """NaN under the mask; every option keeps them as they are, and nothing of them gets out."""
    image = picture(24, 27)
    mask = rng(9).random(image.shape) < 0.8
    holes = np.where(mask, image, np.nan)
    other = np.where(mask, image, 1e6)
    door, options = MASKED[name]
    result = door(holes, mask=mask, backend=device, **options)
    assert np.isnan(result[~mask]).all()
    assert np.isfinite(result[mask]).all()
    assert_array_equal(door(other, mask=mask, backend=device, **options)[mask], result[mask])
    assert np.abs(result[mask] - image[mask]).max() > 0.05


# the doors, and their options for values up to `scale`
BY_SCALE = {
    "nonlocal means": (gr.denoise_nl_means, lambda scale: {"h": 0.5 * scale}),
    "bilateral": (gr.denoise_bilateral, lambda scale: {"sigma_value": 0.3 * scale}),
    "total variation": (gr.denoise_tv, lambda scale: {"lam": 8 / scale, "max_iter": 10}),
}


@pytest.mark.parametrize("name", BY_SCALE)
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32", "float64"])
def test_types_and_layouts(dtype, name):
    image = picture(20, 22)
    if np.dtype(dtype).kind == "u":
        image = np.clip(image, 0, 1) * np.iinfo(dtype).max
    image = image.astype(dtype)
    scale = 1.0 if np.dtype(dtype).kind == "f" else float(np.iinfo(dtype).max)
    frozen, strided = image.copy(), np.zeros((40, 66), dtype)[::2, ::3]
    frozen.flags.writeable = False
    strided[...] = image
    door, options = BY_SCALE[name]
    call = functools.partial(door, backend="numpy", **options(scale))
    result = call(image)
    assert result.dtype == dtype and result.shape == image.shape
    assert_array_equal(call(frozen), result)
    assert_array_equal(call(strided), result)
    assert_array_equal(call(np.asfortranarray(image)), result)
    assert (result != image).any()


def test_tv_is_regularize_on_g0():
    image = picture(12, 13)
    direct = gr.regularize(
        image, gr.GridGraph(image.shape, 1, "cityblock"), p=1, lam=6.0, max_iter=40, dtype="float32", backend="numpy"
    ).value
    assert_allclose(gr.denoise_tv(image, lam=6.0, max_iter=40, backend="numpy"), direct, **CLOSE)
    chosen = gr.denoise_tv(image, backend="numpy")  # lam from the noise
    assert np.std(chosen[:5]) < 0.6 * np.std(image[:5])


def test_parameters_left_out_follow_the_noise():
    image = picture(48, 48)
    quiet = gr.denoise_nl_means(image, backend="numpy")
    assert np.std(quiet[2:20]) < 0.5 * np.std(image[2:20])
    quiet = gr.denoise_bilateral(image, backend="numpy")
    assert np.std(quiet[2:20]) < 0.5 * np.std(image[2:20])
    flat = np.full((9, 9), 7, np.uint8)
    for door in (gr.denoise_nl_means, gr.denoise_bilateral):
        assert_array_equal(door(flat, backend="numpy"), flat)


def test_a_plan_without_averaging_where_it_does_not_fit():
    """The door leaves it out; what it did is what the plan without it does."""
    image = picture(24, 27)
    plan = gr.plan_denoising(image, sigma=0.1)
    assert plan.average_patches
    plain = gr.run_plan(dataclasses.replace(plan, average_patches=False), image, backend="numpy").value
    seen = gr.denoise_image(image, sigma=0.1, callback=lambda check: None, backend="numpy")
    assert_allclose(seen, plain, **CLOSE)
    assert np.abs(gr.denoise_image(image, sigma=0.1, backend="numpy") - plain).max() > 1e-3


def test_a_guide_without_noise_is_trusted():
    """With a clean guide the default does better than without one, at edges too faint to be seen in the noise.

    Measured: 0.81 of the error without a guide.
    """
    clean = 0.5 + 0.05 * np.sign(np.sin(np.arange(64) / 5.0)) + np.zeros((64, 1))
    noisy = clean + 0.1 * rng(3).standard_normal(clean.shape)
    by_guide = gr.denoise_image(noisy, guide=clean, backend="numpy")
    assert np.std(by_guide - clean) < 0.9 * np.std(gr.denoise_image(noisy, backend="numpy", passes=1) - clean)


def test_the_edge_norm_has_a_smaller_lam():
    image = picture(20, 22)
    whole = gr.plan_denoising(image, p=1).lam
    by_rule = gr.denoise_image(image, p=1, norm="edge", max_iter=20, backend="numpy")
    by_hand = gr.denoise_image(image, p=1, lam=0.7 * whole, norm="edge", max_iter=20, backend="numpy")
    assert_allclose(by_rule, by_hand, **CLOSE)


def test_the_complete_graph(device):
    """A window that holds the whole picture: every two pixels are neighbours."""
    image = picture(6, 7)
    pixels = list(np.ndindex(image.shape))
    weight = w2_of(image, 0.8, 1)
    w = np.array([[weight(u, v) for v in pixels] for u in pixels])  # with w(u, u) = 1, which lam = 2 is
    expected = (w @ image.ravel() / w.sum(axis=1)).reshape(image.shape)
    actual = gr.denoise_nl_means(image, patch_radius=1, radius=math.inf, h=0.8, backend=device)
    assert_allclose(actual, expected, **CLOSE)
    assert gr.GridGraph((6, 7), math.inf).n_edges == 42 * 41
