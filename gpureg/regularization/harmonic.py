"""Solve p = 2 exactly, as the start of functions that fill in unknown values.

A sweep carries information over one neighbourhood, so that a hole of k pixels across takes of the order of k^2 sweeps
to fill. For p = 2 conjugate gradients take of the order of k steps, and their solution is a good start for another p.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray, computed_type
from ..backends import Chosen
from ..graphs.grid import AnyGraph, GridGraph
from ..model.matrices import undirected_edges
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from ..solvers.multigrid import conjugate_gradients, cycle, is_there
from ..weights import Weights

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Residual of conjugate gradients relative to the right-hand side. The error is larger by the condition number, about
# n^2 times the ratio of the weights on a path of n vertices. On the 114,599 Luxembourg streets 1e-7 leaves an error of
# 8e-6 after 4498 steps (5 s), 1e-10 one of 1e-8 after 6343; with weights that differ by 1e6, 1e-7 says nothing.
RESIDUAL = 1e-10
# Unknown vertices up to which the system is solved directly: weights that differ by factors of 1e5 (1/distance^2 on
# roads, bilateral ones on images) need more conjugate gradient steps than there are vertices. The factors have at most
# 9 million numbers.
DIRECT = 3000
# The same for the nearest neighbours of an image, whose factors stay sparse: 8.4 million numbers, 1.4 s at 512 x 512.
DIRECT_PLANE = 300_000
# A number, far above rounding, that is added to the unit diagonal before factorization, and the maximal number of steps
# that correct for it: few are needed if all weights are larger.
SHIFT, FACTORED_STEPS = 1e-12, 200
# Steps before algebraic multigrid, if pyamg is installed: its setup costs as much as some hundred steps.
PLAIN_STEPS = 500
MAX_STEPS = 20_000


def harmonic(
    f0: FloatArray,
    graph: AnyGraph,
    known: npt.NDArray[np.bool_],
    *,
    weights: Weights | npt.ArrayLike | None = None,
    gamma: str | npt.ArrayLike = "sqrt",
    backend: Chosen = "auto",
    dtype: npt.DTypeLike | None = None,
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Find the minimiser of the model for p = 2 with the known vertices pinned and lam = 0 at the others.

    Parameters
    ----------
    f0 : (n, m) float array
        The values of the known vertices, and an initial guess at the others. Weight functions are computed from it.
    graph : Graph or GridGraph
    known : (n,) bool array
    weights, gamma, backend, dtype
        As in :func:`gpureg.regularize`; `backend` and `dtype` are only used for the weights.

    Returns
    -------
    f : (n, m) float64 array
        `f0`, with new values at the unknown vertices that are connected to a known one.
    reached : (n,) bool array
        Known vertices, and those connected to one by edges of weight > 0.

    Notes
    -----
    The energy is a sum over undirected edges of (gamma_uv f(u) - gamma_vu f(v))^2 (eq. 4, 20). Its minimiser solves
    A f = b on the unknown vertices, with A_uu = sum_v gamma_uv^2, A_uv = -gamma_uv gamma_vu and
    b_u = sum_v gamma_uv gamma_vu f0(v) over the known v.

    Examples
    --------
    >>> import gpureg as gr
    >>> path = gr.GridGraph(5)
    >>> f, reached = harmonic(np.array([[0.0], [9], [9], [9], [1]]), path, np.array([1, 0, 0, 0, 1], bool))
    >>> f[:, 0].round(3)
    array([0.  , 0.25, 0.5 , 0.75, 1.  ])
    """
    from scipy import sparse
    from scipy.sparse import csgraph

    f = f0.astype(np.float64)
    reached = known.copy()
    unknown = np.flatnonzero(~known)
    if not len(unknown):
        return f, reached
    kind = computed_type(dtype)
    problem = Problem.make(f0, graph, lam=0.0, weights=weights, gamma=gamma, eps=0.0, dtype=kind, framed=True)
    on = DeviceProblem.put(problem, backends.get(backend, kind))
    edges = undirected_edges(on, wanted=~known)
    u, v, there, back = edges.u, edges.v, edges.there, edges.back
    k = len(unknown)
    place = np.full(graph.n_vertices, -1)
    place[unknown] = np.arange(k)
    # both directions of every edge that starts at an unknown vertex
    start, end = np.concatenate([u, v]), np.concatenate([v, u])
    here, other = np.concatenate([there, back]), np.concatenate([back, there])
    owned = place[start] >= 0
    start, end, here, product = place[start[owned]], end[owned], here[owned], (here * other)[owned]
    inner = (place[end] >= 0) & (product > 0)
    pattern = sparse.coo_array((product[inner], (start[inner], place[end[inner]])), shape=(k, k)).tocsr()
    pinned = (place[end] < 0) & (product > 0)
    _, part = csgraph.connected_components(pattern, directed=False)
    told = np.zeros(part.max() + 1, bool)
    told[part[start[pinned]]] = True
    solvable = np.flatnonzero(told[part])
    reached[unknown[solvable]] = True
    if not len(solvable):
        return f, reached
    diagonal = np.bincount(start, here**2, minlength=k)
    A = (sparse.diags_array(diagonal) - pattern).tocsr()[solvable][:, solvable]
    # scaled by its diagonal on both sides: the Jacobi preconditioner, without a cost per step
    root = 1 / np.sqrt(diagonal[solvable])
    A = (sparse.diags_array(root) @ A @ sparse.diags_array(root)).tocsr()
    in_a_plane = isinstance(graph, GridGraph) and graph.ndim <= 2 and np.abs(graph.offsets).max(initial=0) <= 1
    b: FloatArray = np.stack(
        [
            root * np.bincount(start[pinned], product[pinned] * f[end[pinned], channel], minlength=k)[solvable]
            for channel in range(f.shape[1])
        ],
        axis=1,
    )
    guess = f[unknown[solvable]] / root[:, None]
    if len(solvable) <= (DIRECT_PLANE if in_a_plane else DIRECT):
        solved, left, steps = *_factored(A, b, guess), FACTORED_STEPS
    else:
        solved, left, steps = *_iterated(A, b, guess), MAX_STEPS
    if left:
        warnings.warn(
            f"the first fill did not converge in {steps} steps of conjugate gradients, the weights differ too "
            "much: more iterations (max_iter) and tol=None may be needed, or weights that differ less",
            RuntimeWarning,
            stacklevel=4,  # the caller of a public function
        )
    values: FloatArray = root[:, None] * solved
    if np.array_equal(there, back):
        # by the maximum principle the solution lies in the range of the pinned values: clip errors beyond it
        low, high = (np.full((part.max() + 1, f.shape[1]), end_) for end_ in (np.inf, -np.inf))
        np.minimum.at(low, part[start[pinned]], f[end[pinned]])
        np.maximum.at(high, part[start[pinned]], f[end[pinned]])
        values = np.clip(values, low[part[solvable]], high[part[solvable]])
    f[unknown[solvable]] = values
    return f, reached


