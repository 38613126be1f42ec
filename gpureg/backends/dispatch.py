"""The dispatcher: list the devices, and choose one for "auto".

To add a backend: a kernel folder, a folder here with ``devices()`` and ``make(device, dtype)``, a line in
``_BACKENDS``, and an extra in pyproject.toml. The rank of a device begins with its index in ``TIERS``.
"""

from __future__ import annotations

import functools
import importlib
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import advice, failures
from .protocol import Backend
from .types import BackendUnavailable, Device, LeftOut

# name: (module, what to install if it is missing, and what if it has no device)
_BACKENDS: dict[str, tuple[str, Callable[[], str], Callable[[], str]]] = {
    "warp": ("gpureg.backends.warp.primitives", advice.install_warp, advice.install_warp),
    "opencl": ("gpureg.backends.opencl.primitives", advice.install_opencl, advice.driver),
    "numpy": ("gpureg.backends.numpy.primitives", str, str),
}
TIERS = ("CUDA through Warp", "a GPU through OpenCL", "a CPU through OpenCL", "Warp on the CPU", "numpy")


@dataclass(frozen=True)
class _Probe:
    devices: tuple[Device, ...]
    problem: str | None
    left_out: tuple[LeftOut, ...] = ()


_probing = threading.RLock()
_probes: dict[str, _Probe] = {}


def _probe(name: str) -> _Probe:
    """List the devices of one backend, or say why there are none; cached, as importing Warp is slow."""
    with _probing:
        if name not in _probes:
            _probes[name] = _ask(name)
        return _probes[name]


def _ask(name: str) -> _Probe:
    module, install, driver = _BACKENDS[name]
    try:
        found = importlib.import_module(module).devices()
    except ImportError as error:
        return _Probe((), f"{error.name or error} is not installed: {install()}")
    except Exception as error:  # a broken driver must not stop the other backends
        return _Probe((), f"it does not start ({type(error).__name__}: {error})")
    devices = tuple(one for one in found if isinstance(one, Device))
    left_out = tuple(one for one in found if isinstance(one, LeftOut))
    problem = f"no device can be used, {'; '.join(map(str, left_out))}" if left_out else f"no device: {driver()}"
    return _Probe(devices, None if devices else problem, left_out)


def names() -> tuple[str, ...]:
    """Return the names of all backends, installed or not."""
    return tuple(_BACKENDS)


def devices() -> list[Device]:
    """List all devices that can be used, in the order of preference of "auto"."""
    return sorted((device for name in _BACKENDS for device in _probe(name).devices), key=lambda device: device.rank)


def absent() -> dict[str, str]:
    """Return the backends without a device, each with the reason and what to install."""
    return {name: problem for name in _BACKENDS if (problem := _probe(name).problem) is not None}


def left_out() -> list[LeftOut]:
    """Return the devices that are there but cannot be used, each with the reason."""
    return [one for name in _BACKENDS for one in _probe(name).left_out]


def _cuda_driver() -> bool:
    """Check whether an NVIDIA driver can be loaded: much faster than to start Warp."""
    import ctypes

    for library in ("libcuda.so.1", "nvcuda.dll"):
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        return True
    return False


def auto(dtype: npt.DTypeLike = np.float32) -> Device:
    """Choose the device for ``backend="auto"``: the fastest kind that is available and computes in `dtype`.

    The order is CUDA through Warp, an OpenCL GPU, an OpenCL CPU, Warp on the CPU, numpy. Among GPUs those with memory
    of their own are first, then those with the most compute units times clock. A device that could not build a kernel
    is left out.
    """
    return _choose(dtype)[0]


def _choose(dtype: npt.DTypeLike) -> tuple[Device, list[Device]]:
    """Return the device for "auto", and those that it would have taken before if they had not failed."""
    wide = np.dtype(dtype) == np.float64
    # The best tier that a backend can have. A backend that cannot win is not started, as Warp starts slowly.
    at_best = {"warp": 0 if _cuda_driver() else 3, "opencl": 1, "numpy": 4}
    best: Device | None = None
    failed: list[Device] = []
    for name in sorted(_BACKENDS, key=lambda name: at_best.get(name, 0)):
        if best is not None and best.rank[0] <= at_best.get(name, 0):
            break
        for device in _probe(name).devices:
            if wide and not device.float64:
                continue
            if failures.why_not(device, dtype) is not None:
                failed.append(device)
            elif best is None or device.rank < best.rank:
                best = device
    assert best is not None  # numpy is always available
    if best.backend == "numpy":
        advice.fell_back()
    return best, [device for device in failed if device.rank < best.rank]


