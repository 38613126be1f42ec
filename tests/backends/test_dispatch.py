"""The dispatcher: what auto takes, what a name forces, what is said of what is not there."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import gpureg as gr
from gpureg import backends
from gpureg.backends import Device, dispatch

TIERS = {"warp:cuda:0": 0, "opencl:0": 1, "opencl:1": 2, "warp:cpu": 3, "numpy": 4}


def fake(name: str, *, float64: bool = True) -> Device:
    return Device(name.partition(":")[0], name, name, "driver 1", "cpu", 0, 1, float64, (TIERS[name],))


@pytest.fixture
def present(monkeypatch: pytest.MonkeyPatch):
    """Lists devices of our choice instead of those of this machine."""

    def put(*devices: Device, driver: bool = False) -> None:
        def probe(name: str) -> dispatch._Probe:
            mine = tuple(device for device in devices if device.backend == name)
            return dispatch._Probe(mine, None if mine else f"{name} is not installed: pip install 'gpureg[{name}]'")

        monkeypatch.setattr(dispatch, "_probe", probe)
        cuda = driver or any(device.id.startswith("warp:cuda") for device in devices)
        monkeypatch.setattr(dispatch, "_cuda_driver", lambda: cuda)

    return put


@pytest.mark.parametrize("slower", range(len(TIERS)), ids=list(TIERS))
def test_auto_takes_the_fastest_kind_present(present, slower: int) -> None:
    names = list(TIERS)[slower:]
    present(*(fake(other) for other in reversed(names)))
    assert backends.auto().id == names[0]
    assert names[0] in backends.why_auto()
    assert [device.id for device in backends.devices()] == names


@pytest.mark.parametrize("best", ["opencl:0", "opencl:1"])
def test_a_cuda_driver_that_warp_cannot_use_changes_nothing(present, best: str) -> None:
    """A container may hold the driver's library without a GPU: Warp then has its CPU alone, which is no reason."""
    present(fake("warp:cpu"), fake(best), fake("numpy"), driver=True)
    assert backends.auto().id == best


def test_auto_passes_over_devices_without_float64(present) -> None:
    present(fake("opencl:0", float64=False), fake("warp:cpu"), fake("numpy"))
    assert backends.auto(np.float32).id == "opencl:0"
    assert backends.auto(np.float64).id == "warp:cpu"
    with pytest.raises(gr.BackendUnavailable, match="float64"):
        backends.get("opencl:0", np.float64)
    with pytest.raises(gr.BackendUnavailable, match="float64"):
        backends.get("opencl", np.float64)


def test_absent_backend_names_the_extra(present) -> None:
    present(fake("numpy"))
    assert set(backends.absent()) == {"warp", "opencl"}
    with pytest.raises(gr.BackendUnavailable, match=r"gpureg\[warp\].*Available: numpy"):
        backends.get("warp")
    with pytest.raises(gr.BackendUnavailable, match="opencl"):
        backends.get("opencl:0")


def test_environment_overrides_auto_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GPUREG_BACKEND", "numpy")
    assert backends.get().device.id == "numpy"
    assert "GPUREG_BACKEND=numpy" in backends.why_auto()
    result = gr.regularize(np.arange(4.0), gr.GridGraph(4))
    assert result.backend.startswith("numpy")
    monkeypatch.setenv("GPUREG_BACKEND", "nonsense")
    assert backends.get("numpy").device.id == "numpy"
    with pytest.raises(ValueError, match=r"unknown backend 'nonsense'.*GPUREG_BACKEND=nonsense"):
        backends.get()
    monkeypatch.setenv("GPUREG_BACKEND", " numpy ")
    assert backends.get().device.id == "numpy"


def test_a_backend_is_made_once() -> None:
    assert backends.get("numpy") is backends.get("numpy", "float32")
    assert backends.get("numpy") is not backends.get("numpy", "float64")
    with pytest.raises(ValueError, match="dtype must be float32 or float64, got int64"):
        backends.get("numpy", int)


def test_devices_describe_themselves(device: str) -> None:
    found = next(d for d in backends.devices() if d.id == device)
    assert found.name
    assert found.driver
    assert found.kind in ("cpu", "gpu")
    assert found.vector_width in (1, 2, 4, 8, 16)
    assert backends.get(device).device is found


@pytest.mark.parametrize(
    ("platform", "kind", "native", "width"),
    [
        ("OpenCL 3.0 PoCL 3.0-rc2  Linux, LLVM 14.0.6", "CPU", 16, 8),  # reports 16, dies on it
        ("OpenCL 3.0 PoCL 3.1+debian  Linux, LLVM 15.0.6", "CPU", 16, 16),
        ("OpenCL 3.0 PoCL 3.0", "CPU", 4, 4),
        ("OpenCL 1.2 PoCL 1.4", "CPU", 16, 8),
        ("OpenCL 3.0 PoCL 6.0", "CPU", 8, 8),
        ("OpenCL 3.0 LINUX", "CPU", 16, 16),
        ("OpenCL 3.0 LINUX", "CPU", 0, 1),
        ("OpenCL 3.0 CUDA 12.4", "GPU", 1, 1),
        ("OpenCL 2.1 AMD-APP", "GPU", 4, 1),
    ],
)
def test_vector_width(platform: str, kind: str, native: int, width: int) -> None:
    cl = pytest.importorskip("pyopencl", reason="OpenCL is not installed")
    from gpureg.backends.opencl.queue import vector_width

    device = SimpleNamespace(
        platform=SimpleNamespace(version=platform), type=getattr(cl.device_type, kind), native_vector_width_float=native
    )
    assert vector_width(device) == width
