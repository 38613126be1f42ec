"""The linear system of p = 2, and its preconditioners: the diagonal, cosine transforms, multigrid."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import FloatArray
from ..backends import Array, Backend, Cosines, Numbers, Ratio
from ..graphs.csr import Graph
from ..graphs.edges import opposite_edges
from ..graphs.grid import GridGraph
from ..model.matrices import undirected_edges
from ..model.on_device import DeviceProblem
from .cycle import Cycle
from .levels import Couplings, Mask, levels_of

# Conjugate gradients with the diagonal take about sqrt(diagonal/lam) steps times the digits. Up to this quotient, and
# up to so many vertices, they are done before multigrid is set up.
_EASY, _FEW = 1000, 1000


@dataclass(frozen=True)
class Diagonal:
    """The diagonal of the matrix as the preconditioner."""

    values: Array
    name: ClassVar[str] = "its diagonal"
    on_device: ClassVar[bool] = True

    def solve(self, backend: Backend, r: Array) -> None:
        """Do nothing: the backends divide by the diagonal where they need the solution for the residual."""

    def of_residual(self, r: Array) -> tuple[Array, float | Array]:
        """Return the numerator, (n, m), and the denominator of r / diagonal."""
        return r, self.values


@dataclass(frozen=True)
class CosineTransforms:
    """The matrix of the grid reflected at its border as the preconditioner: its eigenvectors are cosines.

    It is the matrix of the grid if all neighbours lie along the axes; otherwise it has additional edges at the border.
    """

    matrix: Cosines
    solved: Array
    name: ClassVar[str] = "cosine transforms"

    @property
    def on_device(self) -> bool:
        """Whether the device does the transforms, and reads nothing back."""
        return self.matrix.place is not None

    def solve(self, backend: Backend, r: Array) -> None:
        """Write the solution for the residual r, (n, m), to ``solved``."""
        backend.cosine_solve(self.matrix, r, out=self.solved)

    @classmethod
    def of(cls, problem: DeviceProblem, graph: GridGraph, lam: float) -> CosineTransforms:
        """Compute the eigenvalues for w = 1: lam + 4 sum_d (1 - prod_a cos(pi i_a d_a / n_a)), d forward offsets."""
        total: FloatArray = np.full((*graph.shape, 1), lam)
        steps, counts = np.unique(np.abs(graph.forward_offsets), axis=0, return_counts=True)
        for step, count in zip(steps, counts, strict=True):
            waves = [np.cos(np.pi * int(d) / n * np.arange(n)) for d, n in zip(step, graph.shape, strict=True)]
            total += 4 * count * (1 - functools.reduce(np.multiply.outer, waves)[..., None])
        backend, m = problem.backend, problem.channels
        return cls(backend.cosines(graph, total, m), backend.empty(graph, m))

    def of_residual(self, r: Array) -> tuple[Array, float | Array]:
        """Return where the solution for the residual is, (n, m), and 1."""
        return self.solved, 1.0


@dataclass(frozen=True)
class Multigrid:
    """A V-cycle as the preconditioner."""

    cycle: Cycle
    solved: Array
    name: ClassVar[str] = "multigrid"
    on_device: ClassVar[bool] = True

    def solve(self, backend: Backend, r: Array) -> None:
        """Write the solution for the residual r, (n, m), to ``solved``."""
        self.cycle.solve(backend, r, self.solved)

    def of_residual(self, r: Array) -> tuple[Array, float | Array]:
        """Return where the solution for the residual is, (n, m), and 1."""
        return self.solved, 1.0


Preconditioner = Diagonal | CosineTransforms | Multigrid


@dataclass(frozen=True)
class Matrix:
    """The matrix on the host, in float64: rows and columns of pinned vertices are left out.

    Attributes
    ----------
    couplings : Couplings
    sums : (n,) array
        The row sums; 0 at pinned vertices.
    diagonal : (n, 1) array
        The diagonal; infinity at pinned vertices.
    """

    couplings: Couplings
    sums: FloatArray
    diagonal: FloatArray

    @classmethod
    def of(cls, problem: DeviceProblem, lam: FloatArray) -> Matrix:
        """Make the matrix of a problem for a fidelity in the device's variable, (n,)."""
        graph, free = problem.weighted.graph, np.isfinite(lam)
        if isinstance(graph, Graph):
            couplings, degree = _stored(problem, graph, free)
        else:
            couplings, degree = _of_edges(problem, free)
        diagonal = lam + 2 * degree
        sums: FloatArray = np.where(free, diagonal, 0) - 2 * couplings.degree()
        return cls(couplings, sums, diagonal[:, None])


