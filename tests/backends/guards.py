"""Backends whose arrays lie between guard values, so that a write outside of one is found.

All that is not written yet, and the guards, are NaN as a number, and negative as an integer. So a read outside of an
array, or of what nothing wrote, shows in the values. The NaN is a signalling one, which arithmetic makes a quiet one:
what is computed from a guard and written to another one is found.
"""

from __future__ import annotations

import contextlib
import math
import weakref
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import numpy as np

# Bytes of a guard; more on a device whose buffers begin at multiples of more.
GUARD = 512
# Signalling NaN by the bytes of a number.
FILL = {4: np.uint32(0xFFA5A5A5), 8: np.uint64(0xFFF5A5A5A5A5A5A5)}


def _filled(nbytes: int, itemsize: int) -> Any:
    """So many bytes and a few more, of NaN."""
    return np.full(-(-nbytes // itemsize), FILL[itemsize]).view(np.uint8)


class Guarded:
    """What the three kinds have in common: the guards that are to be looked at."""

    dtype: Any
    # of each array: gives the bytes before and behind it, and how many lie between
    frames: list[Callable[[], tuple[Any, Any, int]]]

    def framing(self) -> Any:
        """A context in which arrays that the backend makes by itself lie between guards too."""
        return contextlib.nullcontext()

    def check_guards(self) -> None:
        """AssertionError if a guard of any array made since the last call was written; forgets these arrays."""
        frames, self.frames[:] = list(self.frames), []
        for frame in frames:
            before, behind, gap = frame()
            whole = _filled(len(before) + gap + len(behind), self.dtype.itemsize)
            for side, found, begin in (("before", before, 0), ("behind", behind, len(before) + gap)):
                written = np.count_nonzero(found != whole[begin : begin + len(found)])
                assert not written, f"{written} bytes written outside of an array, {side} it"


class _OpenCL(Guarded):
    def _allocate(self: Any, nbytes: int) -> Any:
        import pyopencl as cl

        shared = self._shared
        size, guard = max(nbytes, self.dtype.itemsize), max(GUARD, self.device.handle.mem_base_addr_align // 8)
        fill, total = FILL[self.dtype.itemsize], -(-(size + 2 * guard) // 8) * 8
        whole = cl.Buffer(shared.context, cl.mem_flags.READ_WRITE, total)
        cl.enqueue_fill_buffer(shared.queue, whole, fill, 0, total)

        def frame() -> tuple[Any, Any, int]:
            sides = np.empty((2, guard), np.uint8)
            for side, begin in zip(sides, (0, guard + size), strict=True):
                cl.enqueue_copy(shared.queue, side, whole, src_offset=begin, is_blocking=True)
            return sides[0], sides[1], size

        self.frames.append(frame)
        return whole.get_sub_region(guard, size)


class _Numpy(Guarded):
    def _framed(self: Any, values: Any) -> Any:
        nbytes = values.nbytes
        whole = _filled(nbytes + 2 * GUARD, self.dtype.itemsize)
        inner = whole[GUARD : GUARD + nbytes].view(values.dtype).reshape(values.shape)
        inner[...] = values
        self.frames.append(lambda: (whole[:GUARD], whole[GUARD + nbytes :], nbytes))
        return inner

    def put(self: Any, graph: Any, f: Any) -> Any:
        return self._framed(super().put(graph, f))

    def put_edges(self: Any, graph: Any, values: Any) -> Any:
        return self._framed(super().put_edges(graph, values))

    def empty(self: Any, graph: Any, channels: int) -> Any:
        return self._framed(super().empty(graph, channels))

    def empty_edges(self: Any, graph: Any, channels: int) -> Any:
        return self._framed(super().empty_edges(graph, channels))


class _Warp(Guarded):
    def _framed(self: Any, shape: Any, dtype: Any) -> Any:
        import warp as wp

        nbytes = math.prod(shape) * wp.types.type_size_in_bytes(dtype)
        whole = wp.array(_filled(nbytes + 2 * GUARD, self.dtype.itemsize), dtype=wp.uint8, device=self._on)
        inner = wp.array(ptr=whole.ptr + GUARD, dtype=dtype, shape=tuple(shape), device=self._on)
        inner.whole = whole  # lives as long

        def frame() -> tuple[Any, Any, int]:
            host = whole.numpy()
            return host[:GUARD], host[GUARD + nbytes :], nbytes

        self.frames.append(frame)
        return inner

    def upload(self: Any, values: Any, dtype: Any) -> Any:
        made = super().upload(values, dtype)
        inner = self._framed(made.shape, made.dtype)
        inner.assign(made)
        return inner

    @contextlib.contextmanager
    def framing(self: Any) -> Iterator[None]:
        import warp as wp

        def empty(shape: Any, dtype: Any = float, device: Any = None, **_: Any) -> Any:
            return self._framed((shape,) if isinstance(shape, int) else shape, dtype)

        def zeros(shape: Any, dtype: Any = float, device: Any = None, **_: Any) -> Any:
            made = empty(shape, dtype)
            made.zero_()
            return made

        with mock.patch.object(wp, "zeros", zeros), mock.patch.object(wp, "empty", empty):
            yield


_KINDS = {"opencl": _OpenCL, "numpy": _Numpy, "warp": _Warp}
_made: weakref.WeakKeyDictionary[Any, Any] = weakref.WeakKeyDictionary()


def guarded(backend: Any) -> Any:
    """A backend like this one, with the kernels that it has compiled, whose arrays lie between guards."""
    found = _made.get(backend)
    if found is None:
        kind = type("Guarded", (_KINDS[backend.name], type(backend)), {})
        found = object.__new__(kind)
        found.__dict__.update(backend.__dict__)
        found.frames = []
        for name in ("_topologies", "_layouts"):  # what was made without guards stays with the other one
            if hasattr(found, name):
                setattr(found, name, weakref.WeakKeyDictionary())
        if hasattr(found, "_kept"):
            found._kept = None
        _made[backend] = found
    return found
