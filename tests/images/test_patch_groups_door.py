"""Groups of patches and the step with their matrices, as users call them."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import paper_groups
import pytest
from cases import rng
from numpy.testing import assert_allclose, assert_array_equal
from test_filters import functions, picture

import gpureg as gr
from gpureg.backends import BackendUnavailable

HOST = {"backend": "numpy"}
SMALL = {"patch_radius": 1, "radius": 3, "step": 3, "k": 8, "most": 12}


def blocks(size=32):
    """An image of four areas, and the same with noise of 0.1."""
    clean = np.kron([[0.2, 0.8], [0.8, 0.2]], np.ones((size // 2, size // 2)))
    return clean, clean + rng(7).normal(0, 0.1, clean.shape)


def literal(image, *, channel_axis=None, mask=None, spacing=None, flat=0.0, patch_radius, radius, step, k, most):
    """The members of every group by loops, as row-major numbers."""
    f = functions(image, channel_axis)
    shape = image.shape if channel_axis is None else tuple(np.delete(image.shape, channel_axis))
    inside = {p for p in np.ndindex(shape) if mask is None or mask[p]}
    window = tuple(int(radius / cell) for cell in spacing or (1,) * len(shape))
    sides = (patch_radius,) * len(shape)
    starts = paper_groups.references(shape, (step,) * len(shape))
    groups = [paper_groups.group(u, f, inside, shape, sides, window, k, most, flat) for u in starts]
    return [[int(np.ravel_multi_index(v, shape)) for v in group] for group in groups]


def members_of(groups):
    return [row.tolist() for row in np.split(groups.indices, groups.indptr[1:-1])]


# Real use


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_pilot_becomes_better(dtype):
    """Measured: 0.094 of noise, 0.0249 after one filter, 0.0227 after the step; at least half of this gain."""
    clean, noisy = blocks()
    pilot = gr.denoise_image(noisy, sigma=0.1, quality="fast", **HOST)
    groups = gr.patch_groups(pilot, patch_radius=2, radius=9, flat=0.015**2, dtype=dtype, **HOST)
    result = groups.step(noisy, 0.1)
    assert np.std(result - clean) < 0.95 * np.std(pilot - clean) < 0.3 * np.std(noisy - clean)
    assert result.dtype == noisy.dtype


@pytest.mark.parametrize(
    ("shape", "options"),
    [
        ((9, 11), {}),
        ((2, 9, 8), {"channel_axis": 0, "flat": 0.05}),
        ((4, 7, 6), {"spacing": (2.5, 1.0, 1.0), "k": 5}),
        ((7, 8), {"flat": 0.2, "most": 8, "patch_radius": 0}),
    ],
)
def test_the_members_are_those_of_the_loops(shape, options):
    image = picture(*shape)
    options = SMALL | options
    groups = gr.patch_groups(image, dtype="float64", **options, **HOST)
    expected = literal(image, **options)
    assert members_of(groups) == expected
    ones = groups.to_scipy()
    assert ones.shape == (len(groups.references), np.prod(groups.shape))
    assert_array_equal(ones.sum(axis=1), [len(group) for group in expected])
    assert repr(groups) == f"PatchGroups(shape={groups.shape}, {len(expected)} groups, {len(groups.indices)} members)"
    with pytest.raises(ValueError, match="read-only"):
        groups.indices[0] = 1


def test_the_fidelity_makes_the_step():
    """The new values are the mean over all patches that cover a pixel of (Lam + I)^-1 (Lam a + m)."""
    noisy, pilot, sigma = picture(9, 10), picture(9, 10, seed=5), 0.1 + rng(3).random((9, 10))
    groups = gr.patch_groups(pilot, dtype="float64", **SMALL, **HOST)
    total, count = np.zeros((2, 9, 10))
    f0, shape = functions(noisy, None)[0], (9, 10)
    for i, members in enumerate(members_of(groups)):
        (lam,) = groups.fidelity(i, sigma)
        places = [tuple(int(x) for x in np.unravel_index(v, shape)) for v in members]
        patches = [paper_groups.patch_at(f0, v, shape, (1, 1)) for v in places]
        for v, a in zip(places, patches, strict=True):
            new = np.linalg.solve(lam + np.eye(9), lam @ a + sum(patches) / len(patches))
            for j, value in zip(paper_groups.cells((1, 1)), new, strict=True):
                at = v[0] + j[0], v[1] + j[1]
                if 0 <= at[0] < 9 and 0 <= at[1] < 10:
                    total[at] += value
                    count[at] += 1
    expected = np.where(count > 0, total / np.maximum(count, 1), pilot)
    # two ways to invert matrices of condition 100 at most
    assert_allclose(groups.step(noisy, sigma), expected, rtol=0, atol=1e-12)


def test_the_fidelity_is_signal_to_noise():
    """Twice the noise, a quarter of the fidelity; none where all patches are equal; symmetric for a number."""
    groups = gr.patch_groups(picture(9, 10), **SMALL, **HOST)
    lam = groups.fidelity(3, 0.2)
    assert lam.shape == (1, 9, 9)
    assert_allclose(groups.fidelity(3, 0.4), lam / 4)
    assert_allclose(lam, lam.swapaxes(1, 2))
    assert np.linalg.eigvalsh(lam[0]).min() > -1e-12 * lam.max()
    assert not gr.patch_groups(np.ones((9, 10)), **SMALL, **HOST).fidelity(3, 0.2).any()


@pytest.mark.parametrize("channel_axis", [0, -1])
def test_channels(channel_axis):
    """One group for all channels, a matrix for each; groups of a grey guide step a colour image with its own guide."""
    colour = picture(12, 11, 3)
    pilot = picture(12, 11, 3, seed=9)
    if channel_axis == 0:
        colour, pilot = np.moveaxis(colour, -1, 0), np.moveaxis(pilot, -1, 0)
    grey = np.asarray(pilot.mean(axis=channel_axis))
    of_pilot = gr.patch_groups(colour, guide=pilot, channel_axis=channel_axis, **SMALL, **HOST)
    assert members_of(of_pilot) == members_of(gr.patch_groups(pilot, channel_axis=channel_axis, **SMALL, **HOST))
    of_grey = gr.patch_groups(colour, guide=grey, channel_axis=channel_axis, **SMALL, **HOST)
    assert members_of(of_grey) == members_of(gr.patch_groups(grey, **SMALL, **HOST))
    assert of_pilot.fidelity(0, 0.1).shape == (3, 9, 9)
    together = of_grey.step(colour, 0.1, guide=pilot)
    assert together.shape == colour.shape
    alone = gr.patch_groups(grey, **SMALL, **HOST)
    for c in range(3):
        own = alone.step(colour.take(c, channel_axis), 0.1, guide=pilot.take(c, channel_axis))
        # the unit that three channels share is another one
        assert_allclose(together.take(c, channel_axis), own, rtol=0, atol=1e-6)
    with pytest.raises(ValueError, match=r"PatchGroups.step: the image has 3 channel\(s\) and the groups 1"):
        of_grey.step(colour, 0.1)


def test_on_every_device(device):
    """The same groups on whole numbers, and nearly the same step; the form that the tests of the primitives compile."""
    image = (4 * picture(24, 21)).round()
    options = {"patch_radius": 2, "radius": 4, "step": 4, "k": 10, "most": 16, "flat": 0.5}
    try:
        groups = gr.patch_groups(image, backend=device, **options)
    except BackendUnavailable as error:
        if not str(error).endswith("groups of patches"):
            raise
        pytest.skip(f"{device}: {error}")
    host = gr.patch_groups(image, **options, **HOST)
    assert members_of(groups) == members_of(host)
    noisy = image + picture(24, 21, seed=5)
    # values of size 4: see OFF in test_groups_of_patches.py
    assert_allclose(groups.step(noisy, 0.3), host.step(noisy, 0.3), rtol=0, atol=2e-5)


# Units, kinds, masks


@pytest.mark.parametrize("scale", [2.0**-100, 2.0**100, 2.0**-600])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_any_unit(scale, dtype):
    """A power of two changes no bit, although squares of the units are no numbers of the type."""
    clean, noisy = blocks(16)
    options = SMALL | {"dtype": dtype} | HOST
    flat = 2.0**-12 if scale * scale > 0 else 0.0  # a square that is no number, as it is given
    groups = gr.patch_groups(clean + noisy / 8, flat=flat, **options)
    scaled = gr.patch_groups((clean + noisy / 8) * scale, flat=flat * scale * scale, **options)
    assert members_of(groups) == members_of(scaled)
    assert_array_equal(scaled.step(noisy * scale, 0.125 * scale), groups.step(noisy, 0.125) * scale)
    assert_array_equal(scaled.fidelity(2, 0.125 * scale), groups.fidelity(2, 0.125))


def test_far_from_zero():
    clean, noisy = blocks(16)
    # sixteenths of 2^-10, that a number of float64 holds beside 10^6
    clean, noisy = (np.rint(x * 2**14) / 2**14 for x in (clean + noisy / 8, noisy))
    here = gr.patch_groups(clean, **SMALL, **HOST)
    there = gr.patch_groups(clean + 1e6, **SMALL, **HOST)
    assert members_of(here) == members_of(there)
    # float32 beside the frame's own offset
    assert_allclose(there.step(noisy + 1e6, 0.1) - 1e6, here.step(noisy, 0.1), rtol=0, atol=1e-6)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int32", "float32"])
def test_kinds_of_images(dtype):
    clean, noisy = blocks(16)
    noisy, pilot = ((100 * x + 50).astype(dtype) for x in (noisy, clean + noisy / 8))
    groups = gr.patch_groups(pilot, **SMALL, **HOST)
    result = groups.step(noisy, 10.0)
    assert result.dtype == dtype
    wide = groups.step(noisy.astype(float), 10.0)
    assert np.abs(result - wide).max() <= (0.5 + 1e-4 if noisy.dtype.kind in "iu" else 1e-4)


def test_pixels_outside_the_mask():
    """They are no members, may be NaN, come back, and their values do not matter."""
    noisy, pilot = picture(12, 13), picture(12, 13, seed=5)
    mask = rng(13).random(noisy.shape) < 0.7
    holes, torn = (np.where(mask, x, np.nan) for x in (noisy, pilot))
    options = SMALL | HOST | {"mask": mask, "dtype": "float64"}
    groups = gr.patch_groups(torn, **options)
    assert mask.ravel()[groups.indices].all()
    assert_array_equal(np.diff(groups.indptr) > 0, mask.ravel()[groups.references])
    sigma = np.where(mask, 0.1 + rng(3).random(mask.shape), np.nan)
    result = groups.step(holes, sigma)
    assert_array_equal(np.isnan(result), ~mask)
    again = gr.patch_groups(np.where(mask, pilot, 7.0), **options)
    assert_array_equal(again.step(np.where(mask, noisy, -7.0), sigma)[mask], result[mask])
    assert np.isfinite(groups.fidelity(int(np.argmax(np.diff(groups.indptr))), sigma)).all()
    empty = int(np.argmin(np.diff(groups.indptr)))
    with pytest.raises(ValueError, match=f"PatchGroups.fidelity: group {empty} has no members"):
        groups.fidelity(empty, 0.1)
    nothing = gr.patch_groups(torn, **options | {"mask": np.zeros_like(mask)})
    assert_array_equal(nothing.step(holes, 0.1), holes)


def test_maps():
    """A map of equal values is the number; axes of length 1 are repeated; a noisier row is smoothed more."""
    clean, noisy = blocks()
    pilot = clean + noisy / 8
    level = np.full(clean.shape, 0.01)
    groups = gr.patch_groups(pilot, flat=0.01, **SMALL, **HOST)
    assert members_of(gr.patch_groups(pilot, flat=level, **SMALL, **HOST)) == members_of(groups)
    level[16:] = 0
    half = np.diff(gr.patch_groups(pilot, flat=level, **SMALL, **HOST).indptr).reshape(12, 12)
    assert_array_equal(half[:6], np.diff(groups.indptr).reshape(12, 12)[:6])
    assert half[6:].sum() < np.diff(groups.indptr).reshape(12, 12)[6:].sum()
    number = groups.step(noisy, 0.1)
    assert_allclose(groups.step(noisy, np.full(clean.shape, 0.1)), number, rtol=0, atol=1e-6)
    rows = np.linspace(0.02, 0.4, 32)[:, None]
    by_row = groups.step(noisy, rows)
    assert_array_equal(by_row, groups.step(noisy, np.broadcast_to(rows, clean.shape)))
    change = np.abs(by_row - noisy).mean(axis=1)
    assert change[:8].mean() < np.abs(number - noisy)[:8].mean() < np.abs(number - noisy)[-8:].mean() * 2
    assert change[:8].mean() < change[-8:].mean()


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_any_noise(dtype):
    """Hardly any leaves what the guide's patches do not span unknown; very much leaves means of groups."""
    clean, noisy = blocks(16)
    groups = gr.patch_groups(clean + noisy / 8, dtype=dtype, **SMALL, **HOST)
    results = [groups.step(noisy, sigma) for sigma in (1e-300, 1e-12, 1e12, 1e300)]
    assert np.isfinite(results).all()
    assert_array_equal(results[0], results[1])
    # both are means, of patches that reach over each pixel
    assert_allclose(results[2], results[3], rtol=0, atol=8 * np.finfo(dtype).eps)
    constant = gr.patch_groups(np.ones((16, 16)), dtype=dtype, **SMALL, **HOST)
    assert np.std(constant.step(noisy, 1e-300)) < np.std(noisy)


