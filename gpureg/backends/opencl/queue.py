"""The context, the queue, the kernels and the memory in use of one OpenCL device."""

from __future__ import annotations

import contextlib
import functools
import os
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from ..bands import Bands
from .failing import Turn, raise_if_full


def pocl_version(device: cl.Device) -> tuple[int, int] | None:
    """Return the version of PoCL, None for another driver."""
    match = re.search(r"PoCL (\d+)\.(\d+)", device.platform.version)
    return (int(match[1]), int(match[2])) if match else None


def vector_width(device: cl.Device) -> int:
    """Return the float32 values that a grid kernel computes at a time: 1 on a GPU, the native vector on a CPU.

    PoCL 3.0 (LLVM 14) reports 16 but crashes on code with float16, so the maximum is 8 there.
    """
    if device.type & cl.device_type.GPU:
        return 1
    native = int(device.native_vector_width_float) or 1
    width = max(w for w in (1, 2, 4, 8, 16) if w <= native)
    pocl = pocl_version(device)
    return min(width, 8) if pocl is not None and pocl < (3, 1) else width


class HostBuffer(cl.Buffer):  # type: ignore[misc]
    """A buffer in host memory; a subclass, as weakref.finalize needs one."""


KernelKey = tuple[str, tuple[str, ...]]
"""The primitive and all build options of a kernel."""


@dataclass(frozen=True)
class Queue:
    """The context and queue of a device, and the kernels built so far."""

    context: cl.Context
    queue: cl.CommandQueue
    kernels: dict[KernelKey, cl.Kernel]
    spare: dict[KernelKey, list[cl.Kernel]]  # kernel objects of deleted records
    lock: Turn  # a kernel object stores its arguments: one caller at a time
    process: int
    # Host memory of deleted buffers: queued work may still use it, until the next wait is over.
    leaving: deque[npt.NDArray[np.uint8]]
    bands: Bands = field(default_factory=Bands)

    @contextlib.contextmanager
    def waiting(self) -> Iterator[None]:
        """Free the host memory of deleted buffers after a call that waits for all queued work."""
        gone = []
        with contextlib.suppress(IndexError):
            while True:
                gone.append(self.leaving.popleft())
        try:
            yield
        except BaseException as error:  # the call may not have waited
            self.leaving.extend(gone)
            raise_if_full(self.context.devices[0], error, allocating=True)
            raise


@functools.cache
def queue(device: cl.Device) -> Queue:
    """Return the shared queue of this device."""
    context = cl.Context([device])
    return Queue(context, cl.CommandQueue(context), {}, {}, Turn(device), os.getpid(), deque())
