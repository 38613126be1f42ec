"""Groups of patches and their step: numpy in float64 against loops, every device against numpy in float64."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import paper
import paper_groups
import pytest
from cases import rng
from checking import on
from guards import guarded
from literal import assert_close
from numpy.testing import assert_array_equal

from gpureg.backends.groups import GroupForm
from gpureg.backends.numpy import groups as numpy_groups
from gpureg.graphs.grid import GridGraph


@dataclass(frozen=True)
class Case:
    """A grid, a form, and values on it; whole numbers in the guide of the groups, so that no device rounds."""

    shape: tuple[int, ...]
    form: GroupForm
    channels: int = 1
    dtype: str = "float32"
    masked: bool = False
    maps: bool = False
    constant: bool = False

    @property
    def id(self) -> str:
        words = [word for word in ("masked", "maps", "constant") if getattr(self, word)]
        sizes = ("x".join(map(str, x)) for x in (self.shape, self.form.patch, self.form.window, self.form.step))
        return " ".join([*sizes, f"{self.form.nearest}-{self.form.most}", f"m{self.channels}", *words, self.dtype])

    @property
    def graph(self) -> GridGraph:
        mask = rng(31).random(self.shape) < 0.7 if self.masked else None
        return GridGraph(self.shape, mask=mask)

    @property
    def whole(self) -> np.ndarray:
        """The guide of the groups: 0, 1 or 2 in areas of a few pixels."""
        if self.constant:
            return np.full((np.prod(self.shape), self.channels), 3.0)
        places = np.indices(self.shape).sum(axis=0)[..., None] // 3 + np.arange(self.channels)
        rough = rng(37).random((*self.shape, self.channels)) < 0.15
        return ((places + rough) % 3).astype(float).reshape(-1, self.channels)

    @property
    def level(self) -> np.ndarray | None:
        """Quarters, so that the limits are exact."""
        return rng(41).integers(0, 8, int(np.prod(self.shape))) / 4 if self.maps else None

    @property
    def values(self) -> tuple[np.ndarray, np.ndarray]:
        """A noisy function and a guide of size 1, in float32's numbers."""
        clean = self.whole / 2
        noise = rng(43).standard_normal((2, *clean.shape))
        return tuple((clean + s * x).astype(np.float32).astype(float) for s, x in zip((0.3, 0.1), noise, strict=True))

    @property
    def variance(self) -> float | np.ndarray:
        n = int(np.prod(self.shape))
        return (0.05 + 0.25 * rng(47).random(n)).astype(np.float32).astype(float) if self.maps else 0.0625


def groups_of(case: Case, backend: Any) -> Any:
    return backend.patch_groups(case.graph, case.whole, case.form, level=case.level)


def members(case: Case, backend: Any, groups: Any) -> list[list[int]]:
    """The places of the members of each group."""
    found, sizes = backend.get_groups(groups)
    assert found.shape == (len(case.form.references(case.shape)), case.form.most)
    return [row[:size].tolist() for row, size in zip(found, sizes, strict=True)]


def stepped(case: Case, backend: Any, groups: Any) -> np.ndarray:
    return backend.get(case.graph, backend.group_step(groups, *case.values, case.variance))


# The reference against loops

SMALL = [
    Case((7, 9), GroupForm((1, 1), (2, 3), (3, 2), 5, 12, 0.25)),
    Case((8, 5), GroupForm((1, 2), (3, 2), (4, 4), 6, 9), channels=3, masked=True, maps=True),
    Case((6, 7), GroupForm((1, 1), (2, 2), (2, 3), 3, 5, 2.0), maps=True),
    Case((3, 4, 5), GroupForm((1, 1, 1), (1, 2, 2), (2, 2, 3), 4, 10, 0.125), channels=2, maps=True),
    Case((4, 3, 3), GroupForm((1, 0, 1), (1, 1, 2), (3, 1, 2), 4, 7, 0.5), masked=True),
    # a patch and a window that reach further than the grid
    Case((2, 5), GroupForm((3, 2), (9, 8), (2, 3), 4, 6, 0.5)),
    # a window with fewer patches than `nearest`
    Case((5, 6), GroupForm((1, 1), (1, 1), (2, 2), 40, 80)),
    # one member: the reference, as no other patch is its equal
    Case((5, 6), GroupForm((2, 2), (2, 2), (2, 2), 1, 1)),
    Case((6, 5), GroupForm((1, 1), (2, 2), (3, 3), 2, 6), constant=True),
    # pixels that no patch covers
    Case((9, 10), GroupForm((0, 0), (1, 1), (4, 5), 1, 2)),
]


