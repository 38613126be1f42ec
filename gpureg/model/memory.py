"""Memory: the bytes that a job needs on its device, computed before it starts, and the bytes that it may use."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

from .. import backends
from ..arrays import computed_type
from ..backends import Backend, Chosen
from ..checks import choice, flag, integer, number
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..graphs.grid import AnyGraph, GridGraph
from ..weights import Constant, Weights, patch_weights
from .problem import NORMS, Norm, as_weights, lam_numbers

# Share of a CPU's memory that a job may use, as it also has the data and packed copies; and of what a GPU has free.
_SHARES = {"cpu": 0.5, "gpu": 0.9}

_UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}


@dataclass(frozen=True)
class Need:
    """Bytes of a job: of all its arrays at their peak, and of the largest one."""

    total: int
    largest: int

    @classmethod
    def of(cls, arrays: Sequence[int]) -> Need:
        """Make the need of arrays of these sizes."""
        return cls(sum(arrays), max(arrays, default=0))


@dataclass(frozen=True)
class Budget:
    """Bytes that a job may use.

    Attributes
    ----------
    total, largest : int
        Bytes of all arrays, and of the largest one.
    asked : bool
        Whether the limit comes from the caller or the environment, and not from the device.
    """

    total: int
    largest: int
    asked: bool

    def holds(self, need: Need) -> bool:
        """Return whether a job fits."""
        return need.total <= self.total and need.largest <= self.largest


@dataclass(frozen=True)
class Job:
    """The properties of a regularization, apart from the graph, that decide its memory.

    Attributes
    ----------
    channels : int
        Channels of the function.
    norms : int
        Channels of the conductances on the vertices; 0 if there are none.
    weights : Weights, array or None
        None: those of the graph.
    directed : bool
        Whether gamma is given per directed edge.
    per_vertex : bool
        Whether lam is given per vertex.
    stored : bool
        Whether weights are stored; if not, the job is one sweep.
    keeps : tuple of int
        Functions on the vertices, and on the directed edges, that the solver needs, without data and two iterates.
    """

    channels: int = 1
    norms: int = 0
    weights: Weights | npt.NDArray[Any] | None = None
    directed: bool = False
    per_vertex: bool = False
    stored: bool = True
    keeps: tuple[int, int] = (0, 0)

    def need(self, graph: AnyGraph, backend: Backend) -> Need:
        """Compute the bytes on a graph from the sizes of the backend's arrays, without using the device."""
        fidelity = [backend.function_bytes(graph, 1)] if self.per_vertex else []
        function = backend.function_bytes(graph, self.channels)
        found = patch_weights(self.weights)
        guide = None if found is None or found[1] is None else found[1].channels(self.channels)
        if not self.stored:
            assert found is not None and isinstance(graph, GridGraph)
            scratch = backend.step_bytes(graph, self.channels, guide, found[0].reach)
            return Need.of([*fidelity, *scratch, function, function])
        arrays = [*fidelity, backend.topology_bytes(graph)]
        # the data, the last two iterates, and the conductances
        arrays += [function] * 3 + ([backend.function_bytes(graph, self.norms)] if self.norms else [])
        functions, edges = self.keeps
        arrays += [function] * functions + [backend.edge_bytes(graph, directed=True) * self.channels] * edges
        storage = "full"
        if found is not None and found[0].storage in backend.storages and isinstance(graph, GridGraph):
            storage = found[0].storage
        if storage == "none" and isinstance(graph, GridGraph):
            # the data that weights are computed from, with the mask
            arrays.append(backend.function_bytes(graph, (guide or self.channels) + (graph.mask is not None)))
        elif self.directed or not _is_unit(graph, self.weights):
            stored = backend.edge_bytes(graph, directed=self.directed)
            arrays.append(stored // (backend.dtype.itemsize // 2) if storage == "half" else stored)
        if found is not None and storage != "none":
            arrays += backend.patch_bytes(graph, guide or self.channels, found[0].reach)
        arrays.append(backend.sweep_bytes(graph, self.channels, self.norms))
        return Need.of(arrays)


def _is_unit(graph: AnyGraph, weights: Any) -> bool:
    """Return whether every edge has weight 1, which is not stored."""
    own = graph.mask if isinstance(graph, GridGraph) else graph.weights
    return own is None and (weights is None or isinstance(weights, Constant))


@door
def memory_needed(
    graph: GraphLike,
    *,
    channels: int = 1,
    p: float = 2.0,
    lam: float | npt.ArrayLike = 1.0,
    weights: Weights | npt.ArrayLike | None = None,
    norm: Norm = "vertex",
    coupled: bool = True,
    stored: bool = True,
    backend: Chosen = "auto",
    dtype: npt.DTypeLike | None = None,
) -> int:
    """Compute the bytes that a job needs on its device, without using the device.

    Parameters
    ----------
    graph : Graph or GridGraph
    channels : int, default 1
        Channels of the data.
    p, lam, weights, norm, coupled
        As in :func:`gpureg.regularize`; of `lam` it only matters whether it is a number or one value per vertex.
    stored : bool, default True
        Whether the weights are stored. False is one sweep at p = 2 with bilateral or patch weights, as in
        :func:`gpureg.denoise_image` by default.
    backend, dtype
        As in :func:`gpureg.regularize`.

    Returns
    -------
    int
        The peak, including temporary arrays, without the memory of the host.

    Raises
    ------
    TypeError, ValueError
        Not a graph; no channels; stored=False with weights that must be stored.

    Examples
    --------
    >>> import gpureg as gr
    >>> grid, weights = gr.GridGraph((512, 512), 7), gr.weights.patch(2, 0.5)
    >>> gr.memory_needed(grid, weights=weights, backend="numpy") // 2**20
    137
    """
    graph = as_graph(graph)
    channels = integer("channels", channels, low=1)
    p, norm = number("p", p, above=0), choice("norm", norm, NORMS)
    coupled, stored = flag("coupled", coupled), flag("stored", stored)
    if not stored and (patch_weights(weights) is None or not isinstance(graph, GridGraph)):
        raise ValueError("stored=False needs bilateral or patch weights on a GridGraph: others have to be stored")
    job = Job(
        channels=channels,
        norms=0 if p == 2 or norm == "edge" else 1 if coupled else channels,
        weights=as_weights(graph, weights),
        per_vertex=lam_numbers(lam).ndim > 0,
        stored=stored,
    )
    return job.need(graph, backends.get(backend, computed_type(dtype))).total


def budget_of(devices: Sequence[Backend], memory: int | None) -> Budget:
    """Return what a part of a job may use, on whichever of the devices it is; as :func:`budget` for each.

    A device that is there several times has that many parts at a time.
    """
    found = []
    for device in dict.fromkeys(devices):
        one, times = budget(device, memory), devices.count(device)
        found.append(Budget(one.total // times, min(one.largest, one.total // times), one.asked))
    return Budget(min(one.total for one in found), min(one.largest for one in found), any(one.asked for one in found))


def budget(backend: Backend, memory: int | None) -> Budget:
    """Return what a job may use: the least of a share of the device's memory, `memory`, and GPUREG_MEMORY.

    The share is that of the whole memory of a CPU, and of the memory of a GPU that is free now.

    Raises
    ------
    TypeError, ValueError
        `memory` or GPUREG_MEMORY is not a number of bytes.
    """
    device = backend.device
    present = backend.free_memory if device.kind == "gpu" else device.memory
    limits = [int(present * _SHARES[device.kind])] if present else []
    asked = _asked(memory)
    smallest = min([*limits, *asked], default=2**62)
    return Budget(smallest, min(smallest, backend.largest_buffer or smallest), bool(asked) and smallest in asked)


def _asked(memory: int | None) -> list[int]:
    """Return the limits of the caller and of GPUREG_MEMORY."""
    asked = [] if memory is None else [integer("memory", memory, low=1)]
    named = os.environ.get("GPUREG_MEMORY", "").strip()
    if named:
        try:
            asked.append(as_bytes(named))
        except ValueError as error:
            raise ValueError(f"GPUREG_MEMORY: {error}") from None
    return asked


@dataclass(frozen=True)
class ProcessLimit:
    """Bytes that the arrays of a job may use in the process.

    Attributes
    ----------
    bytes : int
    asked : bool
        Whether the limit comes from the caller or the environment, and not from the machine.
    """

    bytes: int
    asked: bool


def process_limit(memory: int | None) -> ProcessLimit:
    """Return what a job may use in the process: `memory` or GPUREG_MEMORY, otherwise half of the machine's memory.

    Raises
    ------
    TypeError, ValueError
        `memory` or GPUREG_MEMORY is not a number of bytes.
    """
    asked = _asked(memory)
    if asked:
        return ProcessLimit(min(asked), True)
    return ProcessLimit(int((backends.get("numpy").device.memory or 2**40) * _SHARES["cpu"]), False)


def as_bytes(text: str) -> int:
    """Convert a text such as "8GiB", "512M" or "1000000" to a number of bytes; raise ValueError for other text.

    Examples
    --------
    >>> as_bytes("1.5 GiB")
    1610612736
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([KMGT]?)(?:i?B)?\s*", text, re.IGNORECASE)
    size = int(float(match[1]) * _UNITS[match[2].upper()]) if match else 0
    if size < 1:
        raise ValueError(f"memory must be a number of bytes >= 1, such as 4GiB or 500M (of 2^20), got {text!r}")
    return size


def readable(count: int) -> str:
    """Format a number of bytes for a message."""
    for unit, size in (("GiB", 2**30), ("MiB", 2**20), ("KiB", 2**10)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count} bytes"
