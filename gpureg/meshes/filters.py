"""Filters that denoise the positions of a mesh's vertices, or values on them (section 5.3)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal, get_args

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.csr import Graph
from ..graphs.of_shapes import adjacent_faces
from ..model.result import Result
from ..noise.fidelity import fidelity_to_normals, fidelity_to_values
from ..noise.graphs import noise_on_graph
from ..regularization.denoised import Denoised
from ..regularization.options import Model
from ..regularization.regularize import regularize
from ..shapes.surface import Surface, face_normals
from ..solvers import Jacobi
from ..weights import Weights
from .noise import noise_along_normals, noise_of_normals
from .normals import fitted_vertices, regularized_normals

Filter = Literal["normals", "positions"]
FILTERS: tuple[Filter, ...] = get_args(Filter)

# Rounds in which normals are regularized, and iterations per round; a fourth round makes curved shapes worse.
_ROUNDS, _ITERATIONS = 3, 30

# For the default fidelity: the largest accepted root mean square displacement, in units of the noise, and how often the
# fidelity is raised to stay below it. 0.96 to 1.27 on the pairs of bunny, nicolo, fandisk, block and dodecahedron; 1.9
# to 14 where a mesh collapsed.
_BELIEVABLE, _TRIES = 1.6, 8

# Steps that fit the vertices to the normals: more steps make flat faces flatter and curved ones worse.
_FIT = 10

# Taubin smoothing: a step towards the mean of the neighbours, then one away from it.
TAUBIN = (0.5, -0.53)


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshDenoising(Denoised[float]):
    """The result of denoising a mesh: see :class:`Denoised`.

    Attributes
    ----------
    filter : {"normals", "positions", "Taubin", "values"}
    lam : float or array
        An array if `lam` was one: (n,), one per vertex; for "normals" (F,), one per face.
    surface : Surface
        The input mesh.
    edge : float
        Mean length of its edges.
    """

    WHAT: ClassVar[Mapping[str, str]] = {
        "normals": "normals of the faces, vertices moved to fit them",
        "positions": "positions of the vertices",
        "values": "values at the vertices",
    }

    surface: Surface
    edge: float

    @property
    def vertices(self) -> FloatArray:
        """Positions of the vertices after denoising, (n, 3)."""
        return self.value if self.moves else self.surface.vertices

    def describe(self) -> str:
        """Describe the filter and its parameters in one line."""
        if self.filter == "Taubin":
            return f"Taubin's pair of steps, {TAUBIN[0]} and {TAUBIN[1]}, {self.iterations} steps"
        return super().describe()


@dataclass(frozen=True, eq=False)
class Task:
    """A function on the vertices of a mesh without repeated vertices, and the settings of the filter.

    Attributes
    ----------
    surface : Surface
        The input mesh, n vertices.
    faces : (F, 3) int array
        Its triangles on the k vertices without repetitions.
    graph : Graph
        The graph of these vertices, with their centred positions.
    f0 : (k, m) float array
        The function.
    pinned : (k,) bool array
        Vertices whose position or value does not change.
    lam : float, (k,) array or None
    sigma, p : float or None
    weights : Weights, array or None
    max_iter : int or None
    options : Model
        Other settings of :func:`gpureg.regularize`.
    """

    surface: Surface
    faces: IntArray
    graph: Graph
    f0: FloatArray
    pinned: npt.NDArray[np.bool_]
    lam: float | FloatArray | None
    sigma: float | None
    p: float | None
    weights: Weights | npt.ArrayLike | None
    max_iter: int | None
    options: Model

    @property
    def positions(self) -> FloatArray:
        """Centred positions of the vertices, (k, 3)."""
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

    def filtered(self, filter: Filter) -> MeshDenoising:
        """Regularize the positions, or the normals of the faces and then fit the positions to them."""
        estimated = self.sigma is None
        sigma = self.sigma
        if sigma is None:
            sigma = noise_along_normals(self.positions, self.faces, self.graph, self.turned)
        if filter == "normals":
            return self._by_normals(sigma, estimated)
        p = 2.0 if self.p is None else self.p
        lam = self.edge ** (p - 1) * 2 ** (p - 3) / sigma if sigma > 0 and self.edge > 0 else math.inf
        return self._regularized("positions", sigma, estimated, p, lam)

    def values(self) -> MeshDenoising:
        """Regularize values other than positions."""
        sigma = noise_on_graph(self.f0, self.graph) if self.sigma is None else self.sigma
        p = 1.0 if self.p is None else self.p
        lam = fidelity_to_values(self.graph, sigma, p, self.f0.shape[1])
        return self._regularized("values", sigma, self.sigma is None, p, lam)

    def _found(
        self,
        value: FloatArray,
        filter: str,
        results: Iterable[Result],
        *,
        sigma: float,
        estimated: bool,
        p: float,
        lam: float | FloatArray,
    ) -> MeshDenoising:
        return MeshDenoising(
            value=value, filter=filter, results=tuple(results), sigma=sigma, estimated=estimated, p=p, lam=lam,
            surface=self.surface, edge=self.edge,
        )  # fmt: skip

    def _regularized(self, name: str, sigma: float, estimated: bool, p: float, rule: float) -> MeshDenoising:
        """Regularize the function on the graph of the mesh, with the given fidelity or the default, `rule`."""
        lam = rule if self.lam is None else self.lam
        f, results = self.f0, []
        if not (isinstance(lam, float) and math.isinf(lam)):
            held = np.where(self.pinned, math.inf, lam) if self.pinned.any() else lam
            most = 100 if self.max_iter is None else self.max_iter
            results = [regularize(f, self.graph, p=p, lam=held, weights=self.weights, max_iter=most, **self.options)]
            f = results[0].value.astype(np.float64)
        return self._found(f, name, results, sigma=sigma, estimated=estimated, p=p, lam=lam)

    def _by_normals(self, sigma: float, estimated: bool) -> MeshDenoising:
        """Fit the vertices to regularized normals, with the given fidelity or the default.

        The default is multiplied by four while the vertices move by more than noise would. With thin triangles, or few
        triangles on a round shape, the normals differ by shape and not by noise: a cylinder of 64 vertices lost its
        whole volume.
        """
        lam = fidelity_to_normals(self.turned)
        found = self._fitted(sigma, estimated, lam)
        for _ in range(_TRIES):
            moved = float(np.sqrt(((found.value - self.f0) ** 2).sum(axis=1).mean()))
            if self.lam is not None or not found.results or moved <= _BELIEVABLE * sigma:
                break
            lam *= 4
            found = self._fitted(sigma, estimated, lam)
        return found

    def _fitted(self, sigma: float, estimated: bool, rule: float) -> MeshDenoising:
        p = 1.0 if self.p is None else self.p
        lam = self.lam
        if isinstance(lam, np.ndarray):
            lam = lam[self.faces].mean(axis=1)
        used = rule if lam is None else lam
        normals, results = regularized_normals(
            self.positions,
            self.faces,
            used,
            p=p,
            weights=self.weights,
            rounds=_ROUNDS if self.weights is None else 1,
            max_iter=_ITERATIONS if self.max_iter is None else self.max_iter,
            **self.options,
        )
        f = self.f0
        if results:
            f = fitted_vertices(self.positions, self.faces, normals, ~self.pinned, _FIT)
        return self._found(f, "normals", results, sigma=sigma, estimated=estimated, p=p, lam=used)

    def taubin(self) -> MeshDenoising:
        """Alternate steps towards the mean of the neighbours and away from it."""
        f, results = self.f0, []
        options: Model = {**self.options, "solver": Jacobi(damping=1), "tol": None}
        for k in range(10 if self.max_iter is None else self.max_iter):
            results.append(regularize(f, self.graph, p=2, lam=0, weights=self.weights, max_iter=1, **options))
            step = TAUBIN[k % 2] * (results[-1].value - f)
            f = np.where(self.pinned[:, None], f, f + step)
        return self._found(f, "Taubin", results, sigma=0.0, estimated=False, p=2.0, lam=0.0)
