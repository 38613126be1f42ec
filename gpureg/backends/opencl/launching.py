"""Launches of OpenCL kernels over a graph, for all primitives.

Programs are built once per device, primitive and build options, and cached; pyopencl caches the binaries on disk.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyopencl as cl

from ... import kernels
from ...graphs.grid import GridGraph
from ..bands import BY_ROWS
from ..failures import build_failed
from ..patches import PatchForm
from ..recorded import Parameter, Replay, Work, places
from ..types import Array, Conductance, Smoothness, Weighted
from .buffers import Function, OpenCLBuffers, Recomputed
from .failing import built, raise_if_full
from .geometry import round_up
from .layout import Collected, GridLayout
from .queue import KernelKey
from .recording import Record
from .strips import Strips

# Primitives that read both directions of an edge, whatever gamma is.
_MIRRORED = ("adjoint", "primal", "proximal", "duality_gap", "hessian")

# Primitives without neighbours. On a GPU a work item reads 16 bytes at once: cores have 2048 work items at most, and
# with 4 bytes for each the reads under way would not use all of the bandwidth.
_STREAMS = ("dot", "combine", "max_change", "mix")

# Work items of a group on a GPU.
_GPU_GROUP = 64


# Kernels that may run on a part of their work items, or groups.
_BY_ROWS = BY_ROWS | {"patch_groups", "patch_groups_gpu", "similarity_step_gpu", "sweep_gpu"}

# The number of a group counts from the first work item of a launch, that of a work item from the first of all.
_GROUPS_FROM_ITEMS = "#define get_group_id(axis) (get_global_id(axis) / get_local_size(axis))\n"


class OpenCLLaunches(OpenCLBuffers):
    """Launches of kernels over a graph."""

    def _kernel(self, primitive: str, options: tuple[str, ...], args: list[Any]) -> cl.Kernel:
        """Return the kernel with these build options and with the types of these arguments; cached."""
        key = (primitive, self._options + options)
        found = self._shared.kernels.get(key)
        if found is None:
            source = kernels.opencl_source(primitive)
            if self.device.watched and primitive in _BY_ROWS:
                source = _GROUPS_FROM_ITEMS + source
            try:
                program = built(self._shared.context, source, list(key[1]))
            except cl.Error as error:
                raise_if_full(self.device.handle, error)
                raise build_failed(self.device, self.dtype, primitive, str(error)) from error
            found = self._shared.kernels[key] = program.all_kernels()[0]
            # Without the types, pyopencl guesses that of each scalar: 0.15 ms per launch instead of 0.02.
            found.set_arg_types([arg.dtype if isinstance(arg, np.generic) else None for arg in args])
        return found

    def _run(
        self,
        primitive: str,
        weighted: Weighted,
        args: list[Any],
        options: tuple[str, ...] = (),
        size: tuple[int, ...] | None = None,
        *,
        exact: bool = False,
        local: tuple[int, ...] | None = None,
        sums: int | None = None,
        for_edges: bool = False,
    ) -> None:
        """Run a kernel over the graph's packs, or over `size` work items, in groups of `local`.

        On a GPU and on a stored graph, we choose the size of a group and round the number of work items up: a driver
        would choose groups of 1 for a prime number of work items. With `local` it is not rounded, nor with `exact` (a
        sum on a grid, whose kernel uses the number of work items), where the driver chooses.
        `sums` is how many numbers the kernel collects over the edges of a vertex, `for_edges` whether it needs them at
        all these edges; None: a vertex has one work item.
        """
        layout = weighted.topology
        weights, extra = weighted.weights, [self._nothing, self.real(0), self.real(0)]
        if isinstance(weights, Recomputed):
            options += weights.options
            extra = [weights.nearness, self.real(weights.form.shift), self.real(weights.scale)]
            weights = weights.compared
        elif weights is not None:
            options += ("-DGAMMA",) if weighted.directed else ("-DWEIGHTED",)
            options += ("-DHALF_WEIGHTS",) if weighted.storage == "half" else ()
        width = layout.width
        if primitive in _STREAMS and isinstance(layout, GridLayout) and layout.geometry.line:
            width, options = layout.geometry.stream_lanes, ("-DALIGNED", *options)
            size = size or (-(-layout.geometry.W // width), layout.geometry.rows)
        mirrored, buffer = weighted.directed or primitive in _MIRRORED, self._nothing if weights is None else weights
        collected = None if sums is None else Collected(sums, self.dtype.itemsize, for_edges)
        with self._shared.lock:
            for one in layout.launches(buffer, mirrored, collected, self._allocate):
                graph_args = [*one.args, *(extra if isinstance(layout, GridLayout) else ())]
                chosen = (*one.options, f"-DN={width}", *options)
                groups, items = local, size or one.size
                group = layout.group or (_GPU_GROUP if self.device.kind == "gpu" and not exact else None)
                if group is not None and local is None:
                    groups = (min(group, self.device.handle.max_work_group_size), *(1,) * (len(items) - 1))
                    items = (round_up(items[0], groups[0]), *items[1:])
                self._launch(primitive, chosen, [*graph_args, *args], items, groups)

    def _launch(
        self,
        primitive: str,
        options: tuple[str, ...],
        args: list[Any],
        size: tuple[int, ...],
        local: tuple[int, ...] | None,
    ) -> None:
        """Run a kernel over `size` work items, in groups of `local`; add it to the record if there is one."""
        varying = places(args)
        args = [self.real(arg) if isinstance(arg, Parameter) else arg for arg in args] if varying else args
        key = (primitive, self._options + options)
        with self._shared.lock:
            kernel = self._kernel(primitive, options, args)
            cut = self.device.watched and primitive in _BY_ROWS
            if self._record is not None:
                for band, offset in self._bands(key, size, local) if cut else [(size, None)]:
                    self._record.add(key, kernel, band, local, args, varying, offset)
            elif cut:
                self._in_bands(key, kernel, size, local, args)
            else:
                kernel(self._shared.queue, size, local, *args)

    def _in_bands(
        self, key: KernelKey, kernel: cl.Kernel, size: tuple[int, ...], local: tuple[int, ...] | None, args: list[Any]
    ) -> None:
        """Run a kernel in bands of the last axis, none of which takes long."""
        axis, unit = _last_axis(size, local)

        def launch(first: int, last: int) -> None:
            band, offset = _band(size, axis, first * unit, min(last * unit, size[axis]))
            kernel(self._shared.queue, band, local, *args, global_offset=offset)
            self._shared.queue.flush()

        items = math.prod(size) // size[axis] * unit
        self._shared.bands.run(key, -(-size[axis] // unit), items, launch, self._shared.queue.finish)

    def _bands(
        self, key: KernelKey, size: tuple[int, ...], local: tuple[int, ...] | None
    ) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
        """Return the sizes and offsets of the bands of a launch, as far as the speed of its kernel is known."""
        axis, unit = _last_axis(size, local)
        cuts = self._shared.bands.known(key, -(-size[axis] // unit), math.prod(size) // size[axis] * unit)
        return [_band(size, axis, first * unit, min(last * unit, size[axis])) for first, last in cuts]

    def record(self, work: Work, parameters: Sequence[Parameter]) -> Replay:
        recorder = copy.copy(self)
        recorder._record = Record(self._shared, self.real)
        work(recorder, *parameters)
        return recorder._record.replay

    def _real(self, x: float) -> Any:
        """Return a number as a kernel argument that may be a parameter."""
        return x if isinstance(x, Parameter) else self.real(x)

    def _launch_strips(
        self, primitive: str, options: tuple[str, ...], args: list[Any], size: tuple[int, int], strips: Strips
    ) -> None:
        """Run a kernel over blocks of cells; on a CPU a group is one block."""
        local = (1, 1)
        if strips.gpu:
            local = (min(64, self.device.handle.max_work_group_size), 1)
            size = (round_up(size[0], local[0]), size[1])
        self._launch(primitive, options, args, size, local)

    def _strips(self, graph: GridGraph, form: PatchForm, sums: int) -> Strips:
        gpu = self.device.kind == "gpu"
        return Strips(graph, form, 1 if gpu else self.lanes, self.dtype.itemsize, gpu, sums)

    def _number(self, x: float | Array, option: str) -> tuple[list[Any], tuple[str, ...]]:
        """Return the two kernel arguments for a number or a function, and the build options."""
        if isinstance(x, Function):
            return [x.buffer, self.real(0)], (option,)
        return [self._nothing, self.real(x)], ()

    def _lam(self, lam: float | Array) -> tuple[list[Any], tuple[str, ...]]:
        return self._number(lam, "-DLAM_ARRAY")

    def _g(self, g: Conductance, channels: int) -> tuple[list[Any], tuple[str, ...]]:
        """Return the kernel arguments CONDUCTANCE_ARGS, and the build options."""
        if isinstance(g, Smoothness):
            options = ("-DEDGE_NORM", f"-DG={g.norms(channels)}")
            return [self._nothing, self.real(g.power), self.real(g.eps) ** 2], options
        if g is None:
            return [self._nothing, self.real(0), self.real(0)], ()
        return [g.buffer, self.real(0), self.real(0)], ("-DCONDUCTANCES", f"-DG={g.channels}")

    def finish(self) -> None:
        with self._shared.waiting():
            self._shared.queue.finish()

    def release(self) -> None:
        self._scratch_memory = None
        self.finish()


def _last_axis(size: tuple[int, ...], local: tuple[int, ...] | None) -> tuple[int, int]:
    """Return the last axis with more than one group, or the first axis, and the work items of a group along it."""
    units = (1,) * len(size) if local is None else local
    axis = next((i for i in reversed(range(len(size))) if size[i] > units[i]), 0)
    return axis, units[axis]


def _band(size: tuple[int, ...], axis: int, first: int, last: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the size and the offset of a launch from one work item of an axis to another."""
    before, after = size[:axis], size[axis + 1 :]
    return (*before, last - first, *after), (*(0,) * len(before), first, *(0,) * len(after))
