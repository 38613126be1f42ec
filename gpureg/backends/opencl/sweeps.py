"""The fused sweeps in OpenCL: ``sweep.cl`` on a CPU, ``sweep_gpu.cl`` on a GPU."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...graphs.grid import AnyGraph
from ..types import Array, Smoothness, Weighted
from .geometry import GridGeometry
from .launching import OpenCLLaunches
from .layout import GridLayout

# A tile of ``sweep_gpu.cl``: columns, work items per column, and cells of the halo on each side.
_COLUMNS, _DOWN, _HALO = 64, 4, 2

# Channels with one gradient norm at most: a tile in float64 then takes 47,520 bytes of the 48 KiB that any GPU has.
_MOST_CHANNELS = 4


class OpenCLSweeps(OpenCLLaunches):
    """Gradient norm and Jacobi step in one launch."""

    def sweep_bytes(self, graph: AnyGraph, channels: int, norms: int) -> int:
        geometry = self._geometry(graph)
        if not isinstance(geometry, GridGeometry) or self.device.kind == "gpu" or not norms:
            return 0
        blocks = geometry.blocks(channels, norms, True, self.device.handle.max_compute_units)
        return math.prod(blocks.count) * blocks.ring_size * self.dtype.itemsize

    def sweep(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        lam: float | Array,
        model: Smoothness,
        *,
        theta: float,
        g: Array | None,
        out: Array,
    ) -> Array:
        layout = weighted.topology
        if model.has_function and isinstance(layout, GridLayout) and not weighted.directed:
            lams, options = self._lam(lam)
            args = [self.real(model.power), self.real(model.eps) ** 2, *lams, self.real(theta)]
            if self.device.kind == "cpu":
                self._sweep_blocks(weighted, layout, f, f0, model, args, options, out)
                return out
            if self._has_tiles(layout.geometry, model.norms(f.channels), f.channels):
                self._sweep_tiles(weighted, layout, f, f0, model, args, options, out)
                return out
        return super().sweep(weighted, f, f0, lam, model, theta=theta, g=g, out=out)

    def _sweep_blocks(
        self,
        weighted: Weighted,
        layout: GridLayout,
        f: Array,
        f0: Array,
        model: Smoothness,
        numbers: list[Any],
        options: tuple[str, ...],
        out: Array,
    ) -> None:
        """Run ``sweep.cl``: a core goes down a block; `numbers` are power, eps^2, lam and theta as arguments."""
        G, geometry = model.norms(f.channels), layout.geometry
        stored = weighted.weights is not None and weighted.storage != "none"
        cores = self.device.handle.max_compute_units
        blocks = geometry.blocks(f.channels, G, stored, cores, wide=geometry.wide and weighted.storage != "none")
        args = [
            f.buffer,
            f0.buffer,
            *numbers,
            np.int32(blocks.band),
            np.int32(blocks.stretch),
            np.int32(geometry.jump),
            np.int32(blocks.slots),
            np.int64(blocks.ring_pitch),
            layout.rings(blocks, self._allocate),
            out.buffer,
        ]
        options = (f"-DM={f.channels}", f"-DG={G}", *options)
        self._run("sweep", weighted, args, options, blocks.count, exact=True, local=(1, 1))

    def _cells(self, channels: int) -> int:
        """Return the cells of a work item of ``sweep_gpu.cl``, for `channels` that share a gradient norm."""
        return 4 if self.dtype == np.float64 or channels > 2 else 8

    def _has_tiles(self, geometry: GridGeometry, norms: int, channels: int) -> bool:
        """Whether a sweep can run in tiles: neighbours one cell away on two axes, and a work group fits the device."""
        device, shared = self.device.handle, channels if norms == 1 else 1
        near = len(geometry.shape) == 2 and geometry.compiled_in and max(geometry.reach, geometry.jump) <= 1
        cells = (_COLUMNS + 2) * (_DOWN * self._cells(shared) + 2)
        local = (shared + 1) * cells * self.dtype.itemsize
        fits = device.max_work_group_size >= _COLUMNS * _DOWN and device.local_mem_size >= local
        return near and fits and shared <= _MOST_CHANNELS

    def _sweep_tiles(
        self,
        weighted: Weighted,
        layout: GridLayout,
        f: Array,
        f0: Array,
        model: Smoothness,
        numbers: list[Any],
        options: tuple[str, ...],
        out: Array,
    ) -> None:
        """Run ``sweep_gpu.cl``: a work group has a tile; channels with a norm each are done one by one."""
        norms, geometry = model.norms(f.channels), layout.geometry
        channels = f.channels if norms == 1 else 1
        cells = self._cells(channels)
        size = (
            -(-geometry.W // (_COLUMNS - 2 * _HALO)) * _COLUMNS,
            -(-geometry.rows // (_DOWN * cells - 2 * _HALO)) * _DOWN,
            norms,
        )
        # p = 1 is worth a program of its own: otherwise a third of its instructions choose how to raise to a power
        power = ("-DPOWER=-0.5f",) if model.p == 1 else ()
        tile = (f"-DM={channels}", f"-DTY={_DOWN}", f"-DS={cells}", *power)
        args = [f.buffer, f0.buffer, *numbers, out.buffer]
        self._run("sweep_gpu", weighted, args, (*tile, *options), size, local=(_COLUMNS, _DOWN, 1))
