"""What denoising a mesh does to the positions of its vertices, or to values on them (section 5.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.csr import Graph
from ..graphs.of_shapes import adjacent_faces
from ..model.result import Result
from ..noise.fidelity import fidelity_to_normals, fidelity_to_values
from ..noise.graphs import noise_on_graph
from ..regularization.regularize import regularize
from ..shapes.surface import face_normals
from ..solvers import Jacobi
from .noise import noise_along_normals, noise_of_normals
from .normals import fitted_vertices, regularized_normals

Filter = Literal["normals", "vertices"]
FILTERS: tuple[Filter, ...] = get_args(Filter)

# Rounds in which normals are regularized, and their iterations; a fourth round makes curved shapes worse.
_ROUNDS, _ITERATIONS = 3, 30

# Where no fidelity is given: the root mean square of displacements, in deviations of the noise, beyond which the rule's
# is not believed, and how often it is raised. 0.96 to 1.27 on the pairs of bunny, nicolo, fandisk, block and
# dodecahedron; 1.9 to 14 where a mesh collapsed.
_BELIEVABLE, _TRIES = 1.6, 8

# Steps that fit the vertices to their normals: more make flat faces flatter and curved ones worse.
_FIT = 10

# Taubin's pair: a step towards the mean of the neighbours, then one away from it.
TAUBIN = (0.5, -0.53)


class _Found(NamedTuple):
    """A function on the vertices, and what :class:`MeshDenoising` says of how it was found."""

    f: FloatArray
    filter: str
    sigma: float
    estimated: bool
    p: float
    lam: float | FloatArray
    results: list[Result]


@dataclass(frozen=True, eq=False)
class Task:
    """A function f0 on the vertices of a mesh without copies, and what was asked for."""

    faces: IntArray
    graph: Graph
    f0: FloatArray
    pinned: npt.NDArray[np.bool_]
    lam: float | FloatArray | None
    sigma: float | None
    p: float | None
    model: dict[str, Any]
    max_iter: int | None

    @property
    def positions(self) -> FloatArray:
        """Coordinates of the vertices around their mean."""
        assert self.graph.positions is not None
        return self.graph.positions

    @cached_property
    def edge(self) -> float:
        """Mean length of the edges."""
        u, x = self.graph.edge_rows(), self.positions
        return float(np.linalg.norm(x[u] - x[self.graph.indices], axis=1).mean()) if len(u) else 0.0

    @cached_property
    def turned(self) -> float:
        """Noise of the normals of the faces."""
        return noise_of_normals(face_normals(self.positions, self.faces), *adjacent_faces(self.faces))

    def filtered(self, filter: Filter) -> _Found:
        """Positions, by themselves or by the normals of their faces."""
        estimated = self.sigma is None
        sigma = self.sigma
        if sigma is None:
            sigma = noise_along_normals(self.positions, self.faces, self.graph, self.turned)
        if filter == "normals":
            return self._by_normals(sigma, estimated)
        p = 2.0 if self.p is None else self.p
        lam = self.edge ** (p - 1) * 2 ** (p - 3) / sigma if sigma > 0 and self.edge > 0 else math.inf
        return self._regularized("vertices", sigma, estimated, p, lam)

    def values(self) -> _Found:
        """Values other than positions."""
        sigma = noise_on_graph(self.f0, self.graph) if self.sigma is None else self.sigma
        p = 1.0 if self.p is None else self.p
        lam = fidelity_to_values(self.graph, sigma, p, self.f0.shape[1])
        return self._regularized("values", sigma, self.sigma is None, p, lam)

    def _regularized(self, name: str, sigma: float, estimated: bool, p: float, rule: float) -> _Found:
        """The function on the graph of the mesh, by the fidelity given or the rule's."""
        lam = rule if self.lam is None else self.lam
        if isinstance(lam, float) and math.isinf(lam):
            return _Found(self.f0, name, sigma, estimated, p, lam, [])
        held = np.where(self.pinned, math.inf, lam) if self.pinned.any() else lam
        most = 100 if self.max_iter is None else self.max_iter
        result = regularize(self.f0, self.graph, p=p, lam=held, max_iter=most, **self.model)
        return _Found(result.value.astype(np.float64), name, sigma, estimated, p, lam, [result])

    def _by_normals(self, sigma: float, estimated: bool) -> _Found:
        """Vertices fitted to the normals by the fidelity given, or the rule's.

        The rule's is four times as large as long as vertices move by more than noise would. Where triangles are long
        and thin, or few for what is round, the noise of normals tells of the shape: a cylinder of 64 vertices lost all
        of its volume.
        """
        lam = fidelity_to_normals(self.turned)
        found = self._fitted(sigma, estimated, lam)
        for _ in range(_TRIES):
            moved = float(np.sqrt(((found.f - self.f0) ** 2).sum(axis=1).mean()))
            if self.lam is not None or not found.results or moved <= _BELIEVABLE * sigma:
                break
            lam *= 4
            found = self._fitted(sigma, estimated, lam)
        return found

    def _fitted(self, sigma: float, estimated: bool, rule: float) -> _Found:
        p = 1.0 if self.p is None else self.p
        lam = self.lam
        if isinstance(lam, np.ndarray):
            lam = lam[self.faces].mean(axis=1)
        model = self.model | {"max_iter": _ITERATIONS if self.max_iter is None else self.max_iter}
        rounds = _ROUNDS if self.model["weights"] is None else 1
        used = rule if lam is None else lam
        normals, results = regularized_normals(self.positions, self.faces, used, p=p, rounds=rounds, **model)
        f = self.f0
        if results:
            f = fitted_vertices(self.positions, self.faces, normals, ~self.pinned, _FIT)
        return _Found(f, "normals", sigma, estimated, p, used, results)

    def taubin(self) -> _Found:
        """Steps towards the mean of the neighbours and away from it in turn."""
        f, results = self.f0, []
        model = self.model | {"solver": Jacobi(damping=1), "tol": None}
        for k in range(10 if self.max_iter is None else self.max_iter):
            results.append(regularize(f, self.graph, p=2, lam=0, max_iter=1, **model))
            step = TAUBIN[k % 2] * (results[-1].value - f)
            f = np.where(self.pinned[:, None], f, f + step)
        return _Found(f, "Taubin", 0.0, False, 2.0, 0.0, results)
