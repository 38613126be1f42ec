"""An image goes to the device once and comes back once, and in tiles it has the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from cases import rng

import gpureg as gr
from gpureg import backends
from gpureg.images import on_device

pytestmark = pytest.mark.one_driver

# Offsets, kernels, lists of steps and the like, which do not grow with the image.
SMALL = 1 << 15


def noisy(kind: str, channels: int = 1, shape: tuple[int, ...] = (96, 88)) -> np.ndarray:
    """A picture of large cells with noise of 12, far from 0."""
    cells = sum(np.indices(shape)[d] // 24 for d in range(len(shape)))
    clean = np.where(cells % 2, 190.0, 60.0)[..., None] + np.arange(channels)
    image = np.clip(clean + rng(7).normal(0, 12, clean.shape), 0, 255)
    return (image if channels > 1 else image[..., 0]).astype(kind)


@pytest.mark.parametrize(("kind", "channels"), [("uint8", 1), ("float32", 3)])
def test_an_image_crosses_the_border_once_in_and_once_out(device, kind, channels, monkeypatch):
    """Besides it one plane is copied: how many patches cover a pixel. Nothing else grows with the image."""
    if not device.startswith("opencl"):
        pytest.skip("in the others device and host share the memory")
    import pyopencl as cl

    image = noisy(kind, channels)
    axis = -1 if channels > 1 else None
    expected = gr.denoise_image(image, channel_axis=axis, backend=device)
    # a driver for a CPU reads and writes the image where it is, but let it copy as one for a GPU does
    monkeypatch.setattr(type(backends.get(device)), "_shares_memory", False)
    copied = {"in": 0, "out": 0}
    copy = cl.enqueue_copy

    def counted(queue, target, source, **options):
        way = "out" if isinstance(target, np.ndarray) else "in"
        copied[way] += (target if way == "out" else source).nbytes
        return copy(queue, target, source, **options)

    monkeypatch.setattr(cl, "enqueue_copy", counted)
    assert np.array_equal(gr.denoise_image(image, channel_axis=axis, backend=device), expected)
    pixels = image.nbytes // image.itemsize // channels
    assert image.nbytes <= copied["in"] <= image.nbytes + 4 * pixels + SMALL
    assert image.nbytes <= copied["out"] <= image.nbytes + SMALL


@pytest.mark.parametrize(("passes", "offset"), [(1, 0), (3, 20000)])
def test_tiles_have_the_same_bits(device, passes, offset, monkeypatch):
    """Also for values far from 0, of which an offset is subtracted, and with one device named twice."""
    image = noisy("float32", shape=(56, 48)) + np.float32(offset)
    options = {"sigma": 12.0, "passes": passes}
    whole = gr.denoise_image(image, backend=device, **options)
    plan = gr.plan_denoising(image, **options)
    assert (plan.frame.offset is not None) == (offset > 0)
    shared = gr.run_plan(plan, image, backend=[device, device])
    assert np.array_equal(shared.value, whole)
    monkeypatch.setattr(on_device, "fits_device", lambda *args: False)
    assert np.array_equal(gr.denoise_image(image, backend=device, **options), whole)


def test_a_result_that_is_not_finite_is_an_error(device, monkeypatch):
    """Also where integers come back, which have no NaN."""
    backend = backends.get(device)

    def broken(grid, f, form, f0, lam, **options):
        return backend.put(grid, np.full((grid.n_vertices, 1), np.nan))

    monkeypatch.setattr(backend, "similarity_step", broken)
    with pytest.raises(FloatingPointError, match="finite"):
        gr.denoise_image(noisy("uint8"), weights=gr.weights.patch(1, 60.0), max_iter=1, radius=2, backend=device)


def test_pinned_and_masked_pixels_come_back_as_they_are(device):
    image = noisy("uint8")
    lam, mask = np.full(image.shape, 2.0), np.ones(image.shape, bool)
    lam[10:20, 10:20], mask[40:50, :30] = np.inf, False
    weights = gr.weights.patch(1, 60.0)
    after = gr.denoise_image(image, lam=lam, weights=weights, mask=mask, radius=2, max_iter=1, backend=device)
    same = np.isinf(lam) | ~mask
    assert np.array_equal(after[same], image[same])
    assert (after != image)[~same].mean() > 0.5
