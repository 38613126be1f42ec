"""Groups of patches as a GPU takes them, one work group a reference, on one OpenCL driver."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from cases import rng
from checking import as_gpu
from guards import guarded
from numpy.testing import assert_array_equal
from test_groups_of_patches import PLANE, Case, check, groups_of, stepped

from gpureg import backends
from gpureg.backends.groups import GroupForm
from gpureg.graphs.grid import GridGraph

# a driver for CPUs takes long to compile kernels with barriers
pytestmark = pytest.mark.one_driver

# Runs of one place and of several, one and several of them a work item; as many groups as have too many members.
WIDE = GroupForm((1, 1, 1), (5, 6, 2), (3, 3, 3), 10, 16, 0.5)
# More blocks of the covariance than work items, one work item a row of the matrix.
LARGE = GroupForm((2, 2, 1), (1, 2, 2), (3, 3, 3), 10, 16, 0.5)

CASES = [
    Case((37, 31), PLANE, channels=3, masked=True, maps=True),
    Case((37, 31), PLANE, dtype="float64"),
    Case((3, 2), PLANE, masked=True),
    Case((9, 8, 13), WIDE, masked=True, maps=True),
    Case((7, 6, 8), LARGE, channels=2),
]


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch, device: str) -> Any:
    """Makes a backend that has a GPU's kernels, in one type.

    Without optimisation, as a driver for CPUs takes 15 seconds to make loops of all work items between two barriers.
    """
    if not device.startswith("opencl"):
        pytest.skip("work groups are OpenCL's")

    def make(dtype: str) -> Any:
        backend = as_gpu(device, dtype, monkeypatch)
        backend._options += ("-cl-opt-disable",)
        return guarded(backend)

    return make


def built(backend: Any) -> set[str]:
    return {primitive for primitive, options in backend._shared.kernels if "-cl-opt-disable" in options}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.id)
def test_groups_and_step(gpu, oracle, case):
    backend = gpu(case.dtype)
    check(case, backend, oracle)
    assert {"patch_groups_gpu", "group_step_gpu", "group_gather"} <= built(backend)


def test_little_noise(gpu, oracle):
    """C is 10^6 times as large as S: as for the other kernels, off by a hundredth of the noise at most.

    Measured: 1.8e-3 of it. Where float32 cannot tell C + S from a singular matrix, the change leads to the guide: numpy
    in the same type, by a few roundings of 1.
    """
    case, backend = CASES[0], gpu("float32")
    random, clean = rng(3).standard_normal((2, *case.whole.shape)), case.whole / 2

    def off(sigma: float, reference: Any) -> float:
        args = clean + sigma * random[0], clean + sigma / 8 * random[1], sigma**2
        found, exact = (of.get(case.graph, of.group_step(groups_of(case, of), *args)) for of in (backend, reference))
        return float(np.abs(found - exact).max())

    assert off(2.0**-8, oracle) <= 2.0**-8 / 100
    assert off(2.0**-16, backends.get("numpy", "float32")) <= 8 * 2.0**-24 < off(2.0**-16, oracle)


@pytest.mark.parametrize("case", [CASES[1], CASES[3]], ids=lambda case: case.id)
def test_ranges_of_references_give_the_same_bits(gpu, monkeypatch, case):
    """One reference a launch, or five, which begin anywhere in a row of them."""
    from gpureg.backends.opencl import group_tiles

    backend = gpu(case.dtype)
    groups = groups_of(case, backend)
    whole = stepped(case, backend, groups)
    tiles = group_tiles.GroupTiles(case.form, 1, backend.dtype.itemsize)
    for size in (1, 5 * (tiles.itemsize * tiles.numbers + case.form.places)):
        monkeypatch.setattr(group_tiles, "_TILE_BYTES", size)
        assert stepped(case, backend, groups).tobytes() == whole.tobytes()


def test_a_part_has_the_bits_of_the_whole(gpu):
    """A part that begins at any reference, away from where it was cut: there are no blocks."""
    case, backend, begin = Case((45, 38), PLANE, maps=True), gpu("float32"), (8, 4)
    whole = stepped(case, backend, groups_of(case, backend)).reshape(case.shape)
    box = tuple(slice(b, None) for b in begin)
    values = (x.reshape(case.shape)[box].reshape(-1, 1) for x in (case.whole, case.level, *case.values, case.variance))
    guide, level, f0, pilot, variance = values
    part = GridGraph(tuple(n - b for n, b in zip(case.shape, begin, strict=True)))
    groups = backend.patch_groups(part, guide, PLANE, level=level[:, 0])
    found = backend.get(part, backend.group_step(groups, f0, pilot, variance[:, 0])).reshape(part.shape)
    inner = tuple(slice(reach, None) for reach in PLANE.reach)
    assert found[inner].size > 100
    assert_array_equal(found[inner], whole[box][inner])


def test_tiles_in_global_memory_give_the_same_bits(gpu, monkeypatch):
    """Where they have no room in local memory, as for volumes and 5 x 5 x 3 patches."""
    from gpureg.backends.opencl.group_tiles import GroupTiles

    volume = GroupTiles(GroupForm((1, 2, 2), (7, 7, 7), (4, 4, 4), 48, 128), 1, 4)
    assert [volume.fits_step(1 << 16, 256, far=far) for far in (False, True)] == [False, True]
    case, backend = CASES[0], gpu(CASES[0].dtype)
    groups = groups_of(case, backend)
    near = stepped(case, backend, groups)
    monkeypatch.setattr(GroupTiles, "fits_step", lambda tiles, *room, far=False: far)
    assert stepped(case, backend, groups).tobytes() == near.tobytes()
    assert any("-DFAR" in options for _, options in backend._shared.kernels)


def test_what_has_no_room_has_the_kernels_of_a_cpu(gpu, monkeypatch):
    """48 KiB of local memory: 7 x 7 in float32 and 5 x 5 in float64 of the door's windows, not 5 x 5 x 5."""
    from gpureg.backends.opencl.group_tiles import GroupTiles

    def fits(patch: tuple[int, ...], window: tuple[int, ...], itemsize: int) -> tuple[bool, bool]:
        tiles = GroupTiles(GroupForm(patch, window, (4,) * len(patch), 40, 80), 3, itemsize)
        return tiles.fits_search(1 << 16, 256), tiles.fits_step(1 << 16, 256)

    assert fits((3, 3), (19, 19), 4) == fits((2, 2), (19, 19), 8) == fits((1, 1, 1), (3, 7, 7), 4) == (True, True)
    assert fits((3, 3), (19, 19), 8) == fits((2, 2, 2), (2, 4, 4), 4) == (True, False)
    assert fits((2, 2), (60, 60), 4) == fits((1, 1, 1), (12, 12, 12), 4) == (False, False)
    if not backends.get("opencl").device.float64:
        pytest.skip("no float64")
    case, backend = dataclasses.replace(CASES[1], dtype="float64"), gpu("float64")
    expected = stepped(case, backend, groups_of(case, backend))
    monkeypatch.setattr("gpureg.backends.opencl.group_tiles._LOCAL_BYTES", 1 << 10)
    found = stepped(case, backend, groups_of(case, backend))
    assert np.abs(found - expected).max() <= 1e-14
    assert {"patch_groups", "group_step"} <= built(backend)
