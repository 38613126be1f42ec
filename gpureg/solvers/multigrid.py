"""Precondition matrices of a graph by algebraic multigrid (pyamg), or without pyamg by their diagonal."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..arrays import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Preconditioner = Callable[[FloatArray], FloatArray]


def is_there() -> bool:
    """Return whether pyamg is installed."""
    return importlib.util.find_spec("pyamg") is not None


def cycle(A: csr_array) -> Preconditioner:
    """Make a preconditioner of a symmetric positive definite M-matrix: one V-cycle on each column of (n, m).

    Classical coarsening (Ruge and Stuben) with a symmetric smoother, as conjugate gradients need. Without pyamg it is
    the diagonal of A.
    """
    if not is_there():
        diagonal = A.diagonal()[:, None]
        return lambda r: r / diagonal
    import pyamg
    from scipy.sparse import csr_matrix

    solver = pyamg.ruge_stuben_solver(csr_matrix(A), max_coarse=50)
    apply = solver.aspreconditioner(cycle="V").matvec

    def on_columns(r: FloatArray) -> FloatArray:
        solved: FloatArray = np.stack([apply(r[:, c]) for c in range(r.shape[1])], axis=1)
        return solved

    return on_columns


class Solved(NamedTuple):
    """The result of conjugate gradients.

    Attributes
    ----------
    x : array
        The solution, in the shape of the right-hand side.
    steps : int
        Steps done.
    converged : bool
        Whether the residual reached the tolerance.
    """

    x: FloatArray
    steps: int
    converged: bool


def conjugate_gradients(
    apply: Callable[[FloatArray], FloatArray],
    b: FloatArray,
    precondition: Preconditioner | None = None,
    *,
    rtol: float,
    most: int,
    start: FloatArray | None = None,
) -> Solved:
    """Solve A x = b by conjugate gradients on the host, in float64.

    Parameters
    ----------
    apply : callable
        The product of the symmetric positive definite A and an array in the shape of b.
    b : array
        The right-hand side, of any shape.
    precondition : callable, optional
        An approximate solution for a residual in the shape of b. None: the residual.
    rtol : float
        Stop once |b - A x| <= rtol |b|.
    most : int
        Maximal number of steps.
    start : array, optional
        Initial x, in the shape of b. None: 0.

    Returns
    -------
    Solved
    """
    from scipy.sparse.linalg import LinearOperator, cg

    shape, steps = b.shape, 0

    def count(_: FloatArray) -> None:
        nonlocal steps
        steps += 1

    def operator(product: Callable[[FloatArray], FloatArray]) -> LinearOperator:
        return LinearOperator((b.size, b.size), matvec=lambda x: product(x.reshape(shape)).ravel(), dtype=np.float64)

    M = None if precondition is None else operator(precondition)
    x0 = None if start is None else start.ravel()
    x, left = cg(operator(apply), b.ravel(), x0=x0, rtol=rtol, maxiter=most, M=M, callback=count)
    return Solved(x.reshape(shape), steps, not left)
