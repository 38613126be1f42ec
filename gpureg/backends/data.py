"""The protocol of what is on a device: graphs, weights, functions on vertices and edges, and how large they are.

Functions are device arrays that only the backend reads; ``put`` and ``get`` carry them to the device and back as host
arrays of shape (n, channels). How a device lays out functions and weights is its own affair.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..graphs.grid import AnyGraph, GridGraph
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

    # The forms in which the device holds weights: what saves memory here, whatever else is accepted.
    storages: ClassVar[tuple[Storage, ...]] = ("full",)

    # Whether `similarity_step` knows averaged weights, on grids of two axes.
    averages: ClassVar[bool] = False

    # A part of a grid whose first row and column are multiples of these gets the bits of the whole from
    # `similarity_step`; all else treats a vertex alike wherever it lies.
    row_block: int = 1
    column_block: int = 1

    def __init__(self, device: Device, dtype: npt.DTypeLike) -> None:
        self.device = device
        self.dtype = np.dtype(dtype)
        self.real: Any = self.dtype.type  # makes a scalar of this type

    def __repr__(self) -> str:
        return f"{self.device.id} ({self.device.name}, {self.device.driver}), {self.dtype}"

    @abstractmethod
    def channels(self, x: Array) -> int:
        """The number of channels of a device function, on the vertices or on the edges."""

    @abstractmethod
    def put(self, graph: AnyGraph, f: npt.NDArray[Any]) -> Array:
        """Put a host function (n, channels) onto the device, rounded to the backend's dtype."""

    @abstractmethod
    def get(self, graph: AnyGraph, x: Array) -> FloatArray:
        """Get a device function as a host array (n, channels)."""

    @abstractmethod
    def empty(self, graph: AnyGraph, channels: int) -> Array:
        """Make a device function to be written."""

    @abstractmethod
    def prepare(self, graph: AnyGraph, weights: FloatArray | None) -> Weighted:
        """Put the graph onto the device, with weights from the host.

        Weights are (n_edges,) on a :class:`Graph`, (K/2, *shape) on a :class:`GridGraph`; None means the graph's own,
        and 1 on every edge inside its mask where it has none. A device caches its copy of a read-only array, such as
        the graph's own weights.
        """

    @abstractmethod
    def get_weights(self, weighted: Weighted) -> FloatArray | None:
        """Get the weights as :meth:`prepare` takes them."""

    @abstractmethod
    def prepare_gamma(self, graph: AnyGraph, gamma: FloatArray) -> Weighted:
        """Put the graph onto the device with gamma(u, v), a host function on the edges, instead of weights."""

    @abstractmethod
    def put_edges(self, graph: AnyGraph, values: FloatArray) -> Array:
        """Put a host function on the directed edges onto the device.

        It is (n_edges, channels) on a :class:`Graph`, (K, *shape, channels) on a :class:`GridGraph`, one plane per
        offset with 0 where an edge leaves the grid or the mask.
        """

    @abstractmethod
    def get_edges(self, graph: AnyGraph, x: Array) -> FloatArray:
        """Get a device function on the directed edges, in the form of :meth:`put_edges`."""

    @abstractmethod
    def empty_edges(self, graph: AnyGraph, channels: int) -> Array:
        """Make a device function on the directed edges to be written."""

    # Sizes: bytes that what is above takes on the device, told before it is there and without the device

    @property
    def largest_buffer(self) -> int:
        """Bytes of the largest array the device holds."""
        return self.device.memory

    @abstractmethod
    def topology_bytes(self, graph: AnyGraph) -> int:
        """What the device keeps of the graph; nothing to speak of on a grid."""

    @abstractmethod
    def function_bytes(self, graph: AnyGraph, channels: int) -> int:
        """A function on the vertices."""

    @abstractmethod
    def edge_bytes(self, graph: AnyGraph, *, directed: bool = False) -> int:
        """Weights in full; with `directed` gamma(u, v), one value per directed edge."""

    @abstractmethod
    def patch_bytes(self, graph: AnyGraph, channels: int, radius: int) -> tuple[int, ...]:
        """The arrays that :meth:`patch_distance` needs for a while, besides the weights."""

    def step_bytes(self, graph: GridGraph, channels: int, guide: int | None, radius: int) -> tuple[int, ...]:
        """The arrays that :meth:`similarity_step` needs for a while; `guide` is the number of its channels."""
        patches = self.patch_bytes(graph, channels if guide is None else guide, radius)
        return (self.edge_bytes(graph), self.function_bytes(graph, channels), *patches)

    def sweep_bytes(self, graph: AnyGraph, channels: int, norms: int) -> int:
        """What a sweep needs for a while, besides the arrays that it is given; `norms` gradient norms are stored."""
        return 0

    def _out(self, graph: AnyGraph, channels: int, out: Array | None) -> Array:
        """The function to write: the caller's, or a new one."""
        return self.empty(graph, channels) if out is None else out