def test_thin_axes():
    """An axis of one pixel has nothing beyond it."""
    noisy, pilot = picture(12, 13), picture(12, 13, seed=5)
    flat = gr.patch_groups(pilot, **SMALL, **HOST)
    thin = gr.patch_groups(pilot[None], **SMALL, **HOST)
    assert members_of(thin) == members_of(flat)
    assert thin.form.patch == (0, 1, 1)
    assert_array_equal(thin.step(noisy[None], 0.1)[0], flat.step(noisy, 0.1))
    assert len(gr.patch_groups(np.ones((1, 1)), **HOST).indices) == 1


# Wrong input

F = picture(12, 13)
GROUPS = gr.patch_groups(F, **SMALL, **HOST)
WRONG = [
    (lambda: gr.patch_groups(F, k=0), ValueError, "k must be >= 1, got 0"),
    (lambda: gr.patch_groups(F, k=2.5), TypeError, "k must be an integer"),
    (lambda: gr.patch_groups(F, k=30, most=20), ValueError, "most must be at least k = 30, got 20"),
    (lambda: gr.patch_groups(F, most=True), TypeError, "most must be an integer"),
    (lambda: gr.patch_groups(F, step=0), ValueError, "step must be >= 1, got 0"),
    (lambda: gr.patch_groups(F, step=1.5), TypeError, "step must be an integer"),
    (lambda: gr.patch_groups(F, patch_radius=-1), ValueError, "patch_radius must be >= 0"),
    (lambda: gr.patch_groups(F, radius=np.inf), ValueError, "radius must be finite and > 0"),
    (lambda: gr.patch_groups(F, radius=0.5), ValueError, "radius must reach the nearest neighbour"),
    (lambda: gr.patch_groups(F, spacing=(1.0,)), ValueError, "spacing"),
    (lambda: gr.patch_groups(F, flat=-1.0), ValueError, "flat must be finite and >= 0"),
    (lambda: gr.patch_groups(F, flat=-F), ValueError, "flat must be >= 0 wherever a pixel takes part"),
    (lambda: gr.patch_groups(F, flat=F[1:]), ValueError, "flat must be a number or one value per pixel"),
    (lambda: gr.patch_groups(F[0]), ValueError, "two or more axes"),
    (lambda: gr.patch_groups(F, channel_axis=0), ValueError, "two or more axes"),
    (lambda: gr.patch_groups(F * np.nan), ValueError, "image must be finite"),
    (lambda: gr.patch_groups(F > 0), TypeError, "image must hold integers or real numbers"),
    (lambda: gr.patch_groups(F, mask=F), ValueError, "mask must be boolean"),
    (lambda: gr.patch_groups(F, guide=F[1:]), ValueError, "guide must hold numbers on the image's"),
    (lambda: gr.patch_groups(F, guide=F * np.nan), ValueError, "guide must be finite"),
    (lambda: gr.patch_groups(F, sigma=1), TypeError, "unexpected keyword argument 'sigma'"),
    (lambda: gr.patch_groups(F, memory=100, **HOST), MemoryError, "the groups need"),
    (lambda: GROUPS.step(F, 0), ValueError, "PatchGroups.step: sigma must be finite and > 0"),
    (lambda: GROUPS.step(F, "photon"), TypeError, "sigma must be a number"),
    (lambda: GROUPS.step(F, 0 * F), ValueError, "sigma must be > 0 wherever a pixel takes part"),
    (lambda: GROUPS.step(F, F * np.nan), ValueError, "sigma must be finite wherever a pixel takes part"),
    (lambda: GROUPS.step(F, F[0]), ValueError, "sigma must be a number or one value per pixel"),
    (lambda: GROUPS.step(F[1:], 0.1), ValueError, r"image must have the \(12, 13\) pixels of the groups"),
    (lambda: GROUPS.step(F / 0, 0.1), ValueError, "image must be finite"),
    (lambda: GROUPS.step(F, 0.1, guide=F[1:]), ValueError, "guide must hold numbers on the image's"),
    (lambda: GROUPS.fidelity(99, 0.1), ValueError, "PatchGroups.fidelity: group must lie in 0..24"),
    (lambda: GROUPS.fidelity(1.0, 0.1), TypeError, "group must be an integer"),
]


@pytest.mark.parametrize(("call", "error", "said"), WRONG, ids=[said[:40] for _, _, said in WRONG])
@pytest.mark.filterwarnings("ignore:(divide|invalid):RuntimeWarning")
def test_a_wrong_argument_gets_a_sentence(call, error, said):
    with pytest.raises(error, match=said):
        call()


def test_groups_are_copied_but_not_pickled():
    groups = gr.patch_groups(blocks()[1], **SMALL, **HOST)
    assert copy.copy(groups) is groups and copy.deepcopy([groups])[0] is groups
    with pytest.raises(TypeError, match=r"PatchGroups cannot be pickled, .* call gpureg.patch_groups again"):
        pickle.dumps(groups)
