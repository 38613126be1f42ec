"""The types that a backend and its callers share: devices, weights on a device, conductances."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from ..arrays import FloatArray
from ..graphs.grid import AnyGraph, GridGraph
from .patches import (
    PatchForm,
)

Array = Any
"""A function on a device, in the form of the backend that made it."""


class BackendUnavailable(RuntimeError):
    """A backend is not installed, or its device does not support what the job needs."""


@dataclass(frozen=True)
class Device:
    """One device of one backend, as listed by ``gpureg backends``.

    Attributes
    ----------
    backend : str
        "numpy", "opencl" or "warp".
    id : str
        The name that selects it, e.g. "opencl:1" or "warp:cuda:0".
    name, driver : str
        Name of the device; the driver and its version.
    kind : {"cpu", "gpu"}
    memory : int
        Bytes.
    vector_width : int
        float32 values that a kernel computes at a time.
    float64 : bool
        Whether the device computes in float64.
    rank : tuple
        "auto" takes the smallest: the tier of the dispatcher, then numbers of the backend.
    handle : object
        The device object of the backend's library.
    watched : bool, default False
        Whether the system may end a launch that takes seconds, as on a GPU that draws the screen.
    """

    backend: str
    id: str
    name: str
    driver: str
    kind: str
    memory: int
    vector_width: int
    float64: bool
    rank: tuple[float, ...]
    handle: Any = field(default=None, repr=False, compare=False)
    watched: bool = False


@dataclass(frozen=True)
class LeftOut:
    """A device that cannot be used, as listed by ``gpureg backends``.

    Attributes
    ----------
    id, name : str
        As those of a :class:`Device`.
    reason : str
        A clause.
    """

    id: str
    name: str
    reason: str

    def __str__(self) -> str:
        return f"{self.id} ({self.name}): {self.reason}"


@dataclass(frozen=True)
class Smoothness:
    """The parameters of the smoothness term of the energy: the degree p, eps, and the norm.

    With `edge` it also serves as the conductances (eq. 30), which each kernel computes from the function at both ends:

        |d_w(f)(u, v)|_eps^(p - 2)

    Attributes
    ----------
    p : float
        Degree of regularity > 0.
    eps : float
        Smoothing of the gradient norm (eq. 15), >= 0.
    coupled : bool
        One gradient norm for all channels instead of one per channel.
    edge : bool
        The smoothness of eq. 30 (a norm per edge) instead of eq. 20.
    """

    p: float
    eps: float
    coupled: bool = True
    edge: bool = False

    @property
    def power(self) -> float:
        """Exponent of the squared norm in the conductance."""
        return (self.p - 2) / 2

    def norms(self, channels: int) -> int:
        """Return the number of gradient norms per vertex."""
        return 1 if self.coupled else channels

    @property
    def has_function(self) -> bool:
        """Whether the conductances are a stored function on the vertices."""
        return self.p != 2 and not self.edge


Storage = Literal["full", "half", "none"]
Conductance = Array | Smoothness | None
"""g = |grad f|^(p - 2) on the vertices, a smoothness with the edge norm, or None for p = 2."""


@dataclass(frozen=True, eq=False)
class Weighted:
    """A graph with its weights on a device.

    Attributes
    ----------
    graph : Graph or GridGraph
    topology : object
        The graph on the device.
    weights : object or None
        The weights, in the backend's layout; None means 1 on every edge.
    directed : bool
        Whether `weights` are gamma(u, v), one value per directed edge, instead of w.
    storage : {"full", "half", "none"}
        How w is stored, see :meth:`Backend.patch_distance`.
    """

    graph: AnyGraph
    topology: Any
    weights: Any
    directed: bool = False
    storage: Storage = "full"


@dataclass(frozen=True, eq=False)
class Box:
    """Bounds per vertex and channel that hold a minimiser; a certificate needs them where lam is 0.

    Attributes
    ----------
    low, high : device functions, (n, m)
        They may be infinite.
    """

    low: Array
    high: Array


def expect_stored(weighted: Weighted) -> GridGraph:
    """Return the grid, or raise BackendUnavailable unless its weights are stored once per pair."""
    if not isinstance(weighted.graph, GridGraph) or weighted.directed or weighted.storage == "none":
        raise BackendUnavailable("averaged patches need weights stored on a GridGraph")
    return weighted.graph


class DeviceCopies:
    """A cache of device copies of read-only host arrays, such as a graph's own weights.

    An entry lives as long as its host array.
    """

    def __init__(self) -> None:
        self._copies: dict[int, tuple[weakref.ref[FloatArray], Any]] = {}

    def copy(self, array: FloatArray, make: Callable[[FloatArray], Any]) -> Any:
        """Return the cached copy of this array, or make it."""
        if array.flags.writeable or array.base is not None:  # the base of a view may be writeable
            return make(array)
        found = self._copies.get(id(array))
        if found is not None and found[0]() is array:
            return found[1]
        made = make(array)
        self._copies = {key: entry for key, entry in self._copies.items() if entry[0]() is not None}
        self._copies[id(array)] = (weakref.ref(array), made)
        return made


def expect_storage(graph: AnyGraph, form: PatchForm, storage: Storage) -> None:
    """Raise BackendUnavailable unless weights of this form can have this storage on this graph."""
    if storage == "full":
        return
    if not isinstance(graph, GridGraph) or form.scale is None:
        raise BackendUnavailable("weights in float16 or recomputed weights need a GridGraph and a similarity")
    if storage == "none" and (form.maps is not None or form.cut):
        raise BackendUnavailable("weights with a cut-off or with maps of parameters cannot be recomputed: store them")
    if storage == "none" and form.radius:
        raise BackendUnavailable("only weights between single cells (bilateral) can be recomputed, not patches")


def host_weights(graph: AnyGraph, weights: FloatArray | None) -> FloatArray | None:
    """Return the weights, or the graph's own if None; None if every edge has weight 1."""
    if weights is not None:
        return weights
    if isinstance(graph, GridGraph):
        return None if graph.mask is None else graph.edges.unit_half()
    return graph.weights
