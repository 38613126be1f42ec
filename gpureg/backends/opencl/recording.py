"""Recorded launches of OpenCL kernels: kernel objects with their arguments set, enqueued again and again."""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np
import pyopencl as cl

from .failing import raise_if_full
from .queue import KernelKey, Queue

Sides = tuple[int, ...] | None
"""Work items along each axis; None: the driver chooses, or none at all."""


class Record:
    """Launches in their order.

    Each has a kernel object of its own, whose arguments stay as they are, so that a launch needs neither the device's
    lock nor a look at the arguments. Kernel objects take a tenth of a millisecond to make: those of a deleted record
    serve the next one.
    """

    def __init__(self, shared: Queue, real: Any) -> None:
        self._queue, self._real = shared.queue, real
        self._launches: list[tuple[cl.Kernel, tuple[int, ...], Sides, Sides]] = []
        # A driver need not keep the buffers of a kernel's arguments.
        self._args: list[list[Any]] = []
        # (function that sets an argument, place of the argument, place of the parameter)
        self._varying: list[tuple[Any, int, int]] = []
        self._shared = shared

    def add(
        self,
        key: KernelKey,
        like: cl.Kernel,
        size: tuple[int, ...],
        local: Sides,
        args: list[Any],
        varying: list[tuple[int, int]],
        offset: Sides = None,
    ) -> None:
        """Add a launch of the kernel `like`, and launch it; `varying` has pairs of places, as in `places`.

        `offset` is the first work item along each axis.
        """
        spare = self._shared.spare.setdefault(key, [])
        try:
            kernel = spare.pop()
        except IndexError:
            kernel = cl.Kernel(like.program, like.function_name)
            kernel.set_arg_types([arg.dtype if isinstance(arg, np.generic) else None for arg in args])
        weakref.finalize(self, spare.append, kernel)
        kernel.set_args(*args)
        # set_arg tries all kinds of arguments, which takes 7 us; pyopencl's own function for numbers 0.1 us
        setter = getattr(kernel, "_set_arg_buf", kernel.set_arg)
        self._varying += [(setter, at, number) for at, number in varying]
        self._args.append(args)
        self._launches.append((kernel, size, local, offset))
        cl.enqueue_nd_range_kernel(self._queue, kernel, size, local, offset)

    def replay(self, *numbers: float) -> None:
        """Launch all, with these numbers as the parameters."""
        queue, enqueue = self._queue, cl.enqueue_nd_range_kernel
        try:
            for setter, at, number in self._varying:
                setter(at, self._real(numbers[number]))
            for kernel, size, local, offset in self._launches:
                enqueue(queue, kernel, size, local, offset)
        except cl.Error as error:
            raise_if_full(self._shared.context.devices[0], error)
            raise
