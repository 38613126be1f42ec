"""Gradient norm and Jacobi step in one launch, on a GPU (``sweep_gpu.py``)."""

from __future__ import annotations

import numpy as np
import warp as wp

from ...graphs.grid import GridGraph
from ...kernels.warp import sweep_gpu
from ..types import Array, Smoothness, Weighted
from .launching import WarpLaunches
from .layout import channels_of, form_of

# Rows of a thread: the first that has room in the shared memory that a kernel may use without options.
_ROWS, _SHARED_BYTES = (8, 4), 48 << 10


class WarpSweeps(WarpLaunches):
    """The fused sweep."""

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
        graph, M = weighted.graph, channels_of(f)
        rows = self._tile_rows(weighted, model, M)
        if rows is None:
            return super().sweep(weighted, f, f0, lam, model, theta=theta, g=g, out=out)
        assert isinstance(graph, GridGraph)
        offsets = tuple(tuple(step) for step in graph.forward_offsets.tolist())
        items = 1 if self._on.is_cpu else sweep_gpu.ITEMS
        bound = weighted.topology
        options = (bound.access, M, offsets, weighted.weights is not None, isinstance(lam, wp.array), rows, items)
        inner = (sweep_gpu.TY * rows - 2 * sweep_gpu.HALO, sweep_gpu.TX - 2 * sweep_gpu.HALO)
        tiles = int(np.prod([-(-size // own) for size, own in zip(graph.shape, inner, strict=True)]))
        inputs = [bound.argument, f, f0, model.power, self._squared(model.eps), lam, theta]
        self._launch((tiles, items), sweep_gpu.make, options, inputs, out, work=bound.layout.work)
        return out

    def _tile_rows(self, weighted: Weighted, model: Smoothness, channels: int) -> int | None:
        """Return the rows of a thread, or None where the two kernels are launched."""
        graph = weighted.graph
        if self.device.kind == "cpu" or not model.has_function or model.norms(channels) > 1:
            return None
        if not isinstance(graph, GridGraph) or graph.ndim != 2 or weighted.directed:
            return None
        if form_of(weighted.weights) not in ("unit", "weights") or np.abs(graph.offsets).max(initial=0) != 1:
            return None
        for rows in _ROWS:
            cells = (sweep_gpu.TY * rows + 2) * (sweep_gpu.TX + 2)
            if (channels + 1) * cells * self.dtype.itemsize <= _SHARED_BYTES:
                return rows
        return None
