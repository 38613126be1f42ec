"""The devices that Warp can use: CUDA devices, asked one by one and ranked for "auto", and the CPU."""

from __future__ import annotations

import contextlib
import ctypes
import os
import tempfile
from collections.abc import Iterator
from typing import Any

import warp as wp

from ..numpy import primitives as host
from ..types import Device, LeftOut
from .pool import quiet

CUDA_TIER, CPU_TIER = 0, 3

# Attributes of a device in CUDA's driver: kHz; whether long kernels are ended; whether it shares the host's memory.
_CLOCK_RATE, _KERNEL_EXEC_TIMEOUT, _INTEGRATED = 13, 17, 18

_NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"


@contextlib.contextmanager
def _without_driver_warning() -> Iterator[None]:
    """Drop the line that Warp's C++ writes to stderr if there is no CUDA driver; Warp has no setting for it."""
    try:
        stderr = os.dup(2)
    except OSError:  # a process without stderr
        yield
        return
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            said.seek(0)
            for line in said:
                if _NO_DRIVER not in line:
                    os.write(2, line)


def devices() -> list[Device | LeftOut]:
    """List all CUDA devices, those with memory of their own first, then by processors times clock; then the CPU."""
    with quiet(), _without_driver_warning():
        wp.init()
    found: list[Device | LeftOut] = []
    for i, device in enumerate(wp.get_devices()):
        try:
            found.append(_cuda(device, i) if device.is_cuda else _cpu(device, i))
        except Exception as error:  # one device must not take the others away
            reason = f"it does not answer ({type(error).__name__}: {error})"
            found.append(LeftOut(f"warp:{device.alias}", str(getattr(device, "name", "a device")), reason))
    return found


def _cpu(device: Any, i: int) -> Device:
    processor = host.devices()[0]
    return Device(
        backend="warp",
        id=f"warp:{device.alias}",
        name=processor.name,
        driver=f"Warp {wp.config.version}",
        kind="cpu",
        memory=processor.memory,
        vector_width=1,
        float64=True,
        rank=(CPU_TIER, 0, 0, i),
        handle=device,
    )


def _cuda(device: Any, i: int) -> Device | LeftOut:
    known = wp.get_cuda_supported_archs()
    if known and device.arch < min(known):
        reason = (
            f"Warp {wp.config.version} compiles for sm_{min(known)} and newer, and this is sm_{device.arch}: "
            "use it through OpenCL (pip install 'gpureg[opencl]')"
        )
        return LeftOut(f"warp:{device.alias}", device.name, reason)
    shared = bool(_attribute(device.ordinal, _INTEGRATED))
    speed = float(device.sm_count) * float(_attribute(device.ordinal, _CLOCK_RATE) or 1)
    return Device(
        backend="warp",
        id=f"warp:{device.alias}",
        name=device.name,
        driver="Warp {}, CUDA {}.{}".format(wp.config.version, *wp.get_cuda_driver_version()),
        kind="gpu",
        memory=int(device.total_memory),
        vector_width=1,
        float64=True,
        rank=(CUDA_TIER, shared, -speed, i),
        handle=device,
        watched=bool(_attribute(device.ordinal, _KERNEL_EXEC_TIMEOUT)),
    )


def _attribute(ordinal: int, attribute: int) -> int:
    """Ask CUDA's driver for an attribute of a device, which Warp does not tell; 0 if it gives none."""
    for name in ("libcuda.so.1", "nvcuda.dll"):
        try:
            driver = ctypes.CDLL(name)
        except OSError:
            continue
        device, value = ctypes.c_int(), ctypes.c_int()
        failed = driver.cuDeviceGet(ctypes.byref(device), ordinal)
        failed = failed or driver.cuDeviceGetAttribute(ctypes.byref(value), attribute, device)
        return 0 if failed else value.value
    return 0
