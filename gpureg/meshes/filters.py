"""What denoising a mesh does, and all there is to say about it: :func:`denoised`."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, IntArray, checked_flags, checked_values
from .checks import check_size
from .graphs.csr import Graph
from .graphs.of_shapes import adjacent_faces, mesh_graph
from .mesh_noise import noise_along_normals, noise_of_normals
from .model.result import Result
from .noise.fidelity import fidelity_to_normals, fidelity_to_values
from .noise.graphs import noise_on_graph
from .normals import fitted_vertices, regularized_normals
from .regularization.regularize import regularize
from .shapes.surface import Surface, border_vertices, face_normals
from .solvers import Jacobi
from .weights import Weights, cotangent

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
_TAUBIN = (0.5, -0.53)


@dataclass(frozen=True, eq=False)
class MeshDenoising:
    """What :func:`denoised` did.

    Attributes
    ----------
    vertices : (n, 3) float array
        Where the vertices are now.
    values : (n,) or (n, m) float array or None
        The regularized attributes, where there were such; the vertices are then as they were.
    filter : str
        "normals", "vertices", "Taubin" or "values".
    sigma : float
        Deviation of the noise, in the units of the coordinates (or of the values): given, or estimated.
    estimated : bool
    p : float
    lam : float or array
        The fidelity used; one per vertex if so asked for, and then for "normals" one per face.
    results : list of Result
        The runs of the model, in their order: rounds of normals, or one.
    displacement : (n,) float array
        How far each vertex has moved.
    edge : float
        Mean length of the edges before.
    seconds : float
    """

    vertices: FloatArray
    values: npt.NDArray[Any] | None
    filter: str
    sigma: float
    estimated: bool
    p: float
    lam: float | FloatArray
    results: list[Result]
    displacement: FloatArray
    edge: float
    seconds: float

    @property
    def iterations(self) -> int:
        """Iterations of all runs together."""
        return sum(result.iterations for result in self.results)

    def describe(self) -> str:
        """The filter and its parameters, in a line."""
        if self.filter == "Taubin":
            return f"Taubin's pair of steps, {_TAUBIN[0]} and {_TAUBIN[1]}, {self.iterations} steps"
        what = {
            "normals": "normals of the faces, vertices moved to fit them",
            "vertices": "positions of the vertices",
            "values": "values at the vertices",
        }[self.filter]
        lam = f"{self.lam:.4g}" if isinstance(self.lam, float) else "a map"
        runs = len(self.results)
        if not runs:
            return f"{what}: there is no noise to remove"
        each = f"{runs} rounds of {self.results[0].iterations}" if runs > 1 else str(self.results[0].iterations)
        return f"{what}; p = {self.p:g}, lam = {lam}, {each} iterations"


class _Found(NamedTuple):
    """A function on the vertices, and what :class:`MeshDenoising` says of how it was found."""

    f: FloatArray
    filter: str
    sigma: float
    estimated: bool
    p: float
    lam: float | FloatArray
    results: list[Result]


def denoised(
    surface: Surface,
    *,
    filter: Filter = "normals",
    values: Any = None,
    p: float | None = None,
    lam: float | npt.ArrayLike | None = None,
    weights: Weights | npt.ArrayLike | Literal["cotangent"] | None = None,
    sigma: float | None = None,
    max_iter: int | None = None,
    taubin: bool = False,
    fixed: npt.ArrayLike | None = None,
    fix_border: bool = False,
    max_displacement: float | None = None,
    **model: Any,
) -> MeshDenoising:
    """:func:`gpureg.denoise_mesh` of a surface; `model` is what else :func:`gpureg.regularize` is told.

    Raises
    ------
    TypeError, ValueError, BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.denoise_mesh`.
    """
    begin = time.perf_counter()
    _check(filter, taubin, values, p, lam, sigma, max_displacement)
    if isinstance(weights, str) and (weights != "cotangent" or (values is None and filter == "normals")):
        allowed = 'an object of gpureg.weights, an array, or "cotangent" for positions and values'
        raise ValueError(f"weights must be {allowed}, got {weights!r}")
    n = len(surface.vertices)
    whole, which = surface.welded()
    k = len(whole.vertices)
    pinned = np.zeros(k, bool)
    if fixed is not None:
        pinned[which[checked_flags("fixed", fixed, n)]] = True
    if fix_border:
        pinned |= border_vertices(whole.faces, k)
    fidelity = None if lam is None else _fidelity(lam, which, k)
    pinned |= np.isinf(0.0 if fidelity is None else fidelity)
    # far from the origin single precision has too few digits for details
    positions = whole.vertices - whole.vertices.mean(axis=0)
    given = None if values is None else checked_values(values, n)
    task = _Task(
        whole.faces,
        mesh_graph(positions, whole.faces),
        positions if given is None else _means(given, which, k),
        pinned,
        fidelity,
        sigma,
        p,
        {"weights": cotangent(whole.faces) if isinstance(weights, str) else weights} | model,
        max_iter,
    )
    found = task.values() if values is not None else task.taubin() if taubin else task.filtered(filter)
    # what is alone comes back as it was, to the bit
    still = pinned | (np.diff(task.graph.indptr) == 0)
    moves = np.where(still[:, None], 0.0, found.f - task.f0)
    if given is not None:
        kept = (given + moves[which]).astype(given.dtype).reshape(np.shape(values))
        return MeshDenoising(surface.vertices, kept, *found[1:], np.zeros(n), task.edge, time.perf_counter() - begin)
    distance = np.linalg.norm(moves, axis=1)
    if max_displacement is not None:
        moves *= np.minimum(1, max_displacement / np.maximum(distance, np.finfo(float).tiny))[:, None]
        distance = np.minimum(distance, max_displacement)
    vertices = (whole.vertices + moves)[which]
    return MeshDenoising(vertices, None, *found[1:], distance[which], task.edge, time.perf_counter() - begin)


@dataclass(frozen=True, eq=False)
class _Task:
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
            step = _TAUBIN[k % 2] * (results[-1].value - f)
            f = np.where(self.pinned[:, None], f, f + step)
        return _Found(f, "Taubin", 0.0, False, 2.0, 0.0, results)


def _check(
    filter: str,
    taubin: bool,
    values: Any,
    p: Any,
    lam: Any,
    sigma: Any,
    max_displacement: Any,
) -> None:
    if filter not in FILTERS:
        raise ValueError(f'filter must be "normals" or "vertices", got {filter!r}')
    if taubin and (filter != "vertices" or values is not None):
        raise ValueError('taubin=True moves positions: it needs filter="vertices", and no values')
    if taubin and not (p is None and lam is None and sigma is None):
        raise ValueError("Taubin's pair knows no p, lam or sigma: leave them out, or taubin")
    if values is not None and max_displacement is not None:
        raise ValueError("max_displacement bounds how far vertices move; values stay where they are")
    check_size("sigma", sigma)
    check_size("max_displacement", max_displacement)


def _fidelity(lam: Any, which: IntArray, k: int) -> float | FloatArray:
    """A number, or one per vertex; copies of a vertex have one."""
    if np.ndim(lam) == 0:
        return float(lam)
    values = np.asarray(lam, dtype=np.float64)
    if values.shape != which.shape:
        raise ValueError(f"lam must be a number or one per vertex, {which.shape}, got {values.shape}")
    return values if k == len(which) else _means(values[:, None], which, k)[:, 0]


def _means(f: FloatArray, which: IntArray, k: int) -> FloatArray:
    """Means over the copies of each vertex, (k, m)."""
    sums = np.stack([np.bincount(which, weights=x, minlength=k) for x in f.T.astype(np.float64)], axis=1)
    means: FloatArray = sums / np.bincount(which, minlength=k)[:, None]
    return means