def as_functions(case: Case, values: np.ndarray) -> list[paper.Function]:
    places = paper.pixels(case.shape)
    return [dict(zip(places, column, strict=True)) for column in values.reshape(len(places), -1).T.tolist()]


def literal_groups(case: Case) -> list[list[tuple[int, ...]]]:
    form, places = case.form, paper.pixels(case.shape)
    mask = case.graph.mask
    inside = {u for u in places if mask is None or mask[u]}
    guides = as_functions(case, case.whole)
    level = dict.fromkeys(places, 1.0) if case.level is None else as_functions(case, case.level)[0]
    shared = (guides, inside, case.shape, form.patch, form.window, form.nearest, form.most)
    return [
        paper_groups.group(u, *shared, form.flat * level[u]) for u in paper_groups.references(case.shape, form.step)
    ]


@pytest.mark.parametrize("case", SMALL, ids=lambda case: case.id)
def test_the_oracle_is_the_specification(oracle, case):
    expected, form = literal_groups(case), case.form
    assert any(expected)
    groups = groups_of(case, oracle)
    starts = paper_groups.references(case.shape, form.step)
    numbers = np.ravel_multi_index(np.array(starts).T, case.shape)
    assert_array_equal(form.references(case.shape), numbers)
    steps = form.offsets().tolist()
    places = [
        [tuple(a + b for a, b in zip(u, steps[i], strict=True)) for i in row]
        for u, row in zip(starts, members(case, oracle, groups), strict=True)
    ]
    assert places == expected
    f0, guide = (as_functions(case, x) for x in case.values)
    variance = as_functions(case, np.broadcast_to(case.variance, int(np.prod(case.shape))))[0]
    found = [
        paper_groups.group_step(expected, f, g, variance, case.shape, form.patch)
        for f, g in zip(f0, guide, strict=True)
    ]
    values = np.array([[each[u] for each in found] for u in paper.pixels(case.shape)])
    assert_close(stepped(case, oracle, groups), values)


def test_groups_beside_singular_ones_take_the_guide(oracle, monkeypatch):
    """With a limit between the ratios of the groups, which are 7 to 25."""
    case, limit = SMALL[0], 14.0
    monkeypatch.setattr(numpy_groups, "largest_trace", lambda dtype: limit)
    (f0,), (guide,) = (as_functions(case, x) for x in case.values)
    args = literal_groups(case), f0, guide, dict.fromkeys(f0, case.variance), case.shape, case.form.patch
    found = stepped(case, oracle, groups_of(case, oracle))[:, 0]
    exact = [paper_groups.group_step(*args, largest) for largest in (limit, np.inf, 0.0)]
    assert_close(found, [exact[0][u] for u in f0])
    assert all(np.abs(found - [other[u] for u in f0]).max() > 0.01 for other in exact[1:])


def test_the_cases_are_those_they_are_for():
    """Groups of one member, of fewer than `nearest`, of exactly `most`, with ties; pixels outside; none that covers."""
    sizes = [{len(group) for group in literal_groups(case)} for case in SMALL]
    assert sizes[7] == {1}
    assert max(sizes[6]) == 9 < SMALL[6].form.nearest
    assert sizes[2] >= {5} and sizes[8] == {6}
    assert 0 in sizes[1] and 0 in sizes[4]


@pytest.mark.parametrize("levels", ["number", "map"])
def test_the_step_is_the_minimiser(levels):
    """Of the energy in units of the noise: quadratic, so that the difference quotients are exact but for rounding."""
    noise = rng(3)
    noisy, pilots = [list(noise.random((6, 4))) for _ in range(2)]
    variances = [np.full(4, 0.3)] * 6 if levels == "number" else list(0.1 + noise.random((6, 4)))
    C, S = paper_groups.covariance(pilots), sum(variances) / 6
    root = np.sqrt(S)
    ratio = C / np.outer(root, root)

    def energy(f, a):
        smooth = sum(np.sum(((f - b) / root) ** 2) for b in noisy) / 6
        return smooth / 2 + (f - a) / root @ ratio @ ((f - a) / root) / 2

    lam = C / S
    for a, r in zip(noisy, paper_groups.changes(noisy, pilots, variances), strict=True):
        slopes = [energy(a - r + h, a) - energy(a - r - h, a) for h in np.eye(4)]
        assert np.abs(slopes).max() < 1e-12 * energy(a, a)
        # the same as one step with the matrix for lam
        assert_close(np.linalg.solve(lam + np.eye(4), lam @ a + sum(noisy) / 6), a - r)