def _stored(problem: DeviceProblem, graph: Graph, free: Mask) -> tuple[Couplings, FloatArray]:
    """Return the couplings of the free vertices of a stored graph, and the sum of gamma^2 around each vertex, (n,)."""
    given, rows = problem.host_gamma(), graph.edge_rows()
    values = np.ones(graph.n_edges) if given is None else given.reshape(-1).astype(np.float64)
    own = values**2 if problem.weighted.directed else values
    degree: FloatArray = np.bincount(rows, own, minlength=graph.n_vertices).astype(np.float64)
    if problem.weighted.directed:
        values = values * values[opposite_edges(graph.indptr, graph.indices)]
    used = free[rows] & free[graph.indices] & (values > 0)
    return Couplings.of_rows(graph.indptr, graph.indices, values, used), degree


def _of_edges(problem: DeviceProblem, free: Mask) -> tuple[Couplings, FloatArray]:
    """Do the same for any graph."""
    edges, n = undirected_edges(problem, scaled=False), len(free)
    there, back, u, v = edges.there, edges.back, edges.u, edges.v
    sums = np.bincount(u, there**2, minlength=n) + np.bincount(v, back**2, minlength=n)
    degree: FloatArray = sums.astype(np.float64)
    product = there * back
    used = free[u] & free[v] & (product > 0)
    u, v, product = u[used].astype(np.int32), v[used].astype(np.int32), product[used]
    both = np.concatenate([u, v]), np.concatenate([v, u])
    return Couplings.of_edges(n, *both, np.concatenate([product, product])), degree


@dataclass(frozen=True)
class System:
    """A f = lam f0 with the matrix of the vertex norm; for the edge norm half of it, with twice the fidelity.

    Attributes
    ----------
    lam : float or device function, (n, 1)
    share : float
        1/2 for the edge norm, otherwise 1.
    preconditioner : Diagonal, CosineTransforms or Multigrid
    matrix : Matrix or None
        The matrix on the host, if multigrid or a certificate needs it.
    """

    lam: float | Array
    share: float
    preconditioner: Preconditioner
    matrix: Matrix | None

    @classmethod
    def of(cls, problem: DeviceProblem) -> System:
        """Make the system of a problem with p = 2."""
        backend, graph, m = problem.backend, problem.weighted.graph, problem.channels
        share, fidelity = 0.5 if problem.edge_norm else 1.0, problem.lam
        if problem.edge_norm:
            number = isinstance(fidelity, float)
            fidelity = 2 * fidelity if number else backend.put(graph, 2 * backend.get(graph, fidelity))
        if _repeats(problem):
            assert isinstance(graph, GridGraph) and isinstance(fidelity, float)
            return cls(fidelity, share, CosineTransforms.of(problem, graph, fidelity), None)
        each = np.full((graph.n_vertices, 1), fidelity) if isinstance(fidelity, float) else backend.get(graph, fidelity)
        each = each.astype(np.float64)
        degree = backend.get(graph, backend.degree(problem.weighted)).astype(np.float64)
        diagonal = each + 2 * degree
        least = float(np.min(each, initial=np.inf))
        free = np.isfinite(each)
        hard = least == 0 or float(np.max(diagonal[free] / each[free], initial=0)) > _EASY
        matrix = Matrix.of(problem, each[:, 0]) if least == 0 or (hard and graph.n_vertices > _FEW) else None
        if matrix is None or graph.n_vertices <= _FEW:
            return cls(fidelity, share, Diagonal(backend.put(graph, diagonal)), matrix)
        return cls(fidelity, share, multigrid(problem, matrix, fidelity, m), matrix)

    def residual(self, problem: DeviceProblem, f: Array, out: Array) -> Array:
        """Compute lam f0 - A f, (n, m)."""
        backend, weighted = problem.backend, problem.weighted
        backend.gradient(weighted, f, problem.f0, None, self.lam, out=out)
        return backend.combine(weighted.graph, -1.0, out, 0.0, out, out=out)


