"""Systems with the Hessian."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from .cycle import HostCycle
from .energy import Point
from .hessian import Hessian

if TYPE_CHECKING:
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import SuperLU

Solve = Callable[[FloatArray, float | None], FloatArray]
"""The solution of a system for a right-hand side (k, m) at the k vertices whose values are computed.

The number is the residual, as a share of the right-hand side, at which a direction of descent is good enough; None for
a solution, or an error.
"""

# A small system is factorised. A larger one is solved by conjugate gradients with its diagonal. Where they take many
# steps, it is factorised if it has up to so many values and entries and such a bandwidth in a good order, as pictures
# have: a band across one has twice its side. Graphs of points in many dimensions have no narrow band, and their factors
# fill up: they get multigrid, after fewer steps, and p = 2, for whose matrix multigrid is made.
_SMALL, _VALUES, _ENTRIES, _BAND = 1_000, 400_000, 20_000_000, 2_500
# The steps of conjugate gradients before a factorisation, before multigrid, with multigrid before a factorisation, and
# at all; the residual of a solution.
_FEW, _PLAIN, _CYCLES, _MANY, _RESIDUAL = 1_000, 200, 200, 20_000, 1e-12


class Singular(ArithmeticError):
    """A Hessian that is singular."""


def solver_of(point: Point, held: tuple[FloatArray, FloatArray] | None) -> Solve:
    """Make a solver for the matrix of :meth:`Hessian.of`."""
    matrix, together = Hessian.of(point, held), point.energy.p != 2
    if matrix.frozen.shape[0] == 0:
        return lambda b, _: np.zeros_like(b)
    diagonal = matrix.diagonal()
    if diagonal.min() <= 0:
        raise Singular(
            "the Hessian is singular: with eps = 0 and p > 2 there is no curvature at a vertex without data whose "
            "neighbours have equal values. Give an eps > 0"
        )
    system = _System(matrix, diagonal)

    def solve(b: FloatArray, residual: float | None) -> FloatArray:
        columns = b.reshape(-1, 1) if together else b
        found = np.stack([system.solved(column, residual) for column in columns.T], axis=1)
        return found.reshape(b.shape)

    return solve


class _System:
    """A matrix, and what helps to solve its systems once it is needed."""

    def __init__(self, matrix: Hessian, diagonal: FloatArray) -> None:
        self._matrix = matrix
        # equal diagonal entries: conductances differ by many orders
        self._unit = 1 / np.sqrt(diagonal)
        self._cycle: HostCycle | None = None
        self._factors: SuperLU | None = None
        few = len(diagonal) <= _VALUES and matrix.entries <= _ENTRIES
        self._is_narrow = few and matrix.band <= _BAND
        self._sparse = self._scaled() if matrix.is_compact and matrix.entries <= _ENTRIES else None
        self._by_factors = self._is_narrow and matrix.along.shape[0] > 0
        if len(diagonal) <= _SMALL and self._is_narrow:
            self._factorise()

    def _product(self, x: FloatArray) -> FloatArray:
        """Multiply by the matrix with equal diagonal entries."""
        if self._sparse is not None:
            found: FloatArray = self._sparse @ x
            return found
        return self._unit * self._matrix.product(self._unit * x)

    def _scaled(self) -> csr_array:
        """Make the sparse matrix with equal diagonal entries."""
        from scipy.sparse import csr_array, diags_array

        unit = diags_array(self._unit)
        return csr_array(unit @ self._matrix.matrix() @ unit)

    def solved(self, b: FloatArray, residual: float | None) -> FloatArray:
        """Solve for one right-hand side (k,)."""
        right = self._unit * b
        x = self._iterated(right, residual) if self._factors is None else None
        if x is None:
            assert self._factors is not None
            x = self._factors.solve(right)
            # one step of refinement
            x = x + self._factors.solve(right - self._product(x))
            if not np.isfinite(x).all():
                raise Singular("the Hessian is singular")
        found: FloatArray = self._unit * x
        return found

    def _iterated(self, right: FloatArray, residual: float | None) -> FloatArray | None:
        """Solve by conjugate gradients; None if there are factors now, which do it better."""
        if self._cycle is None:
            x, done = self._gradients(right, None, residual, _FEW if self._by_factors else _PLAIN)
            if done:
                return x
            if self._by_factors:
                self._factorise()
                return None
            self._cycle = HostCycle.of(self._matrix.frozen)
        x, done = self._gradients(right, self._cycle, residual, _CYCLES)
        if not done and self._is_narrow:
            self._factorise()
            return None
        if not done and residual is None:
            x, done = self._gradients(right, self._cycle, residual, _MANY)
            if not done:
                raise Singular(
                    f"{_MANY} steps of conjugate gradients did not solve the system with the Hessian: use a larger eps "
                    "or lam, or unrolled=K"
                )
        return x

    def _gradients(
        self, right: FloatArray, cycle: HostCycle | None, residual: float | None, most: int
    ) -> tuple[FloatArray, bool]:
        """Do conjugate gradients; return the solution, and whether it has the residual."""
        from scipy.sparse.linalg import LinearOperator, cg

        by, n = None, len(right)
        if cycle is not None:

            def precondition(r: FloatArray) -> FloatArray:
                columns = (r / self._unit).reshape(-1, self._matrix.channels)
                found: FloatArray = cycle.solve(columns).ravel() / self._unit
                return found

            by = LinearOperator((n, n), matvec=precondition, dtype=np.float64)
        product = LinearOperator((n, n), matvec=self._product, dtype=np.float64)
        x, left = cg(product, right, rtol=residual or _RESIDUAL, maxiter=most, M=by)
        return x, not left

    def _factorise(self) -> None:
        from scipy.sparse.linalg import splu

        symmetric = {"SymmetricMode": True}
        matrix = self._scaled() if self._sparse is None else self._sparse
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._factors = splu(
                    matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric
                )
        except RuntimeError as error:
            raise Singular(f"the Hessian is singular ({error})") from None
