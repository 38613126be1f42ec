"""Collapse edges of a triangle mesh one by one and keep it a valid surface: :class:`Collapses`."""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np

from ..arrays import FloatArray, IntArray
from ..shapes.surface import face_vectors

# Smallest cosine of the angle by which a face may turn when one of its vertices moves: 78 degrees.
_TURN = 0.2

# Weight of the pull of a merged vertex to the edge's midpoint, as a share of the quadric's trace: it makes the position
# unique where the planes leave it free.
_HOLD = 1e-3

_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]
_TINY = float(np.finfo(float).tiny)

# If the best position is not allowed, another one may be at most this share of the edge from the planes, on average.
_DETOUR = 0.1


class Collapses:
    """A mesh whose edges can be collapsed into the point nearest to the planes of all faces merged so far.

    An edge is collapsed only if the mesh stays a surface: the only common neighbours of its two vertices are those
    opposite to the edge (the link condition), border vertices are merged only along the border, no edge has more than
    two faces, and no face turns over or loses its area.

    Parameters
    ----------
    vertices : (n, 3) float array
    faces : (F, 3) int array
        Faces of area 0 are left out.
    quadrics : (n, 4, 4) float array, optional
        The quadric of each vertex from an earlier mesh. None: computed from the planes of its faces.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray, quadrics: FloatArray | None = None) -> None:
        vectors = face_vectors(vertices, faces)
        areas = np.linalg.norm(vectors, axis=1)
        solid = areas > 0
        self.faces: list[list[int] | None] = faces[solid].tolist()
        self.numbers = np.flatnonzero(solid)
        self.x = vertices.copy()
        self.around: list[set[int]] = [set() for _ in range(len(vertices))]
        for k, face in enumerate(faces[solid].tolist()):
            for u in face:
                self.around[u].add(k)
        self.n_vertices = sum(bool(around) for around in self.around)
        self.into = np.arange(len(vertices))
        # how often another vertex was merged into this one: older costs of its edges are out of date
        self.merged = [0] * len(vertices)
        if quadrics is not None:
            self.quadrics = quadrics.copy()
            return
        normals = vectors[solid] / areas[solid, None]
        offsets = -(normals * vertices[faces[solid, 0]]).sum(axis=1)
        planes = np.concatenate([normals, offsets[:, None]], axis=1)
        quadrics = planes[:, :, None] * planes[:, None, :] * areas[solid, None, None]
        self.quadrics = np.zeros((len(vertices), 4, 4))
        for k in range(3):
            np.add.at(self.quadrics, faces[solid, k], quadrics)
        self._hold_borders(faces[solid], normals, areas[solid])

    def _hold_borders(self, faces: IntArray, normals: FloatArray, areas: FloatArray) -> None:
        """Add planes through the border edges, perpendicular to their faces, so that border vertices stay on it."""
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        owner = np.tile(np.arange(len(faces)), 3)
        low = np.sort(edges, axis=1)
        _, first, count = np.unique(low, axis=0, return_index=True, return_counts=True)
        alone = first[count == 1]
        ends, along = edges[alone], self.x[edges[alone, 1]] - self.x[edges[alone, 0]]
        across = np.cross(along, normals[owner[alone]])
        length = np.linalg.norm(across, axis=1, keepdims=True)
        across = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
        planes = np.concatenate([across, -(across * self.x[ends[:, 0]]).sum(axis=1, keepdims=True)], axis=1)
        weight = (along**2).sum(axis=1)
        quadrics = planes[:, :, None] * planes[:, None, :] * weight[:, None, None]
        for k in range(2):
            np.add.at(self.quadrics, ends[:, k], quadrics)

    def costs(self, edges: IntArray) -> FloatArray:
        """Compute the cost of each edge, (k,): the least sum of squared distances to the planes of its two vertices.

        The planes are weighted by the areas of their faces; `edges` is (k, 2).
        """
        both = self.quadrics[edges[:, 0]] + self.quadrics[edges[:, 1]]
        best = _optimum(both, self.x[edges].mean(axis=1))
        cost: FloatArray = _cost(both, best)
        return np.maximum(cost, 0)

    def collapse_cheapest(self, edges: IntArray, least: int, most: float = np.inf) -> int:
        """Collapse the (k, 2) edges in order of cost, down to `least` vertices; return the number of refused edges.

        Edges that cost more than `most` are not collapsed. Costs can only grow when vertices are merged (except for the
        pull to the midpoint): an edge whose vertices were merged gets a new cost when its turn comes.
        """
        heap = [
            (cost, k, a, b, 0, 0)
            for k, (cost, (a, b)) in enumerate(zip(self.costs(edges).tolist(), edges.tolist(), strict=True))
        ]
        heapq.heapify(heap)
        # pairs of merged vertices that are already in the heap: several edges may join the same two
        waiting: set[tuple[int, int, int, int]] = set()
        refused = 0
        while heap and self.n_vertices > least:
            cost, k, a, b, age_a, age_b = heapq.heappop(heap)
            if cost > most:
                break
            u, v = self.root(a), self.root(b)
            if u == v:
                continue
            u, v = min(u, v), max(u, v)
            pair = (u, v, self.merged[u], self.merged[v])
            if pair != (a, b, age_a, age_b):
                if pair in waiting:
                    continue
                waiting.add(pair)
                cost = _cost_of_one((self.quadrics[u] + self.quadrics[v]).tolist(), self.x[u], self.x[v])
                if heap and cost > heap[0][0]:
                    heapq.heappush(heap, (cost, k, *pair))
                    continue
                if cost > most:
                    break
            refused += not self.collapse(u, v, most)
        return refused

    def root(self, u: int) -> int:
        """Return the vertex that u was merged into."""
        into = self.into
        while into[u] != u:
            into[u] = into[into[u]]
            u = int(into[u])
        return u

    def _neighbours(self, u: int) -> set[int]:
        found = {v for k in self.around[u] for v in self.faces[k] or ()}
        found.discard(u)
        return found

    def _is_border(self, u: int) -> bool:
        # around an inner vertex each neighbour belongs to two faces
        counts: dict[int, int] = {}
        for k in self.around[u]:
            for v in self.faces[k] or ():
                counts[v] = counts.get(v, 0) + 1
        return any(count != 2 for v, count in counts.items() if v != u)

    def collapse(self, u: int, v: int, most: float = np.inf) -> bool:
        """Merge the vertices that u and v belong to; return False if there is no such edge or it must not collapse.

        If the best position is not allowed, another one of cost at most `most` may be used.
        """
        u, v = self.root(u), self.root(v)
        if u == v:
            return False
        shared = self.around[u] & self.around[v]
        if not shared or len(shared) > 2:
            return False
        opposite = {w for k in shared for w in self.faces[k] or ()} - {u, v}
        if len(opposite) != len(shared) or self._neighbours(u) & self._neighbours(v) != opposite:
            return False
        if len(shared) == 2 and self._is_border(u) and self._is_border(v):
            return False
        if len(self.around[u] | self.around[v]) <= 4 and len(shared) == 2:
            return False  # a tetrahedron would become two faces with the same vertices
        if self.around[u] | self.around[v] == shared:
            return False  # no face of this component would be left
        quadric = self.quadrics[u] + self.quadrics[v]
        middle = (self.x[u] + self.x[v]) / 2
        best = _optimum(quadric, middle)
        least = float(_cost(quadric, best))
        detour = _DETOUR**2 * np.trace(quadric[:3, :3]) * ((self.x[u] - self.x[v]) ** 2).sum()
        most = max(least, min(least + detour, most))
        for place in (best, middle, self.x[v], self.x[u]):
            if _cost(quadric, place) <= most and self._stays(u, v, shared, place):
                self._merge(u, v, shared, quadric, place)
                return True
        return False

    def _stays(self, u: int, v: int, shared: set[int], place: FloatArray) -> bool:
        """Return whether no face turns over or loses its area when u and v move to `place`, (3,)."""
        rest = list((self.around[u] | self.around[v]) - shared)
        if not rest:
            return True
        corners = np.array([self.faces[k] for k in rest])
        before = self.x[corners]
        moved = (corners == u) | (corners == v)
        after = np.where(moved[:, :, None], place, before)
        old, new = _cross(before), _cross(after)
        lengths = np.sqrt((old**2).sum(axis=1) * (new**2).sum(axis=1))
        longest = ((after - after[:, [2, 0, 1]]) ** 2).sum(axis=2).max(axis=1)
        # an area below a millionth of the squared longest edge counts as 0
        solid = np.sqrt((new**2).sum(axis=1)) > 1e-6 * longest
        return bool((solid & ((old * new).sum(axis=1) > _TURN * lengths)).all())

    def _merge(self, u: int, v: int, shared: set[int], quadric: FloatArray, place: FloatArray) -> None:
        for k in shared:
            for w in self.faces[k] or ():
                self.around[w].discard(k)
            self.faces[k] = None
        for k in self.around[u]:
            face = self.faces[k]
            assert face is not None
            face[face.index(u)] = v
        self.around[v] |= self.around[u]
        self.around[u] = set()
        self.into[u] = v
        self.x[v] = place
        self.quadrics[v] = quadric
        self.merged[v] += 1
        self.n_vertices -= 1

    def labels(self) -> IntArray:
        """Return the vertex that each vertex was merged into, (n,)."""
        into = self.into.copy()
        while (into != into[into]).any():
            into = into[into]
        return into

    def mesh(self) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
        """Return the remaining vertices, (k, 3), the faces, (F, 3), and the old index of each, (k,) and (F,).

        The corners of a face are in the order of the old one.
        """
        numbers = self.numbers[[face is not None for face in self.faces]]
        left = np.array([face for face in self.faces if face is not None], np.int64).reshape(-1, 3)
        kept, faces = np.unique(left, return_inverse=True)
        return self.x[kept], faces.reshape(-1, 3), kept, numbers


def _cross(corners: FloatArray) -> FloatArray:
    """Compute the cross products of triangles (k, 3, 3), (k, 3); np.cross takes three times as long for a few."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    product: FloatArray = a[:, _NEXT] * b[:, _AFTER] - a[:, _AFTER] * b[:, _NEXT]
    return product


