"""A certificate at p = 2 for any lam: generalised diagonal dominance.

A is an M-matrix: its entries off the diagonal are <= 0. For a function h > 0 with A h > 0 at the vertices that are not
pinned, and the residual r = lam f0 - A f,

    P(f) - P(f*) = 1/2 r' A^-1 r <= 1/2 sum_u r(u)^2 h(u) / (A h)(u)
    |f - f*|(u) <= h(u) max_v |r(v)| / (A h)(v)

because x'Ax = sum_u (A h/h)(u) x(u)^2 + sum over edges of |a_uv| h_u h_v (x_u/h_u - x_v/h_v)^2. With lam > 0
everywhere, h = 1 serves; otherwise the solution of A h = 1, to one digit.

A device computes r with a rounding of at most u (k + 10) times the sum of |a_uv (f(u) - f(v))|, u half a machine
epsilon and k the number of edges at a vertex. By the Cauchy-Schwarz inequality this sum is at most
(2 diagonal)^(1/2) |grad f(u)|. With a gamma that is not symmetric, differences of products are no smaller than these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..backends import Array
from ..graphs.grid import GridGraph
from ..model.on_device import DeviceProblem
from .systems import Diagonal, Gradients, Matrix, System, multigrid

# A h is at least this.
_LEAST = 0.3
# Steps between two looks at A h, and the maximal number of looks.
_STEPS, _LOOKS = 6, 60
# Vertices up to which the host solves for h.
_DIRECT = 1000


@dataclass(frozen=True)
class Dominance:
    """The function h of a matrix.

    Attributes
    ----------
    over : device function, (n, 1)
        A h / h; infinity at pinned vertices.
    h : (n,) array
        0 at pinned vertices.
    product : (n,) array
        A h; infinity at pinned vertices.
    """

    over: Array
    h: FloatArray
    product: FloatArray

    @classmethod
    def of(cls, problem: DeviceProblem, system: System) -> Dominance | None:
        """Find h for a system with lam = 0 at some vertices; None if the matrix is singular up to rounding."""
        matrix = system.matrix
        assert matrix is not None
        free = np.isfinite(matrix.diagonal[:, 0])
        n = int(free.sum())
        h = _direct(matrix, free) if n <= _DIRECT else _iterated(problem, system, matrix, free)
        product = matrix.couplings.product(matrix.sums, h)
        # the rounding of the product: the sum of the sizes of its terms
        lost = 4 * np.finfo(np.float64).eps * np.where(free, matrix.diagonal[:, 0], 0) * h
        if not (product - lost > 0)[free].all() or not (h[free] > 0).all():
            return None
        product = np.where(free, product - lost, np.inf)
        over = np.where(free, product / np.where(free, h, 1), np.inf)
        return cls(problem.backend.put(problem.weighted.graph, over[:, None]), h, product)

    def error(self, residual: FloatArray, lost: FloatArray) -> float:
        """Bound the Euclidean distance from the minimiser, from the residual, (n, m), and its rounding, (n,)."""
        largest = ((np.abs(residual) + lost[:, None]) / self.product[:, None]).max(axis=0)
        return math.sqrt(float((largest**2).sum()) * float((self.h**2).sum()))

    def gap_of(self, lost: FloatArray, channels: int) -> float:
        """Bound 1/2 sum r^2 h/(A h) for a residual of this size, (n,), in each of so many channels."""
        return float((lost**2 * self.h / self.product).sum()) * channels / 2


def rounding_of_residual(problem: DeviceProblem, matrix: Matrix, f: Array) -> FloatArray:
    """Bound the rounding of lam f0 - A f as a device computes it, in any channel, (n,); 0 at pinned vertices."""
    backend, weighted = problem.backend, problem.weighted
    graph, diagonal = weighted.graph, matrix.diagonal[:, 0]
    free = np.isfinite(diagonal)
    diagonal = np.where(free, diagonal, 0)
    edges = len(graph.offsets) if isinstance(graph, GridGraph) else int(np.diff(graph.indptr).max(initial=0))
    if weighted.directed:
        largest = float(np.abs(backend.get(graph, f)).max(initial=0))
        sums = 2 * (diagonal + np.sqrt(diagonal * diagonal.max(initial=0))) * largest
    else:
        slopes = backend.get(graph, backend.gradient_norm(weighted, f, power=0.5, eps=0.0, coupled=True))
        sums = np.sqrt(2 * diagonal) * slopes[:, 0].astype(np.float64)
    lost: FloatArray = np.where(free, (edges + 10) * float(np.finfo(backend.dtype).eps) / 2 * sums, 0)
    return lost


def _direct(matrix: Matrix, free: np.ndarray) -> FloatArray:
    """Solve A h = 1 by a factorization."""
    from scipy.sparse import csr_array, diags_array
    from scipy.sparse.linalg import splu

    W = matrix.couplings
    off = csr_array((W.weights, W.indices, W.indptr), shape=(W.n, W.n))
    A = diags_array(np.where(free, matrix.diagonal[:, 0], 1)) - 2 * off
    try:
        found: FloatArray = splu(A.tocsc()).solve(free.astype(np.float64))
    except RuntimeError:  # exactly singular
        return np.zeros(len(free))
    return found


def _iterated(problem: DeviceProblem, system: System, matrix: Matrix, free: np.ndarray) -> FloatArray:
    """Solve A h = 1 on the device, until A h >= 0.3 everywhere, computed on the host."""
    backend, graph = problem.backend, problem.weighted.graph
    by = system.preconditioner
    if not isinstance(by, Diagonal) and problem.channels > 1:
        by = multigrid(problem, matrix, system.lam, 1)
    h: FloatArray = np.zeros(len(free))
    work = Gradients.empty(problem, 1)
    f, other = backend.empty(graph, 1), backend.empty(graph, 1)
    for _ in range(_LOOKS):
        left = np.where(free, 1 - matrix.couplings.product(matrix.sums, h), 0)
        if left.max(initial=0) <= 1 - _LEAST:
            break
        work = Gradients(backend.put(graph, left[:, None]), work.direction, work.scratch, work.numbers)
        work.begin(problem)
        backend.combine(graph, 0.0, work.residual, 0.0, work.residual, out=f)
        here, there = (f, 0), (other, 1)
        for _ in range(_STEPS):
            work.step(backend, problem, system, by, here, there)
            here, there = there, here
        h = h + np.where(free, backend.get(graph, here[0])[:, 0].astype(np.float64), 0)
    return h
