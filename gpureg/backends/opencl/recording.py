"""Recorded launches of OpenCL kernels: their arguments are ready, and after some time set once and for all."""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl

from .failing import raise_if_full
from .queue import KernelKey, Queue

Sides = tuple[int, ...] | None
"""Work items along each axis; None: the driver chooses, or none at all."""

# Replays until launches get kernel objects of their own: one takes 120 us to make, and then saves 2 us a launch.
_SHARED = 60


@dataclass
class _Launch:
    """A launch of a kernel: work items, those of a group, the first one, arguments, and pairs as in `places`."""

    key: KernelKey
    kernel: cl.Kernel
    size: tuple[int, ...]
    local: Sides
    offset: Sides
    args: list[Any]  # a driver need not keep the buffers of a kernel's arguments
    varying: list[tuple[int, int]]


class Record:
    """Launches in their order.

    At first they share the kernel objects of all callers, and set their arguments each time, in turn with the others.
    Later each has an object of its own, whose arguments stay as they are: a launch then needs neither the device's lock
    nor a look at the arguments. The objects of a deleted record serve the next one.
    """

    def __init__(self, shared: Queue, real: Any) -> None:
        self._shared, self._real = shared, real
        self._launches: list[_Launch] = []
        self._left = _SHARED
        # With kernels of our own: arguments of the driver's call, and (setter, place of the argument, parameter).
        self._own: list[tuple[cl.Kernel, tuple[int, ...], Sides, Sides]] = []
        self._setters: list[tuple[Any, int, int]] = []

    def add(
        self,
        key: KernelKey,
        kernel: cl.Kernel,
        size: tuple[int, ...],
        local: Sides,
        args: list[Any],
        varying: list[tuple[int, int]],
        offset: Sides = None,
    ) -> None:
        """Add a launch, and launch it; the caller has the device's lock.

        `varying` has pairs of places, as in `places`; `offset` is the first work item along each axis.
        """
        kernel.set_args(*args)
        cl.enqueue_nd_range_kernel(self._shared.queue, kernel, size, local, offset)
        self._launches.append(_Launch(key, kernel, size, local, offset, list(args), varying))

    def replay(self, *numbers: float) -> None:
        """Launch all, with these numbers as the parameters."""
        if self._left > 0:
            self._left -= 1
            self._replay_shared(numbers)
            return
        if not self._own:
            self._make_own()
        queue, enqueue = self._shared.queue, cl.enqueue_nd_range_kernel
        try:
            for setter, at, number in self._setters:
                setter(at, self._real(numbers[number]))
            for kernel, size, local, offset in self._own:
                enqueue(queue, kernel, size, local, offset)
        except cl.Error as error:
            raise_if_full(self._shared.context.devices[0], error)
            raise

    def _replay_shared(self, numbers: tuple[float, ...]) -> None:
        queue, enqueue = self._shared.queue, cl.enqueue_nd_range_kernel
        with self._shared.lock:
            for launch in self._launches:
                for at, number in launch.varying:
                    launch.args[at] = self._real(numbers[number])
                launch.kernel.set_args(*launch.args)
                enqueue(queue, launch.kernel, launch.size, launch.local, launch.offset)

    def _make_own(self) -> None:
        """Give each launch a kernel object of its own, with its arguments."""
        own, setters = [], []
        for launch in self._launches:
            spare = self._shared.spare.setdefault(launch.key, [])
            try:
                kernel = spare.pop()
            except IndexError:
                kernel = cl.Kernel(launch.kernel.program, launch.kernel.function_name)
            weakref.finalize(self, spare.append, kernel)
            # set_arg tries all kinds of arguments, which takes 7 us; pyopencl's own function for numbers 0.1 us
            setter = getattr(kernel, "_set_arg_buf", kernel.set_arg)
            for at, arg in enumerate(launch.args):
                (setter if isinstance(arg, np.generic) else kernel.set_arg)(at, arg)
            setters += [(setter, at, number) for at, number in launch.varying]
            own.append((kernel, launch.size, launch.local, launch.offset))
        self._setters, self._own = setters, own
