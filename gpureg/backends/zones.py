"""The protocol of partitions: find the nearest source of each vertex.

Distances are sums of integer lengths: exact, so that all devices give the same zones, bit for bit.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

from ..arrays import IntArray
from ..graphs.grid import AnyGraph, GridGraph

Lengths = npt.NDArray[np.int32]
"""Lengths of edges, -1 for no edge: (n_edges,) on a Graph, one per directed edge; (n, K/2) on a GridGraph, one per
pair, at the end that comes first, -1 where the edge leaves the grid or the mask."""

LONGEST = 1 << 30
"""The largest length: the sum of 2^31 of them fits in 64 bits."""

Distances = npt.NDArray[np.int64]
Labels = npt.NDArray[np.int32]

FAR = 1 << 62
"""Distance and tag of a vertex that no path has reached."""

HOP = 1 << 32
"""What an edge adds to a tag; the lower 32 bits of a tag are the label of a source."""

# Rounds on a GPU between two checks for changes: a check costs as much as several rounds. Vertices of a tile of a GPU.
ROUNDS, TILE = 8, 256

# Blocks per core of a CPU, and the smallest number of vertices in a block.
_BLOCKS, _LEAST_BLOCK = 4, 1 << 12


class Zones(ABC):
    """The primitives of a partition."""

    @abstractmethod
    def influence_zones(self, graph: AnyGraph, lengths: Lengths, sources: Labels) -> tuple[Distances, Labels]:
        """Compute the distance of each vertex from the nearest source, (n,), and the label of that source, (n,).

        `sources`, (n,), is a label >= 0 at the sources, -1 elsewhere. Among paths of the same length, that with the
        fewest edges counts, then that with the smallest label. Both results are -1 where no path leads.
        """

    @abstractmethod
    def flat_zones(self, graph: AnyGraph, lengths: Lengths) -> Labels:
        """Find the smallest vertex that edges of length 0 connect to each vertex, (n,)."""


def blocks(graph: AnyGraph, cores: int) -> tuple[int, int]:
    """Return the vertices of a block of a CPU, and of a line in it."""
    n = graph.n_vertices
    block = max(-(-n // (_BLOCKS * cores)), min(_LEAST_BLOCK, n))
    line = graph.shape[-1] if isinstance(graph, GridGraph) else block
    block = -(-block // line) * line
    return block, line


class Rounds(Zones):
    """Zones by rounds of the kernel ``influence_zones``, until a round changes nothing."""

    @abstractmethod
    def _settled(
        self, graph: AnyGraph, lengths: Lengths, mu: Distances, tag: Distances, hop: int
    ) -> tuple[Distances, Distances]:
        """Repeat rounds from these distances and tags, (n,), until they do not change."""

    def influence_zones(self, graph: AnyGraph, lengths: Lengths, sources: Labels) -> tuple[Distances, Labels]:
        """Compute the zones in rounds, see :class:`Zones`."""
        source = sources >= 0
        start = np.where(source, 0, FAR), np.where(source, sources, FAR)
        mu, tag = self._settled(graph, lengths, *start, HOP)
        reached = mu < FAR
        return np.where(reached, mu, -1), np.where(reached, _label(tag), np.int32(-1))

    def flat_zones(self, graph: AnyGraph, lengths: Lengths) -> Labels:
        """Compute the flat zones in rounds, see :class:`Zones`."""
        n = graph.n_vertices
        flat: Lengths = np.where(lengths == 0, lengths, np.int32(-1))
        # every vertex is a source, and an edge adds 0 to a tag: the smallest label wins
        return _label(self._settled(graph, flat, np.zeros(n, np.int64), np.arange(n), 0)[1])


def _label(tag: Distances) -> Labels:
    labels: Labels = (tag & (HOP - 1)).astype(np.int32)
    return labels


def guarded(graph: GridGraph, lengths: Lengths) -> tuple[int, IntArray, Lengths]:
    """Return the largest step to a forward neighbour, all steps (K/2,), and the lengths after that many rows of -1."""
    jumps = graph.steps
    guard = int(jumps.max(initial=0))
    padded = np.empty((guard + len(lengths), lengths.shape[1]), np.int32)
    padded[:guard] = -1
    padded[guard:] = lengths
    return guard, jumps, padded
