"""Groups of patches in Warp against numpy in float64, on a CPU, and as a GPU divides the work."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from gpureg import backends
from gpureg.backends.groups import GroupForm
from gpureg.graphs.grid import GridGraph

if "warp" in backends.absent():
    pytest.skip(backends.absent()["warp"], allow_module_level=True)

import warp as wp
from gpureg.kernels.warp import group_step, patch_groups
from gpureg.kernels.warp.lanes import LANES

from gpureg.backends.warp import groups as warp_groups
from gpureg.backends.warp import pool as warp_pool

FLAT = GroupForm((2, 1), (5, 3), (4, 3), nearest=8, most=12, flat=5.0)
VOLUME = GroupForm((1, 1, 1), (2, 1, 3), (3, 2, 2), nearest=8, most=12, flat=6.0)
THIN = GroupForm((0, 1, 1), (0, 7, 3), (1, 3, 2), nearest=8, most=12, flat=7.0)
# two rows of 4 packs for a line of the window
ROW = GroupForm((2,), (25,), (3,), nearest=5, most=9, flat=3.0)
# name: shape, channels, form, mask, a map of the variance and levels
CASES = {
    "grey": ((37, 29), 1, FLAT, False, False),
    "colour, mask and maps": ((23, 31), 3, FLAT, True, True),
    "volume": ((9, 8, 7), 2, VOLUME, True, False),
    "smaller than the window, a thin axis": ((2, 6, 5), 1, THIN, False, True),
    "row": ((83,), 1, ROW, False, True),
}


def computed(backend, case, seed=0):
    """Members and sizes of the groups, and the step, of a case; integers are exact in float32."""
    shape, m, form, masked, maps = CASES[case]
    rng = np.random.default_rng(seed)
    mask = rng.random(shape) > 0.2 if masked else None
    grid, n = GridGraph(shape, mask=mask), int(np.prod(shape))
    guide = 100 + np.rint(2 * rng.normal(size=(n, m)))
    f0 = guide + 10 * rng.normal(size=(n, m))
    variance = rng.uniform(50, 200, n) if maps else 100.0
    # multiples of 1/4: limits are exact too
    level = np.rint(4 * rng.uniform(0, 2, n)) / 4 if maps else None
    groups = backend.patch_groups(grid, guide, form, level=level)
    found = backend.group_step(groups, f0, guide, variance)
    return *backend.get_groups(groups), backend.get(grid, found)


def as_gpu(monkeypatch):
    """One number at a time, one group per work item; on a CPU one thread instead of 32."""
    monkeypatch.setattr(warp_groups.WarpGroups, "_team", lambda self: (1, 1, False))


@pytest.mark.parametrize(
    ("case", "dtype", "gpu"),
    [(case, dtype, False) for case in CASES for dtype in ("float32", "float64")]
    + [("colour, mask and maps", "float32", True), ("volume", "float32", True)],
)
def test_the_groups_and_the_step_of_numpy(monkeypatch, case, dtype, gpu):
    if gpu:
        as_gpu(monkeypatch)
    members, sizes, value = computed(backends.get("warp:cpu", dtype), case)
    expected = computed(backends.get("numpy", "float64"), case)
    form = CASES[case][2]
    used = np.arange(form.most) < sizes[:, None]
    np.testing.assert_array_equal(sizes, expected[1])
    np.testing.assert_array_equal(members * used, expected[0] * used)
    # small groups, full ones, and none at a reference outside the mask
    assert sizes.max() == form.most and sizes[sizes > 0].min() < form.most
    assert (sizes == 0).any() == CASES[case][3]
    # measured over four seeds: 1.4e-5 and 1.4e-14, a unit in the last place of values up to 256; four are allowed
    np.testing.assert_allclose(value, expected[2], rtol=0, atol=4 * 128 * np.finfo(dtype).eps)


@pytest.mark.parametrize("gpu", [False, True])
def test_threads_and_bands_do_not_change_a_bit(monkeypatch, gpu):
    if gpu:
        as_gpu(monkeypatch)
    backend, case = backends.get("warp:cpu"), "colour, mask and maps"
    first = [x.tobytes() for x in computed(backend, case)]
    assert [x.tobytes() for x in computed(backend, case)] == first
    monkeypatch.setattr(warp_pool, "LEAST_WORK", 16)
    monkeypatch.setattr(warp_pool, "cores", lambda: 3)
    assert [x.tobytes() for x in computed(backend, case)] == first
    monkeypatch.setattr(warp_groups, "_CPU_BAND", 1 << 15)
    assert [x.tobytes() for x in computed(backend, case)] == first


@pytest.mark.parametrize("gpu", [False, True])
def test_a_part_has_the_bits_of_the_whole(monkeypatch, gpu):
    """From a multiple of two blocks, apart from the reach of a value at the cut edges."""
    if gpu:
        as_gpu(monkeypatch)
    backend = backends.get("warp:cpu")
    form = GroupForm((1, 1), (2, 2), (4, 3), nearest=8, most=12)
    assert form.block == (12, 12) and form.reach == (6, 6)
    rng = np.random.default_rng(1)
    f0, guide = rng.normal(size=(2, 53, 44))

    def step(rows, columns):
        here = f0[rows, columns], guide[rows, columns]
        grid, functions = GridGraph(here[0].shape), [x.reshape(-1, 1) for x in here]
        groups = backend.patch_groups(grid, functions[1], form)
        return backend.get(grid, backend.group_step(groups, *functions, 0.5)).reshape(grid.shape)

    whole, part = step(slice(None), slice(None)), step(slice(24, None), slice(0, 36))
    np.testing.assert_array_equal(part[6:, :-6], whole[30:, :30])
    assert (part != whole[24:, :36]).any()  # beside the cut


def test_the_kernels_of_groups_compile_for_cuda(tmp_path):
    """To PTX, which needs no device: with 32 threads a work item."""
    if sys.platform == "darwin":
        pytest.skip("Warp for macOS has no compiler for CUDA")
    for kernel in (
        patch_groups.make(wp.float64, 1, 1, LANES),
        group_step.make(wp.float32, 1, LANES, False),
        group_step.make_add(wp.float32, LANES),
    ):
        wp.compile_aot_module(kernel.module, arch=80, module_dir=tmp_path, use_ptx=True)
    assert len(list(tmp_path.glob("*.ptx"))) == 3
