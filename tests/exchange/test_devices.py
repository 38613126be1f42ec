"""Arrays of Warp and of PyOpenCL, arrays of CUDA without a GPU, and the device that "auto" takes for them."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from cases import rng
from test_arguments import CLOUD, IMAGE, ON

import gpureg as gr
from gpureg import backends, exchange
from gpureg.backends import Device, dispatch

SMALL = IMAGE.astype(np.float32)


def chosen(array, dtype=np.float32) -> str:
    """The device that "auto" takes for an array."""
    *_, origin = exchange.taken(["f0"], (array,), {})
    with exchange.called_with(origin):
        return backends.get("auto", dtype).device.id


# Warp on the CPU


@pytest.fixture
def wp():
    return pytest.importorskip("warp")


def test_arrays_of_warp_use_the_same_memory(wp):
    array = wp.array(SMALL, device="cpu")
    assert exchange.on_host(array, "x").ctypes.data == array.ptr
    found = gr.denoise_tv(array, lam=0.3, max_iter=2, **ON)
    assert type(found) is wp.array and found.dtype is wp.float32 and found.device.is_cpu
    np.testing.assert_array_equal(found.numpy(), gr.denoise_tv(SMALL, lam=0.3, max_iter=2, **ON))
    found.fill_(3.0)
    assert (array.numpy() == SMALL).all()


def test_vectors_of_warp_stay_vectors(wp):
    points = CLOUD.astype(np.float32)
    array = wp.array(points, dtype=wp.vec3, device="cpu")
    found = gr.denoise_points(array, max_iter=1, **ON)
    assert found.dtype is wp.vec3 and found.shape == (len(points),)
    np.testing.assert_array_equal(found.numpy(), gr.denoise_points(points, max_iter=1, **ON))
    # another type or other axes: numbers
    assert gr.regularize(array, gr.knn_graph(array, 3), dtype="float64", max_iter=1, **ON).value.dtype is wp.float64
    assert gr.cluster_points(array, **ON).dtype is wp.int32


def test_gradients_of_warp_are_refused(wp):
    with pytest.raises(TypeError, match=r"image requires gradients, .* warp\.clone\(image, requires_grad=False\)"):
        gr.denoise_tv(wp.array(SMALL, device="cpu", requires_grad=True), lam=0.3)
    with pytest.raises(TypeError, match="bfloat16, which numpy has not"):
        gr.denoise_tv(wp.zeros((4, 4), dtype=wp.bfloat16, device="cpu"), lam=0.3)


# OpenCL


OPENCL = [device for device in backends.devices() if device.backend == "opencl"]


def queue_on(device: Device):
    """A queue of a user, in a context of its own."""
    import pyopencl as cl

    return cl.CommandQueue(cl.Context([device.handle]))


@pytest.mark.parametrize("on", OPENCL, ids=lambda device: device.id)
def test_an_array_of_opencl_chooses_its_device(on, monkeypatch):
    from pyopencl import array as cla

    device, queue = on.id, queue_on(on)
    given = cla.to_device(queue, SMALL)
    assert chosen(given) == chosen(given.with_queue(None)) == device
    seen = []
    found = gr.regularize(given, gr.GridGraph(SMALL.shape), max_iter=2, p=2, callback=lambda c: seen.append(c.value()))
    assert found.backend.startswith(device) and type(found.value) is type(seen[0]) is cla.Array
    assert found.value.context == queue.context and found.value.queue == queue
    expected = gr.regularize(SMALL, gr.GridGraph(SMALL.shape), max_iter=2, p=2, backend=device)
    np.testing.assert_array_equal(found.value.get(), expected.value)
    # other backends get a copy, and a given name comes first
    assert gr.regularize(given, gr.GridGraph(SMALL.shape), max_iter=1, **ON).backend.startswith("numpy")
    monkeypatch.setenv("GPUREG_BACKEND", "numpy")
    assert chosen(given) == "numpy"


@pytest.mark.skipif(not OPENCL, reason="no device of OpenCL")
@pytest.mark.parametrize("part", [np.s_[:], np.s_[::2, 3:], np.s_[4, :], np.s_[5:5], np.s_[:, 7]], ids=str)
def test_views_of_opencl_arrays(part):
    from pyopencl import array as cla

    given = cla.to_device(queue_on(OPENCL[0]), SMALL)[part]
    np.testing.assert_array_equal(exchange.on_host(given, "x"), SMALL[part])
    np.testing.assert_array_equal(exchange.on_host(given.with_queue(None), "x"), SMALL[part])
    if given.ndim == 1:
        np.testing.assert_array_equal(exchange.on_host(given[::-3], "x"), SMALL[part][::-3])


# CUDA, without a GPU: modules of our own instead of CuPy and Warp


class OnDevice:
    """Numbers that only ``get`` brings to the host, and ``__cuda_array_interface__``."""

    def __init__(self, values, number=1, stream=None):
        self.values, self.device = np.asarray(values), _Device(number)
        self.__cuda_array_interface__ = {"data": (4096, False), "stream": stream}


class CupyArray(OnDevice):
    def get(self):
        return self.values

    def __dlpack__(self, **_):
        raise AssertionError("CuPy's own way is used")

    def __dlpack_device__(self):
        return 2, self.device.id


class _Device:
    current = 0

    def __init__(self, number):
        self.id = self.ordinal = number

    def __enter__(self):
        self.before, _Device.current = _Device.current, self.id

    def __exit__(self, *_):
        _Device.current = self.before


CupyArray.__module__ = "cupy"


@pytest.fixture
def cupy(monkeypatch):
    module = ModuleType("cupy")
    module.asarray = lambda values: CupyArray(values, _Device.current)
    monkeypatch.setitem(sys.modules, "cupy", module)


@pytest.fixture
def present(monkeypatch):
    """Lists devices of our choice instead of those of this machine."""

    def put(*names: str, float64: bool = True, cuda: bool = True) -> None:
        made = [
            Device(name.partition(":")[0], name, name, driver, "gpu", 0, 1, float64 or "opencl" not in name, (k,), k)
            for k, name in enumerate(names)
            for driver in ["NVIDIA CUDA 570" if name in ("opencl:1", "opencl:2") else "PoCL 3.1"]
        ]
        monkeypatch.setattr(
            dispatch, "_probe", lambda name: dispatch._Probe(tuple(d for d in made if d.backend == name), None)
        )
        monkeypatch.setattr(dispatch, "_cuda_driver", lambda: cuda)
        monkeypatch.setattr(dispatch, "_make", lambda device, dtype: SimpleNamespace(device=device))

    return put


ALL = ("warp:cuda:0", "warp:cuda:1", "opencl:0", "opencl:1", "opencl:2", "numpy")


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (ALL, "warp:cuda:1"),
        # without Warp the GPU of the same number in NVIDIA's OpenCL; without both, what auto takes
        (ALL[2:], "opencl:2"),
        (("warp:cuda:0", "opencl:0", "numpy"), "warp:cuda:0"),
    ],
)
def test_an_array_of_cuda_chooses_its_device(cupy, present, names, expected):
    present(*names)
    assert chosen(CupyArray(SMALL, 1)) == expected
    assert chosen(SMALL) == names[0]


def test_a_device_without_float64_is_not_chosen_for_it(cupy, present):
    present(*ALL[2:], float64=False)
    assert chosen(CupyArray(SMALL, 1), np.float32) == "opencl:2"
    assert chosen(CupyArray(SMALL, 1), np.float64) == "numpy"


def test_arrays_of_cupy_come_back_on_their_device(cupy):
    found = gr.denoise_tv(CupyArray(SMALL, 3), mask=CupyArray(SMALL > 80), lam=0.3, max_iter=2, **ON)
    assert type(found) is CupyArray and found.device.id == 3 and found.values.dtype == np.float32
    expected = gr.denoise_tv(SMALL, mask=SMALL > 80, lam=0.3, max_iter=2, **ON)
    np.testing.assert_array_equal(found.values, expected)


def test_an_object_with_the_interface_alone_is_read_through_warp(monkeypatch):
    """Warp's stream waits for the one that the object names, before its numbers are read."""
    happened = []

    class WarpArray:
        def __init__(self, data, device, copy=None, **_):
            self.data, self.device = data, device
            happened.append("array")

        def numpy(self):
            happened.append("numpy")
            return self.data.values

    devices = [SimpleNamespace(ordinal=0, stream=None), SimpleNamespace(ordinal=1, stream=None)]
    for device in devices:
        device.stream = SimpleNamespace(wait_stream=lambda stream, n=device.ordinal: happened.append((n, stream)))
    fake = SimpleNamespace(
        array=WarpArray,
        get_device=lambda name: devices[int(name[-1])],
        get_cuda_devices=lambda: devices[:1],
        Stream=lambda device, cuda_stream: cuda_stream,
        dtype_from_numpy=lambda dtype: dtype,
    )
    monkeypatch.setitem(sys.modules, "warp", fake)
    found = gr.denoise_tv(OnDevice(SMALL, 0, stream=7), lam=0.3, max_iter=2, **ON)
    assert happened[:3] == [(0, 7), "array", "numpy"]
    # of a library that gpureg does not know: an array of Warp, which has the interface too
    assert type(found) is WarpArray and found.device == "cuda:0"
    np.testing.assert_array_equal(found.data, gr.denoise_tv(SMALL, lam=0.3, max_iter=2, **ON))
    happened.clear()
    gr.estimate_noise(OnDevice(rng(3).random((24, 24)), 0))
    assert happened == ["array", "numpy"]
    masked = OnDevice(SMALL)
    masked.__cuda_array_interface__["mask"] = masked
    with pytest.raises(TypeError, match="OnDevice has a mask, which would be lost"):
        gr.denoise_tv(masked, lam=0.3)
    monkeypatch.setitem(sys.modules, "warp", None)
    with pytest.raises(ImportError, match=r"OnDevice from a CUDA device needs Warp: pip install 'gpureg\[warp\]'"):
        gr.denoise_tv(OnDevice(SMALL), lam=0.3)


def test_the_pointer_tells_the_device(monkeypatch):
    from gpureg.exchange import warp

    def attribute(found, which, pointer):
        found._obj.value = 1 if pointer.value == 4096 else 0
        return which != 9

    monkeypatch.setitem(sys.modules, "warp", SimpleNamespace(get_cuda_devices=lambda: [0, 1]))
    monkeypatch.setattr(warp.ctypes, "CDLL", lambda name: SimpleNamespace(cuPointerGetAttribute=attribute))
    assert warp._device_of(4096) == 1 and warp._device_of(0) == 0
