"""The protocol for data on a device: graphs, weights, functions on vertices and edges, and their sizes in bytes.

A function is a device array in a layout that only its backend knows. ``put`` and ``get`` copy it to and from a host
array of shape (n, channels).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..graphs.grid import AnyGraph, GridGraph
from .recorded import Parameter, Replay, Work
from .types import Array, Device, Storage, Weighted


class Data(ABC):
    """Graphs and functions on one device in one floating-point type.

    Parameters
    ----------
    device : Device
    dtype : dtype
        float32 or float64.
    """

    name: ClassVar[str]

    # The forms of stored weights (see `patch_distance`) that save memory in this backend; others may be accepted too.
    storages: ClassVar[tuple[Storage, ...]] = ("full",)

    # Whether `similarity_step` computes averaged weights, on grids of two axes.
    averages: ClassVar[bool] = False

    # `similarity_step` on a part of a grid gives the same bits as on the whole grid if the first row and column of the
    # part are multiples of these. All other primitives do so for any part.
    row_block: int = 1
    column_block: int = 1

    def __init__(self, device: Device, dtype: npt.DTypeLike) -> None:
        self.device = device
        # numpy's own object for this type: ufunc.at is 30 times slower with an equal one
        self.dtype = np.dtype(np.dtype(dtype).type)
        self.real: Any = self.dtype.type  # makes a scalar of this type

    def __repr__(self) -> str:
        return f"{self.device.id} ({self.device.name}, {self.device.driver}), {self.dtype}"

    @abstractmethod
    def channels(self, x: Array) -> int:
        """Return the number of channels of a device function, on the vertices or on the edges."""

    @abstractmethod
    def put(self, graph: AnyGraph, f: npt.NDArray[Any]) -> Array:
        """Copy a host function (n, channels) to the device, in the backend's dtype."""

    @abstractmethod
    def get(self, graph: AnyGraph, x: Array) -> FloatArray:
        """Copy a device function to a host array (n, channels)."""

    @abstractmethod
    def empty(self, graph: AnyGraph, channels: int) -> Array:
        """Allocate a device function."""

    @abstractmethod
    def prepare(self, graph: AnyGraph, weights: FloatArray | None) -> Weighted:
        """Copy the graph to the device, with weights from the host.

        Weights are (n_edges,) on a :class:`Graph`, (K/2, *shape) on a :class:`GridGraph`. None means the graph's own
        weights, or 1 on every edge inside the mask if it has none. The device copy of a read-only array, such as the
        graph's own weights, is cached.
        """

    @abstractmethod
    def get_weights(self, weighted: Weighted) -> FloatArray | None:
        """Copy the weights to the host, in the form that :meth:`prepare` takes."""

    @abstractmethod
    def prepare_gamma(self, graph: AnyGraph, gamma: FloatArray) -> Weighted:
        """Copy the graph to the device with gamma(u, v), a host function on the edges, instead of weights."""

    @abstractmethod
    def put_edges(self, graph: AnyGraph, values: FloatArray) -> Array:
        """Copy a host function on the directed edges to the device.

        It is (n_edges, channels) on a :class:`Graph`, (K, *shape, channels) on a :class:`GridGraph`: one plane per
        offset, 0 where an edge leaves the grid or the mask.
        """

    @abstractmethod
    def get_edges(self, graph: AnyGraph, x: Array) -> FloatArray:
        """Copy a device function on the directed edges to the host, in the form of :meth:`put_edges`."""

    @abstractmethod
    def empty_edges(self, graph: AnyGraph, channels: int) -> Array:
        """Allocate a device function on the directed edges."""

    # Bytes on the device, computed without the device

    @property
    def largest_buffer(self) -> int:
        """Bytes of the largest array that can be allocated."""
        return self.device.memory

    @property
    def free_memory(self) -> int:
        """Bytes that are free on the device now; all bytes where its driver does not tell."""
        return self.device.memory

    @abstractmethod
    def topology_bytes(self, graph: AnyGraph) -> int:
        """Return the bytes of the graph without weights; about 0 for a grid."""

    @abstractmethod
    def function_bytes(self, graph: AnyGraph, channels: int) -> int:
        """Return the bytes of a function on the vertices."""

    @abstractmethod
    def edge_bytes(self, graph: AnyGraph, *, directed: bool = False) -> int:
        """Return the bytes of weights in full precision; with `directed`, of gamma(u, v) on the directed edges."""

    @abstractmethod
    def patch_bytes(self, graph: AnyGraph, channels: int, radius: int) -> tuple[int, ...]:
        """Return the bytes of the temporary arrays of :meth:`patch_distance`, without the weights."""

    def step_bytes(self, graph: GridGraph, channels: int, guide: int | None, radius: int) -> tuple[int, ...]:
        """Return the bytes of the temporary arrays of :meth:`similarity_step`; `guide` is its number of channels."""
        patches = self.patch_bytes(graph, channels if guide is None else guide, radius)
        return (self.edge_bytes(graph), self.function_bytes(graph, channels), *patches)

    def sweep_bytes(self, graph: AnyGraph, channels: int, norms: int) -> int:
        """Return the bytes of the temporary memory of a sweep with `norms` gradient norms per vertex."""
        return 0

    # Launches

    def record(self, work: Work, parameters: Sequence[Parameter]) -> Replay:
        """Do ``work(backend, *parameters)`` once; return a function of the parameters that does it again.

        Unless a backend records its launches, the work itself is done again.
        """
        work(self, *parameters)

        def again(*numbers: float) -> None:
            work(self, *numbers)

        return again

    def _out(self, graph: AnyGraph, channels: int, out: Array | None) -> Array:
        """Return `out`, or a new function if it is None."""
        return self.empty(graph, channels) if out is None else out
