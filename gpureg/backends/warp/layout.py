"""The layouts of functions and weights in Warp arrays, as in ``csr.py`` and ``grid.py``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from ...arrays import FloatArray
from ...graphs.csr import Graph
from ...graphs.edges import opposite_edges
from ...graphs.grid import GridGraph, row_major
from ...kernels.warp import csr, grid
from ..patches import PatchForm
from ..types import Array, DeviceCopies

Upload = Callable[[npt.NDArray[Any], Any], Any]
"""A function that copies a host array to the device, as numbers or vectors of a Warp type."""


def equal_cuts(size: int, pieces: int) -> list[int]:
    """Return where to cut a range into pieces of the same size, (pieces + 1)."""
    return [size * i // pieces for i in range(pieces + 1)]


@dataclass(frozen=True, eq=False)
class Recomputed:
    """The data from which a grid's weights between single cells are computed at each use.

    Attributes
    ----------
    compared : object
        The function that they compare, with the mask as one more channel if there is one.
    nearness : object
        (H,): spatial factors.
    channels : int
        Channels without the mask.
    masked : bool
    form : PatchForm
    """

    compared: Any
    nearness: Any
    channels: int
    masked: bool
    form: PatchForm


def form_of(weights: Any) -> Any:
    """Return the form of undirected edges, as in ``grid.py``."""
    if isinstance(weights, Recomputed):
        return weights.channels, weights.masked
    if weights is None:
        return "unit"
    return "half" if weights.dtype == wp.float16 else "weights"


class Csr:
    """A stored graph on the device."""

    def __init__(self, real: Any, upload: Upload, graph: Graph) -> None:
        if graph.n_edges >= 2**31:
            raise MemoryError(
                f"the graph has {graph.n_edges} directed edges, a Warp array can have less than 2^31: "
                "use a GridGraph, or another backend"
            )
        self.shape = (1, graph.n_vertices)
        self.weight_shape: tuple[int, ...] = (max(graph.n_edges, 1),)
        self._n_edges = graph.n_edges
        self._real = real
        self._struct = csr.struct(self._real)
        self.indptr = upload(graph.indptr.astype(np.int32), wp.int32)
        self.indices = upload(graph.indices.astype(np.int32, copy=False), wp.int32)
        # For the mirror, made at first use. A reference to the graph would keep it in the weak cache of layouts.
        self._upload, self._topology = upload, (graph.indptr, graph.indices)
        self._mirror: Any = None
        self._cuts: dict[int, list[int]] = {}
        self.copies = DeviceCopies()

    @property
    def work(self) -> int:
        return self.shape[1] + self._n_edges

    def cuts(self, size: int, pieces: int) -> list[int]:
        """Return where to cut the vertices into runs with about the same number of edges and vertices."""
        if size != self.shape[1]:
            return equal_cuts(size, pieces)
        if pieces not in self._cuts:
            indptr = self._topology[0]
            ends = indptr + np.arange(len(indptr))
            self._cuts[pieces] = np.searchsorted(ends, np.linspace(0, int(ends[-1]), pieces + 1)).tolist()
        return self._cuts[pieces]

    def pack_weights(self, weights: FloatArray) -> FloatArray:
        return weights

    def unpack_weights(self, packed: FloatArray) -> FloatArray:
        return packed[: self._n_edges]

    def edge_shape(self) -> tuple[int, ...]:
        return (1, 1, self._n_edges)

    def pack_edges(self, values: FloatArray) -> FloatArray:
        return values.reshape(1, 1, self._n_edges, -1) if values.size else values.reshape(1, 1, 0, values.shape[-1])

    def unpack_edges(self, packed: FloatArray) -> FloatArray:
        return packed.reshape(-1, packed.shape[-1])[: self._n_edges]

    def pack_gamma(self, gamma: FloatArray) -> FloatArray:
        return gamma[..., 0]

    def access(self, form: str) -> Any:
        return csr.make(self._real, form)

    def argument(self, weights: Any, mirrored: bool) -> Any:
        argument = self._struct()
        argument.indptr, argument.indices = self.indptr, self.indices
        if weights is not None:
            argument.weights = weights
        if mirrored:
            if self._mirror is None:
                self._mirror = self._upload(opposite_edges(*self._topology).astype(np.int32), wp.int32)
            argument.mirror = self._mirror
        return argument


class Grid:
    """An implicit grid on the device, in the layout of ``grid.py``."""

    def __init__(self, real: Any, upload: Upload, graph: GridGraph) -> None:
        self.shape = (math.prod(graph.shape[:-1]), graph.shape[-1])
        self.H = graph.half_window
        self.weight_shape = (self.shape[0], max(self.H, 1), self.shape[1])
        self._graph_shape = graph.shape
        self._real = real
        place, sizes = grid.places(graph.ndim)
        leading = graph.ndim - 1 if graph.ndim > 2 else 0
        rows = graph.offsets[:, :-1] @ row_major(graph.shape[:-1])
        self._reach = int(np.abs(graph.offsets[:, -1]).max(initial=0))
        steps = np.column_stack([rows, graph.offsets[:, -1], graph.offsets[:, :leading]])
        self.offsets = upload(steps.astype(np.int32), place)
        self._sizes = sizes(*graph.shape[:leading]) if leading else sizes(0)
        self.copies = DeviceCopies()

    @property
    def work(self) -> int:
        return math.prod(self.shape) * (1 + 2 * self.H)

    def cuts(self, size: int, pieces: int) -> list[int]:
        return equal_cuts(size, pieces)

    def pack_weights(self, weights: FloatArray) -> FloatArray:
        rows, width = self.shape
        return np.ascontiguousarray(weights.reshape(self.H, rows, width).transpose(1, 0, 2))

    def unpack_weights(self, packed: FloatArray) -> FloatArray:
        half = packed[:, : self.H].transpose(1, 0, 2)
        return np.ascontiguousarray(half).reshape(self.H, *self._graph_shape)

    def edge_shape(self) -> tuple[int, ...]:
        return (self.shape[0], 2 * self.H, self.shape[1])

    def pack_edges(self, values: FloatArray) -> FloatArray:
        rows, width = self.shape
        return np.ascontiguousarray(values.reshape(2 * self.H, rows, width, values.shape[-1]).transpose(1, 0, 2, 3))

    def unpack_edges(self, packed: FloatArray) -> FloatArray:
        planes = packed[:, : 2 * self.H].transpose(1, 0, 2, 3)
        return np.ascontiguousarray(planes).reshape(2 * self.H, *self._graph_shape, packed.shape[-1])

    def pack_gamma(self, gamma: FloatArray) -> FloatArray:
        return self.pack_edges(gamma)[..., 0]

    def access(self, form: Any) -> Any:
        return grid.make(self._real, len(self._graph_shape), form)

    def argument(self, weights: Any, mirrored: bool) -> Any:
        form = form_of(weights)
        stored = "full" if form in ("unit", "weights") else form
        argument = grid.struct(self._real, len(self._graph_shape), stored)()
        argument.n_rows, argument.width = self.shape
        argument.H, argument.sizes, argument.offsets = self.H, self._sizes, self.offsets
        argument.reach = self._reach
        if isinstance(weights, Recomputed):
            argument.compared, argument.nearness = weights.compared, weights.nearness
            argument.shift, argument.scale = weights.form.shift, weights.form.scale
        elif weights is not None:
            argument.weights = weights
        return argument


@dataclass(frozen=True, eq=False)
class Bound:
    """A graph with its weights for the kernels: their access functions, and their first argument."""

    layout: Csr | Grid
    access: Any
    argument: Any


def channels_of(x: Array) -> int:
    """Return the channels of a function on the device."""
    return int(x.dtype._shape_[0])
