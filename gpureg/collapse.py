"""Edges of a triangle mesh collapsed one by one, so that it stays a surface: :class:`Collapses`."""

from __future__ import annotations

import numpy as np

from .graph import FloatArray, IntArray
from .surface import face_vectors

# A face may turn by no more than this cosine when a vertex of it moves: 78 degrees.
_TURN = 0.2

# What holds a merged vertex to the middle of the two, of the trace of their planes: it decides along flat directions.
_HOLD = 1e-3


# Where the best place will not do, another may: no further from the planes, in the mean, than this share of the edge.
_DETOUR = 0.1


class Collapses:
    """A mesh whose edges can be collapsed, each into a vertex where the planes of the faces merged so far are nearest.

    An edge is collapsed only if the surface stays one: the two vertices have no neighbours in common but those across
    the edge (the link condition), at a border only along it, no edge has more than two faces, and no face turns over or
    loses its area.

    Parameters
    ----------
    vertices, faces : arrays
        (n, 3) and (F, 3); faces without area are not taken on.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        vectors = face_vectors(vertices, faces)
        areas = np.linalg.norm(vectors, axis=1)
        solid = areas > 0
        self.faces: list[list[int] | None] = faces[solid].tolist()
        self.x = vertices.copy()
        self.around: list[set[int]] = [set() for _ in range(len(vertices))]
        for k, face in enumerate(faces[solid].tolist()):
            for u in face:
                self.around[u].add(k)
        self.n_vertices = sum(bool(around) for around in self.around)
        self.into = np.arange(len(vertices))
        normals = vectors[solid] / areas[solid, None]
        offsets = -(normals * vertices[faces[solid, 0]]).sum(axis=1)
        planes = np.concatenate([normals, offsets[:, None]], axis=1)
        quadrics = planes[:, :, None] * planes[:, None, :] * areas[solid, None, None]
        self.quadrics = np.zeros((len(vertices), 4, 4))
        for k in range(3):
            np.add.at(self.quadrics, faces[solid, k], quadrics)
        self._hold_borders(faces[solid], normals, areas[solid])

    def _hold_borders(self, faces: IntArray, normals: FloatArray, areas: FloatArray) -> None:
        """Planes through the border edges, across their faces: what is merged along a border stays on it."""
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
        """The sum of squared distances of each edge's middle from the planes of both ends, by area, (k,)."""
        both = self.quadrics[edges[:, 0]] + self.quadrics[edges[:, 1]]
        middle = np.concatenate([self.x[edges].mean(axis=1), np.ones((len(edges), 1))], axis=1)
        cost: FloatArray = np.einsum("ki,kij,kj->k", middle, both, middle)
        return cost

    def root(self, u: int) -> int:
        """The vertex that u is part of by now."""
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
        # inside a surface each neighbour is on two of the faces around
        counts: dict[int, int] = {}
        for k in self.around[u]:
            for v in self.faces[k] or ():
                counts[v] = counts.get(v, 0) + 1
        return any(count != 2 for v, count in counts.items() if v != u)

    def collapse(self, u: int, v: int) -> bool:
        """Merge what u and v are part of; False if that is one vertex, no edge, or must stay apart."""
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
            return False  # a tetrahedron would become two faces on the same vertices
        quadric = self.quadrics[u] + self.quadrics[v]
        middle = (self.x[u] + self.x[v]) / 2
        best = _optimum(quadric, middle)
        most = _cost(quadric, best) + _DETOUR**2 * np.trace(quadric[:3, :3]) * ((self.x[u] - self.x[v]) ** 2).sum()
        for place in (best, middle, self.x[v], self.x[u]):
            if _cost(quadric, place) <= most and self._stays(u, v, shared, place):
                self._merge(u, v, shared, quadric, place)
                return True
        return False

    def _stays(self, u: int, v: int, shared: set[int], place: FloatArray) -> bool:
        """Whether no face around turns over or loses its area when u and v go to `place`."""
        rest = list((self.around[u] | self.around[v]) - shared)
        if not rest:
            return True
        corners = np.array([self.faces[k] for k in rest])
        before = self.x[corners]
        moved = (corners == u) | (corners == v)
        after = np.where(moved[:, :, None], place, before)
        old = np.cross(before[:, 1] - before[:, 0], before[:, 2] - before[:, 0])
        new = np.cross(after[:, 1] - after[:, 0], after[:, 2] - after[:, 0])
        lengths = np.sqrt((old**2).sum(axis=1) * (new**2).sum(axis=1))
        longest = ((after - np.roll(after, 1, axis=1)) ** 2).sum(axis=2).max(axis=1)
        # an area of a millionth of the longest edge's square is none
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
        self.n_vertices -= 1

    def labels(self) -> IntArray:
        """For each vertex the one that it is part of, (n,)."""
        into = self.into.copy()
        while (into != into[into]).any():
            into = into[into]
        return into

    def mesh(self) -> tuple[FloatArray, IntArray, IntArray]:
        """The vertices that are left on faces, the faces, and which of the vertices these were."""
        left = np.array([face for face in self.faces if face is not None], np.int64).reshape(-1, 3)
        kept, faces = np.unique(left, return_inverse=True)
        return self.x[kept], faces.reshape(-1, 3), kept


def _cost(quadric: FloatArray, place: FloatArray) -> float:
    """The sum of squared distances from the planes."""
    return float(place @ quadric[:3, :3] @ place + 2 * quadric[:3, 3] @ place + quadric[3, 3])


def _optimum(quadric: FloatArray, middle: FloatArray) -> FloatArray:
    """Where the sum of squared distances from the planes is least, held to the middle a little."""
    A, b = quadric[:3, :3], quadric[:3, 3]
    hold = _HOLD * (A[0, 0] + A[1, 1] + A[2, 2]) + np.finfo(float).tiny
    found: FloatArray = np.linalg.solve(A + hold * np.eye(3), hold * middle - b)
    return found