# Devices against the reference. Few forms: a device compiles the kernels of each.

PLANE = GroupForm((2, 2), (4, 4), (4, 4), 10, 16, 0.5)
SOLID = GroupForm((1, 1, 1), (2, 2, 2), (3, 3, 3), 10, 16, 0.5)

DEVICES = [
    Case((37, 31), PLANE),
    Case((37, 31), PLANE, channels=3, masked=True, maps=True),
    Case((37, 31), PLANE, dtype="float64", maps=True),
    Case((9, 8, 13), SOLID, masked=True),
    Case((9, 8, 13), SOLID, channels=3, dtype="float64"),
    # smaller than the window and than the patch
    Case((3, 2), PLANE, masked=True),
]

# Largest difference from float64 of values of size 2, measured over these cases: in float32 1.9e-7 on numpy, 2.4e-7 on
# OpenCL; in float64 4.4e-16. A device may contract, and add and factor in another order: 20 times as much.
OFF = {"float32": 5e-6, "float64": 1e-14}


def grouping(device: str, dtype: str) -> Any:
    """The backend of a device between guards."""
    return guarded(on(device, dtype))


def check(case: Case, backend: Any, oracle: Any) -> None:
    """The very same groups, values within what is measured, the same bits on a second run, nothing written outside."""
    exact = groups_of(case, oracle)
    with backend.framing():
        groups = groups_of(case, backend)
        found = stepped(case, backend, groups)
    assert members(case, backend, groups) == members(case, oracle, exact)
    # what is not written is NaN
    assert np.isfinite(found).all()
    assert found.dtype == case.dtype
    assert np.abs(found - stepped(case, oracle, exact)).max() <= OFF[case.dtype]
    again = groups_of(case, backend)
    assert members(case, backend, again) == members(case, backend, groups)
    assert stepped(case, backend, again).tobytes() == found.tobytes()
    backend.check_guards()


def on_a_driver(i: int) -> Any:
    """A case; every driver builds the kernels of one form in float32 and of the other one in float64."""
    return pytest.param(DEVICES[i], id=DEVICES[i].id, marks=() if i in (1, 4) else pytest.mark.one_driver)


@pytest.mark.parametrize("case", [on_a_driver(i) for i in range(len(DEVICES))])
def test_the_device(device, oracle, case):
    check(case, grouping(device, case.dtype), oracle)


PARTS = [
    pytest.param((61, 53), PLANE, (slice(24, 57), slice(24, 53)), id="2-D"),
    pytest.param((7, 31, 39), SOLID, (slice(0, 7), slice(0, 29), slice(24, 39)), id="3-D"),
]


@pytest.mark.one_driver
@pytest.mark.parametrize(("shape", "form", "box"), PARTS)
def test_a_part_has_the_bits_of_the_whole(device, shape, form, box):
    """A part that begins at multiples of twice the block; its halo is the reach, where it ends inside of the grid."""
    backend = grouping(device, "float32")
    assert all(side.start % (2 * block) == 0 for side, block in zip(box, form.block, strict=True))
    inner = tuple(
        slice(side.start + (reach if side.start else 0), side.stop - (reach if side.stop < size else 0))
        for side, reach, size in zip(box, form.reach, shape, strict=True)
    )
    assert all(side.start < side.stop for side in inner)
    case = Case(shape, form, maps=True)
    mask = rng(53).random(shape) < 0.9

    def step(box):
        values = (x.reshape(shape)[box] for x in (case.whole, case.level, *case.values, case.variance))
        whole, level, f0, guide, variance = (np.ascontiguousarray(x).reshape(-1, 1) for x in values)
        graph = GridGraph(mask[box].shape, mask=mask[box])
        groups = backend.patch_groups(graph, whole, form, level=level[:, 0])
        return backend.get(graph, backend.group_step(groups, f0, guide, variance[:, 0])).reshape(graph.shape)

    everything = step(tuple(slice(0, size) for size in shape))
    own = tuple(slice(i.start - b.start, i.stop - b.start) for i, b in zip(inner, box, strict=True))
    assert_array_equal(step(box)[own], everything[inner])


