"""Stored graphs on a GPU: rows in slices, or shared by teams of work items, see ``csr_gpu.cl``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from ...arrays import FloatArray, IntArray
from ...graphs.csr import Graph
from .geometry import CsrGeometry, SlicedGeometry
from .layout import Buffer, Collected, CsrLayout, Launch, Upload

# Rows of a slice; the most room of the slices per edge, and the mean degree from which there are none: otherwise a row
# is a work item's or a team's.
SLICE, _ROOM, _DENSE = 32, 1.6, 32

# Mean degrees from which a team has so many work items; below it is one. Counted, not measured, for a Jacobi step on a
# scale-free graph of mean degree 8 on sm_90: 28, 70, 122 and 459 instructions per edge for 1, 4, 8 and 32 work items,
# and 2 lines of the cache per edge for 1, 1.2 for 4 and 8.
_TEAMS = ((64.0, 32), (16.0, 8), (6.0, 4))

# The longest whole row is so many edges for each work item of a team, and at least _LEAST_PIECE; so is a piece.
_TRIPS, _LEAST_PIECE = 16, 64

# Work items of a team that adds the pieces of a row.
_HUB_TEAM = 32


def slice_starts(indptr: IntArray) -> IntArray:
    """Return where each slice of rows begins, and the size of all, (slices + 1,)."""
    n = len(indptr) - 1
    longest = np.maximum.reduceat(np.diff(indptr), np.arange(0, n, SLICE)) if n else np.zeros(0, np.int64)
    starts: IntArray = np.concatenate([[0], np.cumsum(SLICE * longest)]).astype(np.int64)
    return starts


def in_slices(indptr: IntArray, starts: IntArray) -> IntArray:
    """Return the index of each edge in the slices, (n_edges,)."""
    rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    place: IntArray = starts[rows // SLICE] + rows % SLICE + SLICE * (np.arange(len(rows)) - indptr[rows])
    return place


def team_size(n: int, n_edges: int) -> int:
    """Return the work items of a team, by the mean degree."""
    return next((team for degree, team in _TEAMS if n_edges >= degree * n), 1)


def csr_geometry(graph: Graph, gpu: bool) -> CsrGeometry:
    """Choose the form of a stored graph; rows of similar lengths, and not dense ones, are in slices on a GPU."""
    n, n_edges = graph.n_vertices, graph.n_edges
    if gpu and 0 < n_edges < _DENSE * n:
        size = int(slice_starts(graph.indptr)[-1])
        if size <= _ROOM * n_edges:
            return SlicedGeometry(n, size)
    return CsrGeometry(n, n_edges)


def csr_layout(upload: Upload, graph: Graph, geometry: CsrGeometry, group: int, gpu: bool) -> CsrLayout:
    """Make the layout of a stored graph in the form of its geometry."""
    if isinstance(geometry, SlicedGeometry):
        return SlicedLayout(upload, graph, geometry, group)
    team = team_size(graph.n_vertices, graph.n_edges)
    piece = max(_LEAST_PIECE, _TRIPS * team)
    longest = int(np.diff(graph.indptr).max(initial=0))
    # groups of a device that cannot have a whole team are for single work items
    if not gpu or group < _HUB_TEAM or (team == 1 and longest <= piece):
        return CsrLayout(upload, graph, geometry, group)
    return TeamLayout(upload, graph, geometry, group, team, piece)


class SlicedLayout(CsrLayout):
    """A stored graph in slices of rows."""

    def __init__(self, upload: Upload, graph: Graph, geometry: CsrGeometry, group: int) -> None:
        self._starts = slice_starts(graph.indptr)
        super().__init__(upload, graph, geometry, group)
        self.options = ("-DSLICED", *self.options)

    def _put_edges_of(self, graph: Graph) -> tuple[Buffer, Buffer]:
        self._degrees = self._upload(np.diff(graph.indptr).astype(np.int32))
        return self._upload(self._starts), self._upload(self._spread(graph.indices))

    def _spread(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Put one value per edge, (n_edges, ...), to its place, and 0 to the places without an edge."""
        spread = np.zeros((self._starts[-1], *values.shape[1:]), values.dtype)
        spread[in_slices(self._topology[0], self._starts)] = values
        return spread

    def args(self, weights: Buffer, mirrored: bool) -> list[Any]:
        n, slices, *edges = super().args(weights, mirrored)
        return [n, slices, self._degrees, *edges]

    def _of_edges(self, flat: FloatArray) -> FloatArray:
        values: FloatArray = flat[in_slices(self._topology[0], self._starts)]
        return values

    def pack_weights(self, weights: FloatArray) -> FloatArray:
        return self._spread(weights)

    def unpack_weights(self, flat: FloatArray) -> FloatArray:
        return self._of_edges(flat)

    def pack_edges(self, values: FloatArray) -> FloatArray:
        return self._spread(values)

    def unpack_edges(self, flat: FloatArray, channels: int) -> FloatArray:
        return self._of_edges(flat.reshape(-1, channels))

    def _opposite(self) -> IntArray:
        place = in_slices(self._topology[0], self._starts)
        return self._spread(place[super()._opposite()])


