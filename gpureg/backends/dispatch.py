"""The dispatcher: which devices there are, which one "auto" takes, and why.

To add a backend: a kernel folder, a folder here with ``devices()`` and ``make(device, dtype)``, a line in
``_BACKENDS``, and an extra in pyproject.toml. A device's rank begins with its place in ``TIERS``.
"""

from __future__ import annotations

import functools
import importlib
import os
import threading
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .protocol import Backend
from .types import BackendUnavailable, Device

# name: (module, what to install where it is missing)
_BACKENDS = {
    "warp": ("gpureg.backends.warp.primitives", "pip install 'gpureg[warp]'"),
    "opencl": (
        "gpureg.backends.opencl.primitives",
        "pip install 'gpureg[opencl]', or 'gpureg[pocl]' to bring a CPU driver along",
    ),
    "numpy": ("gpureg.backends.numpy.primitives", ""),
}
TIERS = ("CUDA through Warp", "a GPU through OpenCL", "a CPU through OpenCL", "Warp on the CPU", "numpy")


@dataclass(frozen=True)
class _Probe:
    devices: tuple[Device, ...]
    problem: str | None


_probing = threading.RLock()
_probes: dict[str, _Probe] = {}


def _probe(name: str) -> _Probe:
    """Devices of one backend, or why there are none. Importing Warp takes a while, so each is asked once."""
    with _probing:
        if name not in _probes:
            _probes[name] = _ask(name)
        return _probes[name]


def _ask(name: str) -> _Probe:
    module, install = _BACKENDS[name]
    try:
        found = tuple(importlib.import_module(module).devices())
    except ImportError as error:
        return _Probe((), f"{error.name or error} is not installed: {install}")
    except Exception as error:  # a broken driver must not take the other backends down
        return _Probe((), f"it does not start ({type(error).__name__}: {error})")
    return _Probe(found, None if found else f"no device: {install}")


def names() -> tuple[str, ...]:
    """Names of the backends gpureg knows, installed or not."""
    return tuple(_BACKENDS)


def devices() -> list[Device]:
    """All devices that can be used now, in the order in which "auto" prefers them."""
    return sorted((device for name in _BACKENDS for device in _probe(name).devices), key=lambda device: device.rank)


def absent() -> dict[str, str]:
    """Backends without a device, and what would bring them."""
    return {name: problem for name in _BACKENDS if (problem := _probe(name).problem) is not None}


def _cuda_driver() -> bool:
    """Whether an NVIDIA driver can be loaded: a cheap question that spares the start of Warp where there is none."""
    import ctypes

    for library in ("libcuda.so.1", "nvcuda.dll"):
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        return True
    return False


def auto(dtype: npt.DTypeLike = np.float32) -> Device:
    """The device that ``backend="auto"`` takes: the fastest kind present that computes in `dtype`.

    The order is CUDA through Warp, an OpenCL GPU, an OpenCL CPU, Warp on the CPU, numpy.
    """
    wide = np.dtype(dtype) == np.float64
    # What a backend offers at best, as a place in TIERS: one that cannot win is not started, Warp takes a while.
    at_best = {"warp": 0 if _cuda_driver() else 3, "opencl": 1, "numpy": 4}
    best: Device | None = None
    for name in sorted(_BACKENDS, key=lambda name: at_best.get(name, 0)):
        if best is not None and best.rank[0] <= at_best.get(name, 0):
            break
        for device in _probe(name).devices:
            if (device.float64 or not wide) and (best is None or device.rank < best.rank):
                best = device
    assert best is not None  # numpy is always there
    return best


def _forced() -> str:
    """What the environment puts in the place of "auto", or nothing."""
    forced = os.environ.get("GPUREG_BACKEND", "").strip()
    return "" if forced == "auto" else forced


def why_auto(dtype: npt.DTypeLike = np.float32) -> str:
    """A sentence: what "auto" takes, and why."""
    forced = _forced()
    if forced:
        return f"GPUREG_BACKEND={forced} overrides auto."
    device = auto(dtype)
    better = TIERS[: int(device.rank[0])]
    missing = f" (absent here: {', '.join(better)})" if better else ""
    return f"auto takes {device.id}: {TIERS[int(device.rank[0])]} is the fastest kind present{missing}."


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
    have = ", ".join(device.id for device in probe.devices)
    raise BackendUnavailable(f"no device {name!r}. Devices of this backend: {have}")


@functools.cache
def _make(device: Device, dtype: np.dtype[np.floating]) -> Backend:
    module, _ = _BACKENDS[device.backend]
    backend: Backend = importlib.import_module(module).make(device, dtype)
    return backend


def get(name: str = "auto", dtype: npt.DTypeLike = np.float32) -> Backend:
    """The backend of this name, computing in float32 or float64; the same object for the same device and type.

    Parameters
    ----------
    name : str, default "auto"
        "auto", a backend ("numpy", "opencl", "warp") or one of its devices ("opencl:1", "warp:cuda:0"). The
        environment variable GPUREG_BACKEND takes the place of "auto".
    dtype : dtype, default float32

    Raises
    ------
    ValueError
        A name that no backend has, or another dtype.
    BackendUnavailable
        A backend or device that is not there; the message says what is, and what to install.
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
    return _make(auto(kind) if name == "auto" else _find(name, kind), kind)
