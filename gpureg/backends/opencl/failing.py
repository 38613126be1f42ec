"""What goes wrong in an OpenCL driver: builds that fail, memory that runs out, compilers that talk."""

from __future__ import annotations

import os
import threading
import warnings
from typing import Any

import pyopencl as cl

from ..failures import out_of_memory

# MEM_OBJECT_ALLOCATION_FAILURE and OUT_OF_HOST_MEMORY. A launch says OUT_OF_RESOURCES for other reasons as well: too
# many registers, or a write outside a buffer; an allocation or a copy does not.
_NO_ROOM, _NO_RESOURCES = frozenset({-4, -6}), frozenset({-5})


class Turn:
    """A caller's turn on a device: one at a time, and if the driver has no memory left, that is a MemoryError.

    Drivers of GPUs allocate a buffer when it is first used, so that a launch may fail, too.
    """

    def __init__(self, device: cl.Device) -> None:
        self._lock, self._device = threading.RLock(), device

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self._lock.release()
        if error is not None:
            raise_if_full(self._device, error)


def raise_if_full(device: cl.Device, error: BaseException, *, allocating: bool = False) -> None:
    """Raise a MemoryError if an error of the driver says that memory has run out."""
    codes = _NO_ROOM | _NO_RESOURCES if allocating else _NO_ROOM
    if isinstance(error, cl.Error) and _code(error) in codes:
        raise out_of_memory(device.name.strip(), str(error)) from error


def _code(error: cl.Error) -> int:
    try:
        return int(error.code)
    except (AttributeError, IndexError):  # an error that pyopencl itself raises
        return 0


def built(context: cl.Context, source: str, options: list[str]) -> Any:
    """Build a program, (cl.Program); a cl.Error has the compiler's log.

    The remarks of a build that succeeds are not shown, unless PYOPENCL_COMPILER_OUTPUT asks for them.
    """
    with warnings.catch_warnings():
        if not os.environ.get("PYOPENCL_COMPILER_OUTPUT"):
            warnings.simplefilter("ignore", cl.CompilerWarning)
        return cl.Program(context, source).build(options=options)