@pytest.mark.one_driver
@pytest.mark.parametrize("case", [DEVICES[0], DEVICES[3]], ids=lambda case: case.id)
def test_little_noise(device, oracle, case):
    """C is 10^6 times as large as S, and the result as good: what is off is a hundredth of the noise at most.

    Measured: 7e-4 of it on numpy, 1.1e-3 with the inverse factor of C + S on OpenCL; 4 and more with the inverse.
    """
    backend = grouping(device, case.dtype)
    sigma, random, clean = 2.0**-8, rng(3).standard_normal((2, *case.whole.shape)), case.whole / 2
    args = clean + sigma * random[0], clean + sigma / 8 * random[1], sigma**2
    found, exact = (each.get(case.graph, each.group_step(groups_of(case, each), *args)) for each in (backend, oracle))
    assert np.abs(found - exact).max() <= sigma / 100


@pytest.mark.one_driver
def test_strong_edges_in_little_noise(device, oracle):
    """A checkerboard of contrast 200 in noise of sigma 1: trace C is up to about 25 100^2 times as large as S.

    Measured: 5e-4 on numpy, 9e-4 on OpenCL, 1.2e-3 on Warp.
    """
    backend, case = grouping(device, "float32"), Case((37, 31), PLANE)
    clean = 200.0 * (np.indices(case.shape) // 8).sum(axis=0).reshape(-1, 1) % 400
    random = rng(61).standard_normal((2, *clean.shape))
    f0, guide = (np.float32(clean + s * x).astype(float) for s, x in zip((1, 0.2), random, strict=True))
    found, exact = (
        each.get(case.graph, each.group_step(each.patch_groups(case.graph, clean, PLANE), f0, guide, 1.0))
        for each in (backend, oracle)
    )
    assert np.abs(found - exact).max() <= 1 / 100


@pytest.mark.one_driver
@pytest.mark.parametrize("case", [DEVICES[0], DEVICES[3]], ids=lambda case: case.id)
def test_hardly_any_noise(device, oracle, case):
    """What cannot be told from a singular matrix: the guide, to a rounding of f0 and of the sum of what is taken off.

    Measured: 1.2e-7 on values of size 2.
    """
    backend = grouping(device, case.dtype)
    found = backend.get(case.graph, backend.group_step(groups_of(case, backend), *case.values, 1e-20))
    assert np.abs(found - case.values[1]).max() <= OFF[case.dtype]


@pytest.mark.one_driver
def test_noise_alone_leaves_the_mean(device):
    """A constant guide: C = 0, so that a patch becomes the mean of its group, whatever the noise."""
    backend = grouping(device, "float32")
    case = Case((13, 11), PLANE, constant=True)
    f0 = rng(59).random((143, 1))
    groups = groups_of(case, backend)
    found, flat = (
        backend.get(case.graph, backend.group_step(groups, f0, case.whole, variance)) for variance in (1e-3, 1e3)
    )
    assert np.abs(found - flat).max() <= OFF["float32"]
    assert np.std(found) < np.std(f0) / 3


@pytest.mark.one_driver
def test_a_limit_beyond_all_numbers_takes_no_cells_outside_of_the_grid(device, oracle):
    """Their distance is infinite, and the limit is in float32."""
    backend = grouping(device, "float32")
    case = replace(DEVICES[0], form=replace(DEVICES[0].form, flat=np.inf))
    assert members(case, backend, groups_of(case, backend)) == members(case, oracle, groups_of(case, oracle))


@pytest.mark.parametrize("radius", range(8))
def test_a_pack_of_a_line_ends_in_its_row(radius):
    """The next row belongs to another block of the launch, which adds to the same cells at the same time."""
    groups = pytest.importorskip(
        "gpureg.backends.opencl.groups", reason="OpenCL is not installed", exc_type=ImportError
    )
    form = GroupForm(patch=(0, radius), window=(1, 1), step=(1, 1), nearest=2, most=4, flat=0.0)
    lattice = groups._Lattice(GridGraph((5, 6)), form, 8)
    # the first cell of the last patch of a row, and the pack that begins there
    assert lattice.row[0] >= 5 + lattice.wide