def _forced() -> str:
    """Return the name from GPUREG_BACKEND that replaces "auto", or an empty string."""
    forced = os.environ.get("GPUREG_BACKEND", "").strip()
    return "" if forced == "auto" else forced


def why_auto(dtype: npt.DTypeLike = np.float32) -> str:
    """Return a sentence that says which device "auto" takes, and why."""
    forced = _forced()
    if forced:
        return f"GPUREG_BACKEND={forced} overrides auto."
    device, failed = _choose(dtype)
    present = {int(one.rank[0]) for one in failed}
    better = [tier for i, tier in enumerate(TIERS[: int(device.rank[0])]) if i not in present]
    missing = f" (absent here: {', '.join(better)})" if better else ""
    left = "".join(f" {one.id} is left out: {failures.why_not(one, dtype)}." for one in failed)
    return f"auto takes {device.id}: {TIERS[int(device.rank[0])]} is the fastest kind present{missing}.{left}"


def _find(name: str, dtype: npt.DTypeLike) -> Device:
    family, _, rest = name.partition(":")
    if family not in _BACKENDS:
        raise ValueError(
            f"unknown backend {name!r}: use auto, {', '.join(_BACKENDS)}, or a name from `gpureg backends`"
        )
    probe = _probe(family)
    if probe.problem is not None:
        others = ", ".join(device.id for device in devices())
        raise BackendUnavailable(f"backend {family!r} is not available, {probe.problem}. Available: {others}")
    wide = np.dtype(dtype) == np.float64
    if not rest and family == name:
        able = [device for device in probe.devices if device.float64 or not wide]
        if not able:
            raise BackendUnavailable(f"no device of backend {family!r} computes in float64; use dtype float32")
        return min(able, key=lambda device: device.rank)
    for device in probe.devices:
        if device.id == name:
            if wide and not device.float64:
                raise BackendUnavailable(f"{name} ({device.name}) does not compute in float64; use dtype float32")
            return device
    for unfit in probe.left_out:
        if unfit.id == name:
            raise BackendUnavailable(f"{unfit}")
    have = ", ".join(device.id for device in probe.devices)
    raise BackendUnavailable(f"no device {name!r}. Devices of this backend: {have}")


@functools.cache
def _make(device: Device, dtype: np.dtype[np.floating]) -> Backend:
    module, _, _ = _BACKENDS[device.backend]
    backend: Backend = importlib.import_module(module).make(device, dtype)
    return backend


def get(name: str = "auto", dtype: npt.DTypeLike = np.float32) -> Backend:
    """Return the backend of this name; one object per device and type.

    Parameters
    ----------
    name : str, default "auto"
        "auto", a backend ("numpy", "opencl", "warp") or one of its devices ("opencl:1", "warp:cuda:0"). The
        environment variable GPUREG_BACKEND replaces "auto".
    dtype : dtype, default float32
        float32 or float64.

    Raises
    ------
    ValueError
        An unknown name, or another dtype.
    BackendUnavailable
        A backend or device that is not available; the message says what to install, and lists the available ones.
    """
    kind = np.dtype(dtype).newbyteorder("=")
    if kind not in (np.float32, np.float64):
        raise ValueError(f"dtype must be float32 or float64, got {kind}")
    if not isinstance(name, str):
        raise TypeError(f"backend must be a name, got {type(name).__name__}")
    forced = _forced() if name == "auto" else ""
    if forced:
        try:
            return _make(_find(forced, kind), kind)
        except (ValueError, BackendUnavailable) as error:
            raise type(error)(f"{error} (GPUREG_BACKEND={forced})") from None
    if name != "auto":
        return _make(_find(name, kind), kind)
    best, failed = _choose(kind)
    failures.chosen(best, kind, failed)
    return _make(best, kind)
