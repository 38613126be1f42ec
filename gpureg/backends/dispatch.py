"""The dispatcher: list the devices, and choose one for "auto".

To add a backend: a kernel folder, a folder here with ``devices()`` and ``make(device, dtype)``, a line in
``_BACKENDS``, and an extra in pyproject.toml. The rank of a device begins with its index in ``TIERS``.
"""

from __future__ import annotations

import functools
import importlib
import os
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import exchange
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


def _choose(dtype: npt.DTypeLike, at: exchange.Place | None = None) -> tuple[Device, list[Device]]:
    """Return the device for "auto", and those that it would have taken before if they had not failed.

    It is the device `at` which the data lie, if it computes in `dtype`.
    """
    wide = np.dtype(dtype) == np.float64
    near = [] if at is None else [device for device in _of(at) if device.float64 or not wide]
    for device in near:
        if failures.why_not(device, dtype) is None:
            return device, []
    # The best tier that a backend can have. A backend that cannot win is not started, as Warp starts slowly.
    at_best = {"warp": 0 if _cuda_driver() else 3, "opencl": 1, "numpy": 4}
    best: Device | None = None
    failed = list(near)
    for name in sorted(_BACKENDS, key=lambda name: at_best.get(name, 0)):
        if best is not None and best.rank[0] <= at_best.get(name, 0):
            break
        for device in _probe(name).devices:
            if wide and not device.float64:
                continue
            if failures.why_not(device, dtype) is not None:
                failed += [] if device in near else [device]
            elif best is None or device.rank < best.rank:
                best = device
    assert best is not None  # numpy is always available
    if best.backend == "numpy":
        advice.fell_back()
    return best, [device for device in failed if device in near or device.rank < best.rank]


def _of(at: exchange.Place) -> list[Device]:
    """Return the device that is the one of an array, none or one."""
    if at.kind == "opencl":
        return [device for device in _probe("opencl").devices if device.handle == at.device]
    found = [device for device in _probe("warp").devices if device.id == f"warp:cuda:{at.device}"]
    if not found:
        # no Warp, or a GPU too old for it: NVIDIA's OpenCL, and the data pass through the host
        nvidia = [device for device in _probe("opencl").devices if device.driver.startswith("NVIDIA")]
        found = nvidia[at.device : at.device + 1]
    return found


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
            f"unknown backend {name!r}: use auto, {', '.join(_BACKENDS)}, all, or a name from `gpureg backends`"
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


Chosen = str | Sequence[str]
"""What `backend` may be: a name, or names of devices."""


def get(name: Chosen = "auto", dtype: npt.DTypeLike = np.float32) -> Backend:
    """Return the backend of this name; one object per device and type.

    Parameters
    ----------
    name : str or sequence of str, default "auto"
        "auto", a backend ("numpy", "opencl", "warp") or one of its devices ("opencl:1", "warp:cuda:0"). The
        environment variable GPUREG_BACKEND replaces "auto". Otherwise "auto" is the device of the data, if they are an
        array on a device (:func:`gpureg.exchange.place`). Of several devices, see :func:`several`, the first.
    dtype : dtype, default float32
        float32 or float64.

    Raises
    ------
    TypeError, ValueError
        An unknown name, or something else than a name; another dtype.
    BackendUnavailable
        A backend or device that is not available; the message says what to install, and lists the available ones.
    """
    return several(name, dtype)[0]


def several(names: Chosen, dtype: npt.DTypeLike = np.float32) -> tuple[Backend, ...]:
    """Return the backends of these names, one or more, for work that devices can share.

    Parameters
    ----------
    names : str or sequence of str
        A name as for :func:`get`; names in a sequence or joined by commas, a device perhaps twice; or "all": all
        devices of the kind that "auto" takes, such as all GPUs through CUDA with memory of their own. A CPU counts
        once, whatever its drivers. GPUREG_BACKEND replaces "auto" and "all".
    dtype : dtype, default float32

    Raises
    ------
    TypeError, ValueError, BackendUnavailable
        As :func:`get`; no name at all.
    """
    kind = np.dtype(dtype).newbyteorder("=")
    if kind not in (np.float32, np.float64):
        raise ValueError(f"dtype must be float32 or float64, got {kind}")
    listed = names.split(",") if isinstance(names, str) else names
    if not isinstance(listed, Sequence) or not listed or not all(isinstance(name, str) for name in listed):
        raise TypeError(f"backend must be a name, or a list of names of devices, got {names!r}")
    forced = _forced() if names in ("auto", "all") else ""
    try:
        return tuple(one for name in (forced.split(",") if forced else listed) for one in _named(name.strip(), kind))
    except (ValueError, BackendUnavailable) as error:
        if not forced:
            raise
        raise type(error)(f"{error} (GPUREG_BACKEND={forced})") from None


def _named(name: str, kind: np.dtype[Any]) -> list[Backend]:
    """Return the backends of one name, more than one for "all"."""
    if name not in ("auto", "all"):
        return [_make(_find(name, kind), kind)]
    best, failed = _choose(kind, exchange.place())
    failures.chosen(best, kind, failed)
    return [_make(device, kind) for device in (_alike(best, kind) if name == "all" else [best])]


def _alike(first: Device, dtype: npt.DTypeLike) -> list[Device]:
    """Return the devices that share work with the one that "auto" takes, in their order."""
    if first.kind == "cpu":
        return [first]
    wide = np.dtype(dtype) == np.float64
    able = [one for one in _probe(first.backend).devices if one.float64 or not wide]
    able = [one for one in able if one.rank[:2] == first.rank[:2] and failures.why_not(one, dtype) is None]
    return sorted(able, key=lambda one: one.rank)
