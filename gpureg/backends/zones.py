"""The protocol of partitions: which source every vertex is nearest to, in exact integers.

Distances are sums of integer lengths, so that no device rounds and all give the same zones, bit for bit.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

from ..arrays import IntArray
from ..graphs.grid import AnyGraph, GridGraph

Lengths = npt.NDArray[np.int32]
"""Lengths of edges, -1 where there is none to go along: (n_edges,) on a Graph, one per directed edge; (n, K/2) on a
GridGraph, once per pair, at the end that comes first, and -1 where the edge leaves the grid or the mask."""

LONGEST = 1 << 30
"""No length is above this: a path of 2^31 edges stays far inside 64 bits."""

Distances = npt.NDArray[np.int64]
Labels = npt.NDArray[np.int32]

FAR = 1 << 62
"""Distance and tag of a vertex that no path has reached yet."""

HOP = 1 << 32
"""What an edge adds to a tag, whose lower half is the label of a source."""

# Rounds of a GPU from one look at what has changed to the next: a look costs as much as several rounds.
ROUNDS = 8

# Blocks per core of a CPU, and the least vertices of one.
_BLOCKS, _LEAST_BLOCK = 4, 1 << 12


class Zones(ABC):
    """The primitives of a partition."""

    @abstractmethod
    def influence_zones(self, graph: AnyGraph, lengths: Lengths, sources: Labels) -> tuple[Distances, Labels]:
        """The distance of each vertex from the nearest source, and the label of that.

        `sources` is a label >= 0 at the vertices of the sources, -1 elsewhere. Among paths of the same length those of
        the fewest edges count, among these those from the smallest label. Where no path leads: -1 for both.
        """

    @abstractmethod
    def flat_zones(self, graph: AnyGraph, lengths: Lengths) -> Labels:
        """The smallest vertex that edges of length 0 connect to each vertex; other edges count as none."""


def blocks(graph: AnyGraph, cores: int | None) -> tuple[int, int]:
    """Vertices of a block and of a line in it; one core or more of a CPU, or None for a GPU."""
    n = graph.n_vertices
    if cores is None:
        return 1, 1
    block = max(-(-n // (_BLOCKS * cores)), min(_LEAST_BLOCK, n))
    line = graph.shape[-1] if isinstance(graph, GridGraph) else block
    block = -(-block // line) * line
    return block, line


class Rounds(Zones):
    """Zones by rounds of the kernel ``influence_zones``, until one changes nothing."""

    @abstractmethod
    def _settled(
        self, graph: AnyGraph, lengths: Lengths, mu: Distances, tag: Distances, hop: int
    ) -> tuple[Distances, Distances]:
        """Distances and tags that no round changes any more, from these."""

    def influence_zones(self, graph: AnyGraph, lengths: Lengths, sources: Labels) -> tuple[Distances, Labels]:
        """As :class:`Zones` says."""
        source = sources >= 0
        start = np.where(source, 0, FAR), np.where(source, sources, FAR)
        mu, tag = self._settled(graph, lengths, *start, HOP)
        reached = mu < FAR
        return np.where(reached, mu, -1), np.where(reached, _label(tag), np.int32(-1))

    def flat_zones(self, graph: AnyGraph, lengths: Lengths) -> Labels:
        """As :class:`Zones` says."""
        n = graph.n_vertices
        flat: Lengths = np.where(lengths == 0, lengths, np.int32(-1))
        # every vertex a source, and no edge counts: the smallest label wins
        return _label(self._settled(graph, flat, np.zeros(n, np.int64), np.arange(n), 0)[1])


def _label(tag: Distances) -> Labels:
    labels: Labels = (tag & (HOP - 1)).astype(np.int32)
    return labels


def guarded(graph: GridGraph, lengths: Lengths) -> tuple[int, IntArray, Lengths]:
    """The largest step to a forward neighbour, all of them (K/2,), and the lengths with so many rows of -1 before."""
    jumps = graph.steps
    guard = int(jumps.max(initial=0))
    padded = np.empty((guard + len(lengths), lengths.shape[1]), np.int32)
    padded[:guard] = -1
    padded[guard:] = lengths
    return guard, jumps, padded
