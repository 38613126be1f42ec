"""Systems with the Hessian."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from .energy import Point

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Solve = Callable[[FloatArray], FloatArray]
"""The solution of a system for a right-hand side (k, m) at the k vertices whose values are computed."""

# Values up to which a system is solved by a factorisation, and the steps and the residual of conjugate gradients.
_DIRECT, _STEPS, _RESIDUAL = 400_000, 20_000, 1e-11


class Singular(ArithmeticError):
    """A Hessian that is singular."""


def solver_of(point: Point, held: tuple[FloatArray, FloatArray] | None) -> Solve:
    """Make a solver for the Hessian of :meth:`Point.hessian`."""
    matrix, together = point.hessian(held), point.energy.p != 2
    if matrix.shape[0] == 0:
        return np.zeros_like
    if matrix.diagonal().min() <= 0:
        raise Singular(
            "the Hessian is singular: with eps = 0 and p > 2 there is no curvature at a vertex without data whose "
            "neighbours have equal values. Give an eps > 0"
        )
    apply = _direct(matrix) if matrix.shape[0] <= _DIRECT else _iterative(matrix)

    def solve(b: FloatArray) -> FloatArray:
        found: FloatArray = apply(b.reshape(-1, 1) if together else b).reshape(b.shape)
        return found

    return solve


def _direct(matrix: csr_array) -> Solve:
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    # equal diagonal entries: conductances differ by many orders
    unit = 1 / np.sqrt(matrix.diagonal())
    scaled = diags_array(unit) @ matrix @ diags_array(unit)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            lu = splu(
                scaled.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
    except RuntimeError as error:
        raise Singular(f"the Hessian is singular ({error})") from None

    def solve(b: FloatArray) -> FloatArray:
        right = unit[:, None] * b
        x = lu.solve(right)
        # one step of refinement
        x = x + lu.solve(right - scaled @ x)
        if not np.isfinite(x).all():
            raise Singular("the Hessian is singular")
        found: FloatArray = unit[:, None] * x
        return found

    return solve


def _iterative(matrix: csr_array) -> Solve:
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import cg

    inverse = diags_array(1 / matrix.diagonal())

    def solve(b: FloatArray) -> FloatArray:
        columns = []
        for column in b.T:
            x, left = cg(matrix, column, rtol=_RESIDUAL, maxiter=_STEPS, M=inverse)
            if left:
                raise Singular(
                    f"{_STEPS} steps of conjugate gradients did not solve the system with the Hessian: use a larger "
                    "eps or lam, or unrolled=K"
                )
            columns.append(x)
        return np.stack(columns, axis=1)

    return solve
