"""Images that cross to a device and back: all types and layouts, blurs, mixtures and padded planes."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from cases import rng
from numpy.testing import assert_array_equal
from scipy import ndimage

from gpureg import GridGraph, backends
from gpureg.backends.cells import gaussian_taps
from gpureg.frame import Frame

pytestmark = pytest.mark.one_driver

SHAPES = [(5, 7), (3, 4, 19)]
AS_GIVEN, SCALED, MOVED = (Frame(), ()), (Frame(None, 16.0), (3.0, 0.7)), (Frame((64.0, -8.0), 8.0), ())
# An image's type, and its units. Each makes two programs; Warp's take seconds.
CASES = [("uint8", SCALED), ("int16", MOVED), ("float32", AS_GIVEN), ("float64", MOVED)]
MORE = [("uint16", AS_GIVEN), ("uint32", SCALED), ("int64", AS_GIVEN), ("float16", SCALED), (">u2", AS_GIVEN)]


def layouts(cells: np.ndarray) -> dict[str, np.ndarray]:
    """The same cells with the channels last, first, between the axes, and with negative strides."""
    first = np.moveaxis(np.ascontiguousarray(np.moveaxis(cells, -1, 0)), 0, -1)
    between = np.moveaxis(np.ascontiguousarray(np.moveaxis(cells, -1, 1)), 1, -1)
    return {"last": cells, "first": first, "between": between, "backward": cells[::-1].copy()[::-1]}


@pytest.fixture
def make(device: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Makes a backend whose kernels convert; on a CPU Warp leaves that to numpy."""

    def made(dtype: str) -> Any:
        backend = backends.get(device, dtype)
        if backend.name == "warp":
            monkeypatch.setattr(type(backend), "_converts", True)
        return backend

    return made


@functools.cache
def image(shape: tuple[int, ...], kind: str) -> np.ndarray:
    return (np.abs(rng(7).normal(100, 60, (*shape, 2))) % 250).astype(kind)


@pytest.mark.parametrize(("kind", "units"), CASES + MORE, ids=lambda x: x if isinstance(x, str) else "")
def test_an_image_crosses_in_and_out(make, device, kind, units):
    """Every number is that of the host, bit for bit: nothing is rounded more often than there."""
    if device.startswith("warp") and (kind, units) in MORE:
        pytest.skip("the programs of the other types are enough: Warp's take seconds")
    frame, each = units
    backend, host = make("float32"), backends.get("numpy", "float32")
    for shape in SHAPES:
        grid = GridGraph(shape)
        exact = host.put_cells(grid, image(shape, kind), frame=frame, units=each)
        for name, cells in layouts(image(shape, kind)).items():
            f = backend.put_cells(grid, cells, frame=frame, units=each)
            assert_array_equal(backend.get(grid, f), exact, err_msg=name)
            # values that no integer type holds are clipped
            further = backend.put(grid, exact * np.float32(3))
            back, expected = np.zeros_like(cells), np.zeros_like(cells)
            backend.get_cells(grid, further, back, frame=frame, units=each)
            host.get_cells(grid, exact * np.float32(3), expected, frame=frame, units=each)
            assert_array_equal(back, expected, err_msg=name)
    kept = np.zeros_like(image(SHAPES[0], kind))
    backend.get_cells(GridGraph(SHAPES[0]), backend.put_cells(GridGraph(SHAPES[0]), image(SHAPES[0], kind)), kept)
    # of float64, what float32 holds
    narrow = np.float32 if kind == "float64" else kind
    assert_array_equal(kept, image(SHAPES[0], kind).astype(narrow))


