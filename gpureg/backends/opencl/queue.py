"""What all work on one OpenCL device shares: context, queue, kernels, and the memory that work still uses."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pyopencl as cl


def _pocl_version(device: cl.Device) -> tuple[int, int] | None:
    match = re.search(r"PoCL (\d+)\.(\d+)", device.platform.version)
    return (int(match[1]), int(match[2])) if match else None


def vector_width(device: cl.Device) -> int:
    """float32 values a grid kernel treats at a time: 1 on a GPU, the native vector on a CPU.

    PoCL 3.0 (LLVM 14) reports 16 and then dies on float16 code, so it gets 8.
    """
    if device.type & cl.device_type.GPU:
        return 1
    native = int(device.native_vector_width_float) or 1
    width = max(w for w in (1, 2, 4, 8, 16) if w <= native)
    pocl = _pocl_version(device)
    return min(width, 8) if pocl is not None and pocl < (3, 1) else width


class HostBuffer(cl.Buffer):  # type: ignore[misc]
    """A buffer in memory of the host; a class of its own, so that its end can be seen."""


@dataclass(frozen=True)
class Queue:
    """What all work on one device shares: context, queue, and the kernels built so far."""

    context: cl.Context
    queue: cl.CommandQueue
    kernels: dict[tuple[str, tuple[str, ...]], cl.Kernel]
    lock: threading.RLock  # a kernel object holds its arguments: one caller at a time
    process: int
    # Host memory of buffers that are no more: what was queued may still use it, until a wait is over.
    leaving: deque[npt.NDArray[np.uint8]]

    @contextlib.contextmanager
    def waiting(self) -> Iterator[None]:
        """Around a call that waits for all that was queued before it."""
        gone = []
        with contextlib.suppress(IndexError):
            while True:
                gone.append(self.leaving.popleft())
        try:
            yield
        except BaseException:  # it may not have waited
            self.leaving.extend(gone)
            raise


@functools.cache
def queue(device: cl.Device) -> Queue:
    """The one of this device."""
    context = cl.Context([device])
    return Queue(context, cl.CommandQueue(context), {}, threading.RLock(), os.getpid(), deque())
