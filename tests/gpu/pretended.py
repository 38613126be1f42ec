"""Devices that say that they are GPUs: the kernels and launches that a GPU gets, run by a CPU.

`pytest --as-gpu` uses them instead of all devices of OpenCL and Warp. What is made for a GPU runs then: one
number a work item, strided sums, work groups. It is no test of a GPU's driver.
"""

from __future__ import annotations

import dataclasses
import importlib
import re
from typing import Any

from gpureg.backends import Device

# What `--as-gpu` takes: with float64, or without it and with subnormal numbers flushed to 0, as OpenCL allows a device.
KINDS = ("double", "single")
_FLUSHED = "-cl-denorms-are-zero"


@dataclasses.dataclass(frozen=True)
class Program:
    """An OpenCL program that was built in this process."""

    source: str
    options: tuple[str, ...]

    @property
    def kernel(self) -> str:
        """The names of its kernels."""
        return ", ".join(re.findall(r"__kernel\s+void\s+(\w+)", self.source))


# What was built since `pretend`: programs of OpenCL, and modules of Warp.
programs: dict[Program, None] = {}
modules: dict[int, Any] = {}


def _record_programs() -> None:
    import pyopencl as cl

    build = cl.Program.build

    def recorded(program: Any, options: Any = (), *args: Any, **more: Any) -> Any:
        programs[Program(program._source, tuple(options))] = None
        return build(program, options, *args, **more)

    cl.Program.build = recorded


def _record_modules() -> None:
    import warp as wp

    load = wp.load_module

    def recorded(module: Any, *args: Any, **more: Any) -> Any:
        modules[id(module)] = module
        return load(module, *args, **more)

    wp.load_module = recorded


class _NoCpu(str):
    """The name of a device of Warp, and what gpureg asks of the device: a CPU that is none."""

    alias = property(str)
    is_cpu = is_cuda = False


def _one_thread_a_block() -> None:
    """A CPU runs one thread of each block: what works together by 32 or 256 threads, one thread does alone here."""
    from gpureg.kernels.warp import total

    from gpureg.backends.warp.groups import WarpGroups

    total.GROUP = 1
    WarpGroups._team = lambda self: (1, 1, False)


def _as_gpu(device: Any, *, float64: bool) -> Any:
    """The device, as if it were a GPU."""
    changes: dict[str, Any] = {"kind": "gpu", "vector_width": 1, "float64": device.float64 and float64}
    if device.backend == "opencl":
        changes["rank"] = (1, *device.rank[1:])
    elif device.handle.is_cpu:
        changes["handle"] = _NoCpu(device.handle.alias)
    return dataclasses.replace(device, **changes)


def pretend(kind: str) -> None:
    """Let every device of OpenCL and Warp say from now on that it is a GPU of this kind; for a whole process."""
    for name in ("opencl", "warp"):
        try:
            module = importlib.import_module(f"gpureg.backends.{name}.primitives")
        except ImportError:  # the backend is not installed
            continue
        if name == "opencl":
            _record_programs()
        else:
            _record_modules()
            _one_thread_a_block()
        devices, make = module.devices, module.make

        def as_gpus(devices: Any = devices) -> list[Any]:
            found = devices()
            return [_as_gpu(one, float64=kind == "double") if isinstance(one, Device) else one for one in found]

        def flushed(device: Any, dtype: Any, make: Any = make) -> Any:
            backend = make(device, dtype)
            if kind == "single" and device.backend == "opencl":
                backend._options += (_FLUSHED,)
            return backend

        module.devices, module.make = as_gpus, flushed