def _factored(A: csr_array, b: FloatArray, guess: FloatArray) -> tuple[FloatArray, list[int]]:
    """Solve A x = b, (k, m), by a factorization; A has a unit diagonal. Return x and the columns not converged.

    A is singular up to rounding if some vertices are joined to all others only by weights such as 1e-20. `SHIFT` is
    therefore added to its diagonal; a few conjugate gradient steps, preconditioned by the factors, correct for it where
    A determines the solution, and keep the guess, (k, m), where it does not.
    """
    from scipy import sparse
    from scipy.sparse import linalg

    shifted = (A + SHIFT * sparse.eye_array(A.shape[0])).tocsc()
    factors = linalg.splu(shifted, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    x, left = _by_gradients(A, b, guess, range(b.shape[1]), FACTORED_STEPS, factors.solve)
    # one step of iterative refinement, for digits beyond the tolerance
    return x + factors.solve(b - A @ x), left


def _iterated(A: csr_array, b: FloatArray, guess: FloatArray) -> tuple[FloatArray, list[int]]:
    """Solve A x = b, (k, m), without a factorization; return x and the columns not converged."""
    steps = min(PLAIN_STEPS, MAX_STEPS) if is_there() else MAX_STEPS
    x, left = _by_gradients(A, b, guess, range(b.shape[1]), steps)
    if not left or not is_there():
        return x, left
    apply = cycle(A)
    return _by_gradients(A, b, x, left, MAX_STEPS, lambda r: apply(r.reshape(-1, 1)).ravel())


def _by_gradients(
    A: csr_array,
    b: FloatArray,
    start: FloatArray,
    columns: Iterable[int],
    steps: int,
    precondition: Callable[[FloatArray], FloatArray] | None = None,
) -> tuple[FloatArray, list[int]]:
    """Solve A x = b, (k, m), for some columns; return x, other columns from `start`, and the columns not converged."""
    x, left = start.copy(), []
    for k in columns:
        found = conjugate_gradients(
            lambda r: A @ r, b[:, k], precondition, rtol=RESIDUAL, most=steps, start=start[:, k]
        )
        x[:, k] = found.x
        left += [] if found.converged else [k]
    return x, left