def multigrid(problem: DeviceProblem, matrix: Matrix, lam: float | Array, channels: int) -> Multigrid:
    """Make the preconditioner by multigrid of a matrix, for functions of so many channels."""
    backend, weighted = problem.backend, problem.weighted
    levels = levels_of(weighted.graph, matrix.couplings)
    cycle = Cycle.put(backend, weighted, lam, matrix.diagonal, matrix.sums, levels, channels)
    return Multigrid(cycle, backend.empty(weighted.graph, channels))


@dataclass(frozen=True)
class Gradients:
    """One step of conjugate gradients, with all of its numbers on the device.

    Attributes
    ----------
    residual, direction, scratch : device functions, (n, m)
    numbers : Numbers
        The products of the residual and its solution in two steps, and the curvature along the direction.
    """

    residual: Array
    direction: Array
    scratch: Array
    numbers: Numbers

    @classmethod
    def empty(cls, problem: DeviceProblem, channels: int) -> Gradients:
        """Allocate the memory."""
        backend, graph = problem.backend, problem.weighted.graph
        residual, direction, scratch = (backend.empty(graph, channels) for _ in range(3))
        return cls(residual, direction, scratch, backend.numbers(3))

    def begin(self, problem: DeviceProblem) -> None:
        """Forget the direction: the first one is the solution for the residual."""
        backend, graph = problem.backend, problem.weighted.graph
        backend.combine(graph, 0.0, self.residual, 0.0, self.residual, out=self.direction)
        for at in (0, 1):
            backend.dot_into(self.numbers[at], graph, self.direction, self.direction)

    def step(
        self,
        backend: Backend,
        problem: DeviceProblem,
        system: System,
        by: Preconditioner,
        here: tuple[Array, int],
        there: tuple[Array, int],
    ) -> None:
        """Do a step from f and its number to the other ones, preconditioned `by`."""
        graph, residual, direction, scratch, numbers = (
            problem.weighted.graph,
            self.residual,
            self.direction,
            self.scratch,
            self.numbers,
        )
        new, old, curvature = there[1], here[1], 2
        if by.on_device:
            by.solve(backend, residual)
        z, over = by.of_residual(residual)
        backend.dot_into(numbers[new], graph, residual, z, over=over)
        backend.combine(graph, Ratio(numbers, new, old), direction, 1.0, z, over=over, out=direction)
        backend.gradient(problem.weighted, direction, None, None, system.lam, out=scratch)
        backend.dot_into(numbers[curvature], graph, direction, scratch)
        backend.combine(graph, Ratio(numbers, new, curvature), direction, 1.0, here[0], out=there[0])
        backend.combine(graph, Ratio(numbers, new, curvature, -1.0), scratch, 1.0, residual, out=residual)


def _repeats(problem: DeviceProblem) -> bool:
    """Return whether the matrix is uniform inside the border: a grid without mask, w = 1, lam a number."""
    graph = problem.weighted.graph
    return (
        isinstance(graph, GridGraph)
        and graph.mask is None
        and problem.weighted.weights is None
        and isinstance(problem.lam, float)
        and math.isfinite(problem.lam)
        and problem.lam > 0
        and problem.scale is None
    )
