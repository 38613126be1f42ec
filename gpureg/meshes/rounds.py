"""Denoise a mesh by rounds of guided normals, while they remove white noise: :func:`denoised_in_rounds`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.components import Components
from ..graphs.csr import Graph
from ..graphs.grid import AnyGraph
from ..graphs.of_shapes import face_graph
from ..model.result import Result
from ..noise.local import spread
from ..regularization.options import Run
from ..regularization.regularize import regularize
from ..shapes.surface import border_vertices, face_vectors, incidence, vertex_normals
from ..solvers import Jacobi
from ..weights.base import EdgeWeights
from .normals import fitted_vertices, units
from .whiteness import Whiteness

# Rounds at most; sweeps of the normals in each, with the one and the other guide; steps that fit the vertices to them.
ROUNDS, _SWEEPS, _FIT = 20, (2, 1), 10

# Scale of the weights between normals, a distance of unit vectors: sqrt(_BASE^2 + min(_MOST, _TIMES * median)^2), with
# the median difference of the guide across edges. _BASE from 0.12 to 0.2 and _TIMES from 0.5 to 1.5 differ little.
_BASE, _TIMES, _MOST = 0.15, 1.5, 0.4

# Where the first round already removes shape: the share of the noise that the vertices may move, and the largest
# displacement of a vertex over its shortest edge.
_CAREFUL, _CAP = 0.85, 0.1

# The largest accepted root mean square displacement, in units of the noise, if the noise is given.
BELIEVABLE = 1.6

# Averages over neighbours for the usual displacement around a vertex.
_AROUND = 10

# Averages over neighbours after which the removed heights are shape, which is put back.
_LOW = 60


@dataclass(frozen=True, eq=False)
class _GuidedWeights(EdgeWeights):
    """Weights a(u) a(v) exp(-|g(u) - g(v)|^2) between faces with the sizes `a`, (F,), and the guide `g`, (F, 3)."""

    sizes: FloatArray
    guide: FloatArray

    def between(self, graph: AnyGraph, f0: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
        """Compute the weights (k,) of the edges from faces `u` to faces `v`."""
        total, difference = np.zeros((2, len(u)))
        for x in np.ascontiguousarray(self.guide.T):
            np.subtract(x[u], x[v], out=difference)
            difference *= difference
            total += difference
        np.negative(total, out=total)
        np.exp(total, out=total)
        total *= self.sizes[u] * self.sizes[v]
        return total


@dataclass(frozen=True, eq=False)
class Rounds:
    """The result of the rounds.

    Attributes
    ----------
    vertices : (n, 3) float array
    results : list of Result
        The runs of the model, two a round.
    rounds : (c,) int array
        Number of rounds that were accepted, for each component of the graph; 0 where the first one was not.
    """

    vertices: FloatArray
    results: list[Result]
    rounds: IntArray


@dataclass(eq=False)
class _Mesh:
    """A mesh whose vertices are to move, and what the rounds need of it."""

    v0: FloatArray
    faces: IntArray
    graph: Graph
    parts: Components

    @cached_property
    def gather(self) -> Any:
        """The incidence of vertices and faces, (n, F)."""
        return incidence(self.faces, len(self.v0))

    @cached_property
    def of_face(self) -> IntArray:
        """The component of each face, (F,)."""
        return self.parts.labels[self.faces[:, 0]]

    @cached_property
    def face_graph(self) -> Graph:
        """The graph of the faces that share a vertex."""
        return face_graph(self.v0, self.faces, across="vertex")

    @cached_property
    def sampled(self) -> tuple[IntArray, IntArray, IntArray]:
        """Edges between faces on which the guide is measured: their faces u and v, and their component, (k,) each."""
        graph = self.face_graph
        u, v = graph.edge_rows(), graph.indices
        once = u < v
        u, v = u[once], v[once]
        labels = self.of_face[u]
        some = self.parts.thinned(labels)
        return u[some], v[some], labels[some]

    def round(
        self, v: FloatArray, moves: npt.NDArray[np.bool_], options: Run
    ) -> tuple[FloatArray, tuple[Result, Result]]:
        """Regularize the normals of the faces at the positions `v`, (n, 3), and fit the vertices that move to them."""
        vectors = face_vectors(v, self.faces)
        areas = np.linalg.norm(vectors, axis=1)
        normals = units(vectors, vectors)
        mean = self.parts.means(areas, self.of_face)[self.of_face]
        sizes = np.cbrt(np.divide(areas, mean, out=np.zeros_like(areas), where=mean > 0))
        # the mean over the faces around, each as often as it shares a vertex: three times itself, twice across an edge
        around = units(self.gather.T @ (self.gather @ (sizes[:, None] * normals)), normals)
        first = self._regularized(normals, sizes, around, _SWEEPS[0], options)
        # then the result is the guide: around a corner, where means mix all sides, it is more exact
        middle = units(first.value.astype(np.float64), normals)
        second = self._regularized(middle, sizes, middle, _SWEEPS[1], options)
        target = units(second.value.astype(np.float64), middle)
        sides = [((v[self.faces[:, k]] - v[self.faces[:, k - 1]]) ** 2).sum(axis=1) for k in range(3)]
        longest = np.sqrt(np.max(sides, axis=0))
        # a face without area has no normal to fit to
        weight = np.divide(1, longest, out=np.zeros_like(longest), where=areas > 0)
        return fitted_vertices(v, self.faces, target, moves, _FIT, weight), (first, second)

    def _regularized(
        self, normals: FloatArray, sizes: FloatArray, guide: FloatArray, sweeps: int, options: Run
    ) -> Result:
        """Do sweeps of the model on normals, with weights from the guide, at a scale of its own for each component."""
        u, v, labels = self.sampled
        apart = np.nan_to_num(self.parts.medians(np.linalg.norm(guide[u] - guide[v], axis=1), labels))
        scale = np.sqrt(_BASE**2 + np.minimum(_MOST, _TIMES * apart) ** 2)
        weights = _GuidedWeights(sizes, guide / scale[self.of_face][:, None])
        return regularize(
            normals, self.face_graph, p=2, lam=0, weights=weights, solver=Jacobi(damping=1), max_iter=sweeps, **options
        )


def denoised_in_rounds(
    vertices: FloatArray,
    faces: IntArray,
    graph: Graph,
    parts: Components,
    *,
    moves: npt.NDArray[np.bool_],
    sigma: FloatArray,
    given: bool,
    report: Callable[[int], None],
    **options: Unpack[Run],
) -> Rounds:
    """Denoise the vertices of a mesh, (n, 3), each component by itself.

    A round computes the normals n of the faces, and guides g, the mean of n over the faces that share a vertex. Two
    sweeps of the model at p = 2, lam = 0, with weights (a(u) a(v))^(1/3) exp(-|g(u) - g(v)|^2 / s^2), where a is the
    area, and one more with their result as the guide, give the normals to which the vertices are fitted. The heights
    that were removed so far, along the normals of the vertices, are white as long as noise is removed: heights of
    neighbours then have other signs as often as the same. A component stops, without its last round, once they are
    not; a vertex stops where they are not around it.

    Parameters
    ----------
    vertices : (n, 3) float array
    faces : (F, 3) int array
        Triangles with an area.
    graph : Graph
        The graph of the vertices.
    parts : Components
        Its components.
    moves : (n,) bool array
        Vertices that may move.
    sigma : (n,) float array
        Noise around each vertex. It counts only where the first round already removes shape: there the vertices move
        by what noise would.
    given : bool
        Whether the caller gave sigma: then a round that moves the vertices by more than 1.6 sigma is not accepted.
    report : callable
        Called with the number of rounds done.
    **options
        Settings of the run; see :func:`gpureg.regularize`.
    """
    mesh = _Mesh(vertices, faces, graph, parts)
    white = Whiteness(graph, parts, border_vertices(faces, len(vertices)))
    v = vertices
    results: list[Result] = []
    rounds = np.zeros(parts.count, np.int64)
    active = parts.sums(moves) > 0
    stopped = ~moves
    moved, partly = np.zeros((2, len(vertices)), bool)
    # along these normals heights are white, where those of smoother surfaces would follow what was removed
    normals = vertex_normals(vertices, faces)
    for k in range(ROUNDS):
        moving = active[parts.labels] & ~stopped
        if not moving.any():
            break
        new, runs = mesh.round(v, moving, options)
        results += runs
        step = new - vertices
        heights = np.where(moving | moved, (step * normals).sum(axis=1), 0.0)
        refused = active & white.refuses(heights, moving | moved)
        if given:
            limit = BELIEVABLE * np.sqrt(parts.means(np.where(moves, sigma, 0.0) ** 2))
            refused |= active & (np.sqrt(parts.means((step**2).sum(axis=1))) > limit)
        shaped = white.local_shape(heights) & moving
        if k == 0:
            # where the first round already removes shape: a part of its step
            careful = (shaped | refused[parts.labels]) & moving
            v = np.where(careful[:, None], vertices + _careful(step, sigma, graph), v)
            partly = careful
        accepted = moving & ~shaped & ~refused[parts.labels]
        v = np.where(accepted[:, None], new, v)
        moved |= accepted
        stopped |= shaped | white.shaped_border(heights, accepted)
        active &= ~refused
        rounds[active] += 1
        report(k + 1)
    moved |= partly
    if moved.any():
        normals = vertex_normals(v, faces)
        low = spread(graph, np.where(moved, ((vertices - v) * normals).sum(axis=1), 0.0), _LOW)
        v = v + np.where(moved, low, 0.0)[:, None] * normals
    return Rounds(v, results, rounds)


def _careful(step: FloatArray, sigma: FloatArray, graph: Graph) -> FloatArray:
    """Shorten steps (n, 3) so that around each vertex they are what the noise `sigma`, (n,), lets expect."""
    far = np.sqrt(spread(graph, (step**2).sum(axis=1), _AROUND))
    shorter = step * np.minimum(1, _CAREFUL * sigma / np.where(far > 0, far, 1))[:, None]
    lengths = np.linalg.norm(shorter, axis=1)
    most = _CAP * shortest_edges(graph)
    shortened: FloatArray = shorter * np.minimum(1, most / np.where(lengths > 0, lengths, 1))[:, None]
    return shortened


def shortest_edges(graph: Graph) -> FloatArray:
    """Return the length of the shortest edge of each vertex, (n,); 0 without edges."""
    x = graph.positions
    assert x is not None
    lengths = np.linalg.norm(x[graph.edge_rows()] - x[graph.indices], axis=1)
    shortest = np.zeros(graph.n_vertices)
    there = np.diff(graph.indptr) > 0
    if there.any():
        shortest[there] = np.minimum.reduceat(lengths, graph.indptr[:-1][there])
    return shortest
