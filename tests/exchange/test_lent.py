"""Data that lie on the device of the backend: used there, with the bits of data from the host, without copies."""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np
import pytest
from cases import rng
from test_devices import CupyArray

import gpureg as gr
from gpureg import backends
from gpureg.backends import dispatch
from gpureg.exchange import Place
from gpureg.exchange import warp as memory
from gpureg.regularization import lent

wp = pytest.importorskip("warp", reason="Warp is not installed")

GRID = gr.GridGraph((9, 11))
F0 = np.add.outer(np.arange(9) > 4, 0.5 * (np.arange(11) > 3)) + rng(3).normal(0, 0.1, GRID.shape)
F0 = (F0 / 2).astype(np.float32)  # of spread 1: no other units
ON = {"backend": "warp:cpu", "p": 1, "max_iter": 3}
SCATTERED = gr.knn_graph(rng(5).random((99, 2)), 4)


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list:
    """The problems that were solved where the data lie, and the last functions on the device."""
    seen: list = []
    run = lent.run

    def watched(on_device, *args, **given):
        outcome = run(on_device, *args, **given)
        seen.append((on_device.f0, outcome.f))
        return outcome

    monkeypatch.setattr(lent, "run", watched)
    return seen


def both(f0, graph, direct: bool, runs: list, array=None, **settings):
    """Regularize numpy's and Warp's data; whether the host saw the second is known."""
    expected = gr.regularize(f0, graph, **ON | settings)
    array = wp.array(f0, device="cpu") if array is None else array
    found = gr.regularize(array, graph, **ON | settings)
    assert len(runs) == direct
    assert type(found.value) is wp.array and found.value.numpy().dtype == expected.value.dtype
    np.testing.assert_array_equal(found.value.numpy(), expected.value)
    np.testing.assert_array_equal(found.energy, expected.energy)
    assert (found.stop, found.eps, found.method) == (expected.stop, expected.eps, expected.method)
    return array, found


def test_nothing_is_copied(runs, monkeypatch):
    backend = backends.get("warp:cpu")
    gr.regularize(F0, GRID, **ON)
    crossed = []
    upload = type(backend).upload
    monkeypatch.setattr(type(backend), "upload", lambda s, x, *a: crossed.append(x.size) or upload(s, x, *a))
    monkeypatch.setattr(type(backend), "get", lambda *_: pytest.fail("a function was read"))
    array = wp.array(F0, device="cpu")
    found = gr.regularize(array, GRID, **ON)
    (f0, f), *_ = runs
    assert f0.ptr == array.ptr and found.value.ptr == f.ptr != array.ptr
    # numbers for sums and the like, no function
    assert max(crossed, default=0) < GRID.n_vertices
    np.testing.assert_array_equal(array.numpy(), F0)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"tol": 1e-2, "max_iter": 40},
        {"lam": np.linspace(0.5, 2, 99).reshape(GRID.shape)},
        {"initial": 0 * F0},
        {"weights": gr.weights.inverse_distance()},
        {"callback": lambda check: bool(check.value().shape != (99, 1))},
    ],
    ids=lambda given: " ".join(given) or "none",
)
def test_the_bits_are_those_of_data_from_the_host(runs, settings):
    both(F0, GRID, True, runs, **settings)


@pytest.mark.parametrize("scale", [300.0, 1.0])
def test_data_in_other_units_and_on_a_graph(runs, scale):
    both(scale * F0.ravel(), SCATTERED, True, runs)


def test_strides_and_vectors(runs):
    large = rng(7).random((18, 22)).astype(np.float32)
    both(large[::2, ::2], GRID, True, runs, array=wp.array(large, device="cpu")[::2, ::2])
    runs.clear()
    points = rng(9).random((99, 3)).astype(np.float32)
    _, found = both(points, SCATTERED, True, runs, array=wp.array(points, dtype=wp.vec3, device="cpu"))
    assert found.value.dtype is wp.vec3


@pytest.mark.parametrize(
    ("f0", "settings"),
    [
        (F0, {"solver": "certified"}),
        (F0, {"gamma": "degree"}),
        (F0, {"lam": np.where(F0 > 0.5, 1.0, 0.0)}),
        (0 * F0, {}),
        (np.where(F0 == F0[3, 4], 1e25, F0), {}),
        (F0, {"memory": 1000, "p": 2}),
        (F0, {"backend": "numpy"}),
    ],
    ids=["certified", "degrees", "no data", "constant", "far", "tiles", "another device"],
)
def test_what_the_host_has_to_see(runs, f0, settings):
    both(f0.astype(np.float32), GRID, False, runs, **settings)


def test_what_is_wrong_gets_the_same_sentence(runs):
    wrong = F0.copy()
    wrong[2, 3] = np.inf
    with pytest.raises(ValueError, match=r"^regularize: f0 must be finite, got inf at 1 place"):
        gr.regularize(wp.array(wrong, device="cpu"), GRID, **ON)
    with pytest.raises(ValueError, match=r"^regularize: f0 must have shape \(16,\) or .* got \(9, 11\)$"):
        gr.regularize(wp.array(F0, device="cpu"), gr.GridGraph((4, 4)), **ON)
    with pytest.raises(ValueError, match=r"^regularize: p must be finite and > 0, got -1$"):
        gr.regularize(wp.array(F0, device="cpu"), GRID, **ON | {"p": -1})
    with pytest.raises(TypeError, match=r"^regularize: f0 has the type bfloat16, which numpy has not"):
        gr.regularize(wp.zeros(GRID.shape, dtype=wp.bfloat16, device="cpu"), GRID, **ON)
    with pytest.raises(ValueError, match=r"^regularize: f0 must have one or more channels|^regularize: f0 must have"):
        gr.regularize(wp.zeros((99, 0), dtype=wp.float32, device="cpu"), GRID, **ON)
    with pytest.raises(TypeError, match=r"^regularize: f0 requires gradients"):
        gr.regularize(wp.array(F0, device="cpu", requires_grad=True), GRID, **ON)


def test_an_array_of_cuda_stays_on_its_device(runs, monkeypatch):
    """No GPU is here: memory of the CPU takes the place of CUDA's, and a class of ours that of CuPy's."""
    cupy = ModuleType("cupy")
    cupy.from_dlpack = lambda numbers: _Reshaped(numbers.numpy())
    monkeypatch.setitem(sys.modules, "cupy", cupy)
    monkeypatch.setattr(memory, "of_cuda", lambda array: wp.array(array.values, device="cpu"))
    asked = []
    processor = backends.get("warp:cpu").device
    monkeypatch.setattr(dispatch, "_of", lambda at: asked.append(at) or [processor])
    monkeypatch.setattr(CupyArray, "get", lambda self: pytest.fail("the array was copied to the host"))
    found = gr.regularize(CupyArray(F0, 1), GRID, p=1, max_iter=3)
    assert asked == [Place("cuda", 1)] and len(runs) == 1 and type(found.value) is _Reshaped
    np.testing.assert_array_equal(found.value.values, gr.regularize(F0, GRID, **ON).value)


class _Reshaped(CupyArray):
    def reshape(self, shape):
        return _Reshaped(self.values.reshape(shape))
