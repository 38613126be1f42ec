"""Planes of cells around a grid, on a Warp device."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from ...graphs.grid import GridGraph, row_major
from ...kernels.warp import padded
from . import memory
from .cells import WarpCells


class WarpPlanes(WarpCells):
    """Functions in planes with cells beyond the border, as kernels of patches read them (``padded.py``)."""

    def _numbers(self, f: Any) -> Any:
        """Return the numbers of a device function as a flat array, which shares its memory."""
        size = math.prod(f.shape) * math.prod(f.dtype._shape_)
        flat = wp.array(ptr=f.ptr, dtype=self.real, shape=(size,), device=self._on)
        flat._of = f  # keeps the memory
        return flat

    def _planes(
        self,
        graph: GridGraph,
        f: Any | None,
        radius: Sequence[int],
        shape: Sequence[int],
        before: Sequence[int],
        *,
        reflects: bool = True,
    ) -> Any:
        """Return the planes of a function, flat: `shape` each, with `before` zeros in front along each axis.

        `f` is a device function or a host array (n, m); None for a function that is 1 everywhere. `radius` cells beyond
        the grid are reflected, or zeros.
        """
        channels, values = 1, None
        if f is not None:
            function = self.on_device(graph, f)
            channels, values = self.channels(function), self._numbers(function)
        axes = np.array([graph.shape, radius, before, shape, row_major(graph.shape)], np.int32)
        out = memory.empty(channels * math.prod(shape), dtype=self.real, device=self._on)
        rows, width, lines = math.prod(shape[:-1]), shape[-1], bool(self._on.is_cpu)
        inputs = [values, self.upload(axes.ravel(), wp.int32), graph.n_vertices, reflects, width]
        dim = (rows, 1 if lines else width)
        self._launch(dim, padded.make, (self.real, lines), inputs, out, work=rows * width * channels)
        return out

    def _mask_function(self, graph: GridGraph) -> npt.NDArray[Any] | None:
        """Return the mask as a host function (n, 1), None without one."""
        return None if graph.mask is None else graph.mask.reshape(-1, 1)
