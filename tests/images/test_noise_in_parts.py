"""What a plan says of the noise is applied to parts of an image with the same bits as to the whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import rng
from small_passes import with_small_passes

import gpureg as gr
from gpureg.images import parts
from gpureg.images.passes import PatchPass
from gpureg.images.raster import Raster

HOST = {"solver": "jacobi", "backend": "numpy", "dtype": np.dtype(np.float32)}


def scene() -> np.ndarray:
    return np.kron(rng(0).uniform(40, 200, (4, 4)), np.ones((36, 40)))


def pictures() -> dict[str, tuple[np.ndarray, int | None]]:
    clean = scene()
    noisy = clean + rng(1).normal(0, 15, clean.shape)
    at = rng(2).random(clean.shape)
    salted = np.where(at < 0.03, 0, np.where(at < 0.06, 255, np.clip(noisy, 0, 255))).astype(np.uint8)
    photons = 100 + 4.0 * rng(3).poisson(clean / 2)
    photons[rng(4).random(clean.shape) < 0.01] += 900
    boxed = np.full((220, 230), 9.0)
    boxed[30:174, 40:200] = noisy
    two = np.stack([noisy, np.flipud(clean) + rng(5).normal(0, 60, clean.shape)])
    return {
        "salt and pepper": (salted, None),
        "photons and hot pixels": (photons, None),
        "letterbox": (boxed, None),
        "channels": (two, 0),
        "impulses alone": (np.where(at < 0.02, 255.0, clean), None),
        "far from 0": (noisy + 1e7 + np.linspace(0, 3000, 160), None),
    }


@pytest.mark.parametrize("name", pictures())
def test_parts_give_the_bits_of_the_whole(name: str) -> None:
    image, axis = pictures()[name]
    plan = with_small_passes(gr.plan_denoising(image, channel_axis=axis, radius=3))
    assert len(plan.passes) == 2 * (name != "impulses alone")
    expects = {
        "salt and pepper": plan.replaces_impulses,
        "photons and hot pixels": plan.replaces_impulses and plan.photon,
        "letterbox": plan.flat_side,
        "channels": len(plan.groups) == 2,
        "impulses alone": plan.max_iter == 0 and plan.replaces_impulses,
        "far from 0": plan.frame is not None and plan.frame.offset is not None,
    }
    assert expects[name]
    whole = gr.run_plan(plan, image, channel_axis=axis, backend="numpy").value
    raster = Raster.of(image, axis)
    tiles = None
    for power in np.arange(26, 18, -0.1):  # the fewest parts
        memory = int(2**power)
        tiles = parts.tiles_of(plan, raster.shape, raster.channels, masked=False, memory=memory, **HOST)
        if tiles is None or len(tiles) > 1:
            break
    assert tiles is not None and len(tiles) > 1
    assert any(tile.wide[0].start > 0 or tile.wide[1].start > 0 for tile in tiles)
    joined = np.empty((*raster.shape, raster.channels), image.dtype)
    for tile in tiles:
        part = Raster(raster.cells[tile.wide], None, -1)
        own = parts.part_of(plan, raster.shape, tile)
        joined[tile.own], _ = parts.run_part(own, part, tile, None, backend="numpy")
    expected = whole[..., None] if axis is None else np.moveaxis(whole, axis, -1)
    assert np.array_equal(joined, expected)


def test_thin_axes_change_nothing() -> None:
    noisy = (scene() + rng(1).normal(0, 15, (144, 160)))[:48, :50]
    expected = gr.denoise_image(noisy, backend="numpy", passes=2)
    for shape in ((48, 50, 1), (1, 48, 50), (48, 1, 50), (1, 48, 1, 50)):
        thin = gr.denoise_image(noisy.reshape(shape), backend="numpy", spacing=(1.0,) * len(shape), passes=2)
        assert np.array_equal(thin.reshape(48, 50), expected)
    colour = np.stack([noisy, noisy[::-1]], -1)
    host = {"channel_axis": -1, "backend": "numpy", "passes": 1}
    assert np.array_equal(gr.denoise_image(colour[:, None], **host)[:, 0], gr.denoise_image(colour, **host))
    lam, sigma = np.full((1, 48, 50), 1.5), np.full((1, 48, 1), 15.0)
    with_maps = gr.denoise_image(noisy[None], lam=lam, sigma=sigma, backend="numpy", passes=2)
    sigma = np.broadcast_to(sigma[0], (48, 50))
    assert np.array_equal(with_maps[0], gr.denoise_image(noisy, lam=lam[0], sigma=sigma, backend="numpy", passes=2))


def test_sigma_in_all_its_forms() -> None:
    clean = scene()
    image = np.stack([clean + rng(6).normal(0, 5, clean.shape), clean + rng(7).normal(0, 30, clean.shape)], -1)
    host = {"channel_axis": -1, "backend": "numpy", "radius": 4, "passes": 1}
    each = gr.denoise_image(image, sigma=[5, 30], **host)
    own = {"backend": "numpy", "radius": 4, "passes": 1}
    alone = [gr.denoise_image(image[..., i], sigma=s, **own) for i, s in enumerate((5, 30))]
    assert all(np.array_equal(each[..., i], alone[i]) for i in range(2))
    of_pixels = np.broadcast_to(np.array([5.0, 30.0]), image.shape)
    maps = gr.denoise_image(image, sigma=of_pixels, **host)
    assert np.abs(maps - each).max() < 1e-3  # a map of one value: other arithmetic, float32
    report = gr.describe_noise(image, channel_axis=-1)
    assert np.array_equal(gr.denoise_image(image, sigma=report, **host), gr.denoise_image(image, **host))
    light = 100 + 3.0 * rng(8).poisson(clean)
    line = gr.PhotonNoise(3.0, 0.0, 100.0)
    found, given = (gr.denoise_image(light, sigma=s, **own) for s in ("photon", line))
    truth = 100 + 3 * clean
    assert np.std(found - truth) < 1.05 * np.std(given - truth) < 0.5 * np.std(light - truth)
    for wrong, says in ((np.ones(3), "a shape that fits"), ("poisson", "photon"), ([-1, 2], ">= 0 in each channel")):
        with pytest.raises((TypeError, ValueError), match=says):
            gr.denoise_image(image, sigma=wrong, **host)


def test_a_channel_is_never_worse_than_alone() -> None:
    clean = scene()
    weak, strong = clean + rng(9).normal(0, 2, clean.shape), 100 + rng(10).normal(0, 50, clean.shape)
    host = {"backend": "numpy", "radius": 4, "passes": 1}
    both = gr.denoise_image(np.stack([weak, strong]), channel_axis=0, **host)
    assert np.std(both[0] - clean) < 2
    assert np.array_equal(both[0], gr.denoise_image(weak, **host))
    grey = gr.denoise_image(np.stack([weak] * 3, -1), channel_axis=-1, **host)
    assert all(np.array_equal(grey[..., i], both[0]) for i in range(3))


def test_impulses_are_samples_without_data() -> None:
    clean = scene()
    noisy = clean + rng(11).normal(0, 15, clean.shape)
    at = rng(12).random(clean.shape) < 0.05
    hit = np.where(at, np.where(rng(13).random(clean.shape) < 0.5, 0, 255), np.clip(noisy, 0, 255)).astype(np.uint8)
    plain, treated = (gr.denoise_image(f, backend="numpy", radius=4, passes=1) for f in (np.clip(noisy, 0, 255), hit))
    assert np.std(treated - clean) < 1.1 * np.std(plain - clean)
    alone = np.where(at, 255.0, clean)
    # measured 0.26: those at the edges of the scene, and pairs of them, stay
    assert np.std(gr.denoise_image(alone, backend="numpy") - clean) < 0.3 * np.std(alone - clean)
    plan = replace(gr.plan_denoising(hit), impulses=())
    assert "impulses" not in plan.describe()


def test_a_part_in_areas_of_equal_values_stays_as_it_is() -> None:
    """The whole leaves these areas out: a part that has nothing else does not smooth the step between two of them."""
    image = np.full((90, 80), 100.0)
    image[:, :40] = 104
    image[:30] = (scene() + rng(1).normal(0, 15, (144, 160)))[:30, :80]
    plan = with_small_passes(gr.plan_denoising(image, sigma=15, radius=3))
    assert plan.flat_side
    whole, part = (gr.run_plan(plan, part, backend="numpy").value for part in (image, image[40:]))
    assert np.array_equal(part, whole[40:])


def test_an_image_of_equal_values_alone_is_denoised() -> None:
    step = np.where(np.arange(40) < 20, 100.0, 104.0) * np.ones((40, 1))
    assert gr.plan_denoising(step, sigma=15).flat_side == 0
    value = gr.denoise_image(step, sigma=15, radius=3, backend="numpy", passes=1)
    assert np.ptp(value[:, 19:21]) < 2


def test_the_halo_of_a_pass_holds_the_nearest_pixel_inside_a_mask() -> None:
    """A cell in the corner of a patch, (1, 2, 2) from its middle, takes a value up to 3 away along any axis."""
    one = PatchPass((1, 2, 2), (7, 7, 7), (3, 4, 4), 40, 64)
    assert np.subtract(one.beyond(masked=True), one.beyond(masked=False)).tolist() == [3, 3, 3]
