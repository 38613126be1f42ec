"""The OpenCL devices of this machine: each is asked by itself, and ranked for "auto"."""

from __future__ import annotations

import re
from typing import Any

import pyopencl as cl

from ..types import Device, LeftOut
from .queue import pocl_version, vector_width

GPU_TIER, CPU_TIER = 1, 2

# CL_DEVICE_KERNEL_EXEC_TIMEOUT_NV: whether the system ends kernels that run for seconds.
_TIMEOUT_NV = 0x4005
_NOT_FOUND = -1


def devices() -> list[Device | LeftOut]:
    """List all OpenCL devices.

    GPUs are before CPUs: those with memory of their own first, then by compute units times clock. Among CPUs PoCL is
    first, then the newest driver.
    """
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # no driver
        return []
    members: list[Any] = []
    silent: list[Device | LeftOut] = []
    for platform in platforms:
        try:
            members += platform.get_devices()
        except cl.Error as error:
            if error.code != _NOT_FOUND:  # a driver without a device is no fault
                silent.append(LeftOut("opencl", str(_or(platform, "name", "a platform")), _said(error)))
    return [*(_described(device, i) for i, device in enumerate(members)), *silent]


def _described(device: cl.Device, i: int) -> Device | LeftOut:
    """Describe a device, or say why it is left out; a query may raise any error of a broken driver."""
    found = f"opencl:{i}"
    try:
        name = device.name.strip()
        kind = _kind(device, name)
        if kind is None:
            return LeftOut(found, name, "it is neither a GPU nor a CPU")
        if not (_or(device, "available", True) and _or(device, "compiler_available", True)):
            return LeftOut(found, name, "its driver says that the device or its compiler is not available")
        version = [float(number) for number in re.findall(r"\d+", device.driver_version)[:2]] + [0.0, 0.0]
        shared = kind == "gpu" and bool(_or(device, "host_unified_memory", False))
        speed = float(device.max_compute_units) * float(_or(device, "max_clock_frequency", 0) or 1)
        order = (shared, -speed) if kind == "gpu" else (pocl_version(device) is None, 0.0)
        return Device(
            backend="opencl",
            id=found,
            name=name,
            driver=f"{device.platform.name} {device.driver_version}",
            kind=kind,
            memory=int(device.global_mem_size),
            vector_width=vector_width(device),
            float64=bool(device.double_fp_config),
            rank=(GPU_TIER if kind == "gpu" else CPU_TIER, *order, -version[0], -version[1], i),
            handle=device,
            watched=kind == "gpu" and _watched(device, shared),
        )
    except Exception as error:
        return LeftOut(found, str(_or(device, "name", "a device")).strip(), _said(error))


def free_memory(device: Device) -> int:
    """Return the bytes that are free, which AMD's drivers tell in KiB; otherwise all bytes of the device."""
    try:
        told = device.handle.global_free_memory_amd
        free = int(told[0] if isinstance(told, list | tuple) else told) * 1024
    except Exception:  # another driver
        return device.memory
    return min(free, device.memory) if free > 0 else device.memory


def _kind(device: cl.Device, name: str) -> str | None:
    """Return "gpu" or "cpu"; None for accelerators, such as Intel's emulator of an FPGA, which computes on the CPU."""
    if device.type & cl.device_type.GPU:
        return "gpu"
    return "cpu" if device.type & cl.device_type.CPU and "FPGA" not in name else None


def _watched(device: cl.Device, shared: bool) -> bool:
    """Return whether the system ends long kernels: NVIDIA's driver tells; others do if the GPU draws the screen."""
    try:
        return bool(device.get_info(_TIMEOUT_NV))
    except Exception:  # not NVIDIA's driver
        return shared


def _or(owner: Any, query: str, otherwise: Any) -> Any:
    """Return the answer to a query that a driver need not know."""
    try:
        return getattr(owner, query)
    except Exception:
        return otherwise


def _said(error: Exception) -> str:
    return f"its driver does not answer ({type(error).__name__}: {error})"
