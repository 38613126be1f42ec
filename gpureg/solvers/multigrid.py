"""Algebraic multigrid, by pyamg, as a preconditioner of the matrices of a graph; their diagonal without pyamg."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Preconditioner = Callable[[FloatArray], FloatArray]


def is_there() -> bool:
    """Whether pyamg is installed."""
    return importlib.util.find_spec("pyamg") is not None


def cycle(A: csr_array) -> Preconditioner:
    """One V-cycle for a symmetric positive definite M-matrix, on every column of a residual (n, m).

    Classical coarsening (Ruge and Stuben) with a symmetric smoother, so that conjugate gradients may use it. Without
    pyamg the diagonal of A.
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


def conjugate_gradients(
    apply: Callable[[FloatArray], FloatArray],
    b: FloatArray,
    precondition: Preconditioner,
    *,
    rtol: float,
    most: int,
) -> tuple[FloatArray, int]:
    """X with |b - A x| <= rtol |b|, or what `most` steps reach, and the steps; `apply` is symmetric, of any shape."""
    from scipy.sparse.linalg import LinearOperator, cg

    shape, steps = b.shape, 0

    def count(_: FloatArray) -> None:
        nonlocal steps
        steps += 1

    A = LinearOperator((b.size, b.size), matvec=lambda x: apply(x.reshape(shape)).ravel(), dtype=np.float64)
    M = LinearOperator((b.size, b.size), matvec=lambda r: precondition(r.reshape(shape)).ravel(), dtype=np.float64)
    x, _ = cg(A, b.ravel(), rtol=rtol, maxiter=most, M=M, callback=count)
    return x.reshape(shape), steps