def _cost_of_one(quadric: list[list[float]], x: FloatArray, y: FloatArray) -> float:
    """Compute `Collapses.costs` for one edge from x to y in Python floats, which takes a tenth of numpy's time."""
    (a, b, c, d), (_, e, f, g), (_, _, h, i), (*_, j) = quadric
    hold = _HOLD * (a + e + h) + _TINY
    x0, x1, x2 = (float(z) for z in (x + y) / 2)
    p, q, r = hold * x0 - d, hold * x1 - g, hold * x2 - i
    s, t, u = a + hold, e + hold, h + hold
    # Cramer's rule for the symmetric matrix (s b c; b t f; c f u)
    A, B, C = t * u - f * f, c * f - b * u, b * f - c * t
    D, E, F = s * u - c * c, b * c - s * f, s * t - b * b
    det = s * A + b * B + c * C
    x0, x1, x2 = (A * p + B * q + C * r) / det, (B * p + D * q + E * r) / det, (C * p + E * q + F * r) / det
    along = x0 * (a * x0 + 2 * (b * x1 + c * x2 + d)) + x1 * (e * x1 + 2 * (f * x2 + g)) + x2 * (h * x2 + 2 * i)
    return max(along + j, 0.0)


def _cost(quadric: FloatArray, place: FloatArray) -> Any:
    """Compute the sums of squared distances, (...), of points (..., 3) to the planes of quadrics (..., 4, 4)."""
    A, b = quadric[..., :3, :3], quadric[..., :3, 3]
    moved = (A @ place[..., None])[..., 0]
    return (place * (moved + 2 * b)).sum(axis=-1) + quadric[..., 3, 3]


def _optimum(quadric: FloatArray, middle: FloatArray) -> FloatArray:
    """Find the points (..., 3) of least cost for quadrics (..., 4, 4), pulled a little to the midpoints (..., 3)."""
    A, b = quadric[..., :3, :3], quadric[..., :3, 3]
    hold = _HOLD * np.trace(A, axis1=-2, axis2=-1) + np.finfo(float).tiny
    held = A + hold[..., None, None] * np.eye(3)
    found: FloatArray = np.linalg.solve(held, (hold[..., None] * middle - b)[..., None])[..., 0]
    return found
