"""An image that is denoised in parts has the bits of the whole, whatever the parts."""

from __future__ import annotations

import numpy as np
import pytest
from small_passes import with_small_passes

import gpureg as gr
from gpureg import backends
from gpureg.backends import failures
from gpureg.images import parts
from gpureg.images.raster import Raster

CASES = {
    "grey": ((121, 130), None, {"radius": 3, "passes": 2}),
    "colour": ((121, 130, 3), -1, {"radius": 2, "passes": 2}),
    "channels first": ((2, 40, 50), 0, {"radius": 3, "passes": 1}),
    "volume": ((96, 10, 12), None, {"passes": 2}),
    "bilateral": ((121, 130), None, {"weights": "bilateral", "radius": 4, "sigma_value": 40.0, "passes": 3}),
    "plain averages": ((40, 50), None, {"weights": "patch", "radius": 3, "average_patches": True}),
    "map": ((121, 130), None, {"sigma": "a map", "radius": 4, "passes": 2}),
    "guide": ((40, 50), None, {"guide": "another", "weights": "patch", "radius": 4}),
}


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_parts_have_the_bits_of_the_whole(monkeypatch, name, masked):
    shape, axis, choice = CASES[name]
    rng = np.random.default_rng(3)
    image = (rng.normal(100, 20, shape) + np.indices(shape).sum(axis=0)).astype(np.float32)
    cells = shape if axis is None else tuple(n for i, n in enumerate(shape) if i != axis % len(shape))
    choice = {"sigma": 20.0} | choice
    if isinstance(choice["sigma"], str):
        choice["sigma"] = rng.uniform(15, 25, cells)
    guide = rng.normal(100, 5, shape) if choice.pop("guide", None) else None
    mask = None
    if masked:
        mask = rng.random(cells) < 0.8
        mask[tuple(slice(n // 4, 2 * n // 3) for n in cells)] = False
    plan = with_small_passes(gr.plan_denoising(image, channel_axis=axis, mask=mask, guide=guide, **choice))
    whole = gr.run_plan(plan, image, channel_axis=axis, mask=mask, guide=guide, backend="numpy").value
    raster = Raster.of(image, axis, mask)
    kinds = {"solver": "jacobi", "backend": "numpy", "dtype": np.dtype(np.float32), "masked": masked}
    assert len(parts.tiles_of(plan, raster.shape, raster.channels, **kinds, memory=2**40)) == 1
    monkeypatch.setattr(parts, "_CUTS", (2,))  # every axis in two, however much fits
    tiles = parts.tiles_of(plan, raster.shape, raster.channels, **kinds, memory=2**40)
    assert len(tiles) == 2 ** len(cells)
    assert not plan.passes or any(tile.wide[0].start > 0 for tile in tiles)
    found = parts.run_in_parts(plan, raster, guide=guide, backend="numpy")
    np.testing.assert_array_equal(found.value, whole)
    assert found.value.dtype == image.dtype and found.iterations == 1


def test_what_sees_the_whole_is_not_cut():
    plan = gr.plan_denoising(np.zeros((30, 30)), p=1, sigma=1.0)
    kinds = {"solver": "jacobi", "backend": "numpy", "dtype": np.dtype(np.float32), "masked": False, "memory": 10}
    assert parts.tiles_of(plan, (30, 30), 1, **kinds) is None
    filters = gr.plan_denoising(np.zeros((30, 30)), sigma=1.0)
    with pytest.raises(MemoryError, match=r"give more memory, or use a smaller window"):
        parts.tiles_of(filters, (30, 30), 1, **kinds)


def test_halves_where_the_memory_of_the_device_runs_out(monkeypatch):
    """The search for groups has room for half of the image only; the filter before it for all."""
    rng = np.random.default_rng(3)
    image = rng.normal(100, 20, (200, 50)).astype(np.float32)
    sigma = rng.uniform(15, 25, image.shape)
    plan = with_small_passes(gr.plan_denoising(image, sigma=sigma, radius=4, passes=2))
    raster = Raster.of(image, None, None)
    whole = parts.run_in_parts(plan, raster, backend="numpy")
    backend, refused = backends.get("numpy"), []
    search = backend.patch_groups

    def limited(grid, *args, **options):
        if grid.n_vertices > 0.8 * 200 * 50:
            refused.append(grid.shape)
            raise failures.out_of_memory("a device", "no room")
        return search(grid, *args, **options)

    monkeypatch.setattr(backend, "patch_groups", limited)
    with pytest.warns(UserWarning, match="the memory of numpy ran out"):
        found = parts.run_in_parts(plan, raster, backend="numpy")
    assert refused == [(200, 50)]
    np.testing.assert_array_equal(found.value, whole.value)
    assert "halved once as the memory of numpy ran out." in found.method


def test_no_room_for_a_small_part(monkeypatch):
    image = np.random.default_rng(3).normal(100, 20, (20, 20))

    def full(*args, **options):
        raise failures.out_of_memory("a device", "no room")

    monkeypatch.setattr(backends.get("numpy"), "patch_groups", full)
    with pytest.raises(MemoryError, match=r"no room.*A part of the image is hardly smaller than the image"):
        gr.denoise_image(image, sigma=20.0, passes=2, backend="numpy")