def test_halves_are_rounded_to_even_and_integers_are_clipped(make):
    grid = GridGraph((1, 6))
    values = np.array([0.5, 1.5, 2.5, -3.0, 254.5, 300.0])
    out = np.empty((1, 6, 1), np.uint8)
    backend = make("float32")
    backend.get_cells(grid, backend.put(grid, values[:, None]), out)
    assert out.ravel().tolist() == [0, 2, 2, 0, 254, 255]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_blur_and_mix(make, device, dtype):
    """A blur is that of SciPy within the roundings of its sums; a part has the bits of the whole."""
    if device.startswith("warp") and dtype == "float64":
        pytest.skip("one type is enough: Warp's programs take seconds")
    backend = make(dtype)
    for shape in ((11, 23), (2, 5, 40), (1, 9)):
        grid = GridGraph(shape)
        f = rng(7).normal(0, 1, (grid.n_vertices, 3)).astype(dtype)
        taps = [gaussian_taps(std, 4.0) for std in (0.6, 0.9, 0.5)[-len(shape) :]]
        exact = f.astype(np.float64).reshape(*shape, 3)
        for axis, std in enumerate((0.6, 0.9, 0.5)[-len(shape) :]):
            exact = ndimage.gaussian_filter1d(exact, std, axis, mode="mirror")
        found = backend.get(grid, backend.blur(grid, backend.put(grid, f), taps)).reshape(exact.shape)
        # 2 r + 1 products and sums along each of the axes, weights of sum 1
        roundings = sum(4 * len(kernel) for kernel in taps) * np.finfo(dtype).eps
        assert np.abs(found - exact).max() <= roundings * np.abs(f).max()
        matrix = np.array([[0.3, -0.7, 2.0], [1.0, 0.0, 1.0]])
        mixed = backend.get(grid, backend.mix(grid, backend.put(grid, f), matrix))
        assert np.abs(mixed - f @ matrix.T).max() <= 6 * np.finfo(dtype).eps * 3 * np.abs(f).max()
    whole = GridGraph((40, 23))
    f = rng(7).normal(0, 1, (40, 23)).astype(dtype)
    taps = [gaussian_taps(0.6, 4.0)] * 2
    part = GridGraph((20, 23))
    both = [
        backend.get(grid, backend.blur(grid, backend.put(grid, x.reshape(-1, 1)), taps)).reshape(grid.shape)
        for grid, x in ((whole, f), (part, f[13:33]))
    ]
    assert_array_equal(both[1][2:-2], both[0][15:31])


def test_taps_are_those_of_scipy():
    impulse = np.zeros(21)
    impulse[10] = 1
    for std in (0.3, 0.55, 2.0):
        taps = gaussian_taps(std, 4.0)
        exact = ndimage.gaussian_filter1d(impulse, std, truncate=4.0)[10 : 10 + len(taps)]
        np.testing.assert_allclose(taps, exact, rtol=1e-14)
    assert_array_equal(gaussian_taps(0.0, 4.0), [1.0])


@pytest.mark.parametrize("zeros", [False, True], ids=["reflected", "zeros"])
def test_padded_planes(make, device, zeros):
    """numpy's "reflect", also for more cells than the axis has; zeros around, and the next plane begins at once."""
    if not device.startswith("opencl"):
        pytest.skip("padded planes are OpenCL's")
    backend = make("float32")
    for shape, beyond in (((5, 7), (2, 3)), ((3, 4, 19), (1, 2, 3)), ((2, 3), (5, 4)), ((23,), (3,)), ((1, 9), (2, 2))):
        grid = GridGraph(shape)
        f = rng(7).normal(0, 1, (grid.n_vertices, 2)).astype(np.float32)
        width, left, before = shape[-1] + 2 * beyond[-1] + 9, 5, 16
        planes = backend._padded(grid, backend.put(grid, f), beyond, (width, left), before=before, zeros=zeros)
        around = [(0, 0), *((r, r) for r in beyond)]
        cells = np.moveaxis(f.reshape(*shape, 2), -1, 0)
        inner = np.pad(cells, around) if zeros else np.pad(cells, around, mode="reflect")
        inner = np.pad(inner, [(0, 0)] * len(shape) + [(left, width - left - inner.shape[-1])])
        expected = np.pad(inner.ravel(), before)
        assert_array_equal(backend._download(planes, expected.size, np.float32), expected)


def test_an_interruption_waits_for_the_kernel(device, monkeypatch):
    """A kernel on a CPU uses the memory of the image itself, which may be freed after an interruption."""
    backend = backends.get(device, "float32")
    if backend.name != "opencl" or backend.device.kind != "cpu":
        pytest.skip("images are copied")

    def interrupted(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(type(backend), "_wait_for", interrupted)
    grid = GridGraph((2048, 1024))
    out = np.zeros((*grid.shape, 1), np.float32)
    f = backend.empty(grid, 1)
    with pytest.raises(KeyboardInterrupt):
        backend.get_cells(grid, f, out, frame=Frame((1.0,), 1.0))
    assert (out == 1).all()