class TeamLayout(CsrLayout):
    """A stored graph whose rows are shared by teams of work items; long rows are cut into pieces.

    Primitives that do not collect sums over the edges have the launches of a :class:`CsrLayout`.
    """

    def __init__(self, upload: Upload, graph: Graph, geometry: CsrGeometry, group: int, team: int, piece: int) -> None:
        super().__init__(upload, graph, geometry, group)
        self._team, self._n, self._n_pieces = team, geometry.n, 0
        self._starts = self._rows = self._pieces = self._nothing = self.indptr
        self._sums: Buffer = None
        degree = np.diff(graph.indptr)
        hubs = np.flatnonzero(degree > piece)
        if len(hubs):
            self._cut(graph, hubs, piece)

    def _cut(self, graph: Graph, hubs: IntArray, piece: int) -> None:
        """Cut the rows of hubs into pieces of at most `piece` edges."""
        n, index = graph.n_vertices, graph.indices.dtype
        count = np.ones(n, np.int64)
        count[hubs] = -(-np.diff(graph.indptr)[hubs] // piece)
        rows = np.repeat(np.arange(n), count)
        within = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
        starts = np.append(graph.indptr[rows] + piece * within, graph.n_edges)
        cut = count[rows] > 1
        pieces = np.where(cut, np.cumsum(cut) - 1, -1)
        self._n, self._n_pieces = len(rows), int(cut.sum())
        self._starts = self._upload(starts)
        self._rows, self._pieces = (self._upload(x.astype(index)) for x in (rows, pieces))
        # of each hub, and of each piece: its vertex, its edges, and the pieces of the whole row
        ends = np.cumsum(count[hubs])
        of_row, of_piece = np.stack([ends - count[hubs], ends], axis=1), np.repeat(np.arange(len(hubs)), count[hubs])
        whole = np.stack([graph.indptr[hubs], graph.indptr[hubs + 1]], axis=1)
        part = np.stack([starts[:-1], starts[1:]], axis=1)[cut]
        self._of_hubs, self._of_pieces = (
            (len(vertices), self._upload(edges), [self._upload(x.astype(index)) for x in (vertices, added)])
            for vertices, edges, added in ((hubs, whole, of_row), (rows[cut], part, of_row[of_piece]))
        )

    def launches(
        self, weights: Buffer, mirrored: bool, collected: Collected | None, allocate: Callable[[int], Buffer]
    ) -> Iterator[Launch]:
        if collected is None:
            yield from super().launches(weights, mirrored, collected, allocate)
            return
        nbytes = collected.sums * self._n_pieces * collected.itemsize
        if nbytes and (self._sums is None or self._sums.size < nbytes):
            self._sums = allocate(nbytes)
        there = self._sums or self._nothing
        _, _, *edges = self.args(weights, mirrored)
        group = f"-DGROUP={self.group}"
        options = (*self.options, group, f"-DTEAM={self._team}", *(("-DSPLIT",) if self._n_pieces else ()))
        pieces = [self._rows, self._pieces, np.int64(self._n_pieces), there]
        yield Launch(options, [np.int64(self._n), self._starts, *edges, *pieces], (self._n * self._team,))
        if nbytes:
            options = (*self.options, group, f"-DTEAM={_HUB_TEAM}", "-DHUBS")
            count, starts, rows = self._of_pieces if collected.for_edges else self._of_hubs
            pieces = [*rows, np.int64(self._n_pieces), there]
            yield Launch(options, [np.int64(count), starts, *edges, *pieces], (count * _HUB_TEAM,))
