"""The front door to the model: :func:`regularize`."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray, computed_type
from ..backends import Backend
from ..checks import flag, integer, number
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..graphs.csr import Graph
from ..graphs.grid import GridGraph
from ..model.memory import Budget, Job, budget, readable
from ..model.on_device import DeviceProblem
from ..model.problem import Norm, Problem, as_function, uses_degrees
from ..model.result import Interrupted, Result, Stop
from ..progress import progress_bar
from ..solvers import Jacobi, Solver, resolve, run
from ..solvers.loop import Callback, Outcome
from ..weights import Weights
from .tiled import run_in_tiles, why_whole
from .tiling import Tiling, halo, tiling, work_of


@door
def regularize(
    f0: npt.ArrayLike,
    graph: GraphLike,
    *,
    p: float = 2.0,
    lam: float | npt.ArrayLike = 1.0,
    weights: Weights | npt.ArrayLike | None = None,
    gamma: str | npt.ArrayLike = "sqrt",
    norm: Norm = "vertex",
    coupled: bool = True,
    eps: float | None = None,
    solver: str | Solver = "jacobi",
    max_iter: int | None = None,
    tol: float | None = None,
    update_weights: int | None = None,
    initial: npt.ArrayLike | None = None,
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
    callback: Callback | None = None,
    progress: bool = False,
    memory: int | None = None,
) -> Result:
    """Regularize a function on the vertices of a weighted graph.

    Parameters
    ----------
    f0 : array
        The data, shape (n,) or (n, m); on a :class:`GridGraph` also its shape, or its shape with a last axis of m
        channels. Values are used as they come.
    graph : Graph or GridGraph
        The graph of n vertices; or a symmetric sparse matrix of weights of scipy, or a graph of networkx, whose loops
        are left out with a warning. NaN and infinity in `f0` are allowed only where a grid's mask leaves the vertex
        out; such a value decides nothing, but patches that reach over it see it (NaN as 0).
    p : float, default 2
        Degree of regularity > 0: 2 is Tikhonov's, 1 total variation, towards 0 the result becomes piecewise constant.
    lam : float or array, default 1
        Fidelity >= 0, a number or one value per vertex: larger stays closer to the data. 0: no data there; infinity:
        pinned to the data.
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights`, or one value per stored directed edge. None: the graph's own, or 1.
    gamma : {"sqrt", "combinatorial", "normalized", "degree"} or array, default "sqrt"
        gamma(u, v) of eq. 4: sqrt(w), sqrt(w/2), sqrt(w/(2 deg u)), sqrt(w/deg u); or one value >= 0 per stored
        directed edge, symmetric or not, instead of any weights.
    norm : {"vertex", "edge"}, default "vertex"
        The smoothness: "vertex" is eq. 20, the gradient norm of a vertex raised to p (isotropic); "edge" is eq. 30,
        every edge by itself (anisotropic). They differ by a factor even at p = 2: "edge" with lam is "vertex" with
        2 lam.
    coupled : bool, default True
        One gradient norm for all m channels (section 5.1), or each channel alone.
    eps : float, optional
        Smoothing of the gradient norm (eq. 15), in the data's units. None takes 1e-3 of the data's range, or 0 where
        it is not needed: for p = 2, and with the certified solver.
    solver : str or Solver, default "jacobi"
        "jacobi" (eq. 25, 31), "euler" (eq. 24), "certified" (the minimiser, for p >= 1 and lam > 0, with a bound on
        how far the result is from it), or an object of :class:`gpureg.Jacobi`, :class:`gpureg.Euler` or
        :class:`gpureg.Certified`, which holds settings.
    max_iter : int, optional
        Iterations at most. None: 100 with "jacobi" and "euler", 20 000 with "certified".
    tol : float, optional
        When to stop before that. The paper's processes: once the largest change in one iteration is at most this share
        of the data's range (the error can be far larger than the last change when lam is small; ``Jacobi(stop=...)``
        knows other tests). "certified": once the duality gap is at most this share of the energy, 1e-4 where None.
    update_weights : int, optional
        Compute the weights anew from the current iterate every so many iterations, at least once before `tol` may end
        the run (the paper's footnote 1: iterated
        bilateral filter and nonlocal means); `weights` must be an object of :mod:`gpureg.weights`. The energy is then
        that of the current weights, and may jump. Not with "certified".
    initial : array, optional
        Where to start, in the shape of `f0`; None starts at `f0`.
    backend : str, default "auto"
        "auto", "numpy", "opencl", "warp", or a device such as "opencl:1". GPUREG_BACKEND overrides "auto".
    dtype : dtype, optional
        Type to compute in: float32 (None) or float64.
    callback : callable, optional
        Called with a :class:`gpureg.Check` before the first iteration and at every check; returning True stops the run.
    progress : bool, default False
        Show a bar on the terminal's error stream.
    memory : int, optional
        Bytes that the job may take on the device. None: half of a CPU's memory, 90 percent of a GPU's. The environment
        variable GPUREG_MEMORY, such as "4GiB", lowers either.

    Returns
    -------
    Result
        The value in the shape of `f0` and the type computed in, and how it was reached. On a grid a job that does not
        fit goes through in tiles, with a halo that makes the value the same to the bit; it reports no energies.

    Raises
    ------
    ValueError, TypeError
        An argument out of its range; the message says what was given and what is allowed.
    BackendUnavailable
        A backend or device that is not there.
    FloatingPointError
        Values that are no longer finite.
    Interrupted
        Ctrl-C during the iterations: a KeyboardInterrupt whose ``result`` holds the last whole iterate.
    MemoryError
        A job beyond `memory` or the device that cannot be cut into tiles, and why.

    Notes
    -----
    Minimises 1/p sum_u |grad_w f(u)|^p + 1/2 sum_u lam(u) |f(u) - f0(u)|^2 (eq. 19, 20), with the gradient norm
    smoothed by eps (eq. 15); for the edge norm the first term is 1/(2 p) sum_u sum_v |d_w(f)(u, v)|^p (eq. 30), each
    difference smoothed likewise. For p < 1 the energy is not convex: the result is a local minimum, and which one
    depends on the start (`initial`) and the solver. Nothing says how far it is from the lowest.

    Examples
    --------
    A step with two outliers, by total variation on a path:

    >>> import numpy as np, gpureg as gr
    >>> f0 = np.array([0, 0, 0.3, 0, 1, 1, 0.8, 1])
    >>> result = gr.regularize(f0, gr.GridGraph(8), p=1, lam=4, max_iter=2000, tol=1e-6, backend="numpy")
    >>> result.value.round(2)
    array([0.18, 0.18, 0.2 , 0.25, 0.78, 0.84, 0.84, 0.84], dtype=float32)
    >>> print(result.stop)
    The largest change in one iteration fell to the tolerance.
    """
    begin = time.perf_counter()
    graph = as_graph(graph, degrees=uses_degrees(gamma))
    method = resolve(solver)
    max_iter, tol, kind = as_run(method, max_iter, tol, dtype, callback, progress)
    if update_weights is not None:
        update_weights = integer("update_weights", update_weights, low=1)
        if not method.renews:
            raise ValueError(
                "update_weights needs a process such as solver='jacobi': 'certified' finds the minimum for weights "
                "that stay. Call again with weights=gpureg.weights.guided(weights, value), value one row per vertex"
            )
        if not isinstance(weights, Weights):
            raise ValueError(
                "update_weights needs a weight function to compute anew, such as gpureg.weights.bilateral(...), "
                f"got weights={'None' if weights is None else 'an array'}"
            )
    problem = Problem.make(
        f0,
        graph,
        p=p,
        lam=lam,
        weights=weights,
        gamma=gamma,
        norm=norm,
        coupled=coupled,
        eps=eps,
        dtype=kind,
        smoothed=method.smooths,
    )
    method.accept(problem)
    start = None if initial is None else as_function(graph, initial, "initial")
    if start is not None and start.shape != problem.f0.shape:
        raise ValueError(f"initial must have the shape of f0, {np.shape(f0)}, got {np.asarray(initial).shape}")
    device = backends.get(backend, kind)
    threshold = None if tol is None else tol * (problem.data_range or 1.0)
    tiles = tiles_of(problem, device, method, budget(device, memory), max_iter, tol, callback, update_weights)
    first = problem.f0 if start is None else start
    # Numbers out of the type's range are found by the loop, which says so in a sentence.
    with np.errstate(over="ignore", invalid="ignore"):
        if tiles is not None:
            return _in_tiles(
                problem, device, method, tiles, first, f0, max_iter, threshold, update_weights, progress, begin
            )
        with progress_bar(progress, max_iter) as report:
            on_device = DeviceProblem.put(problem, device)
            outcome = run(
                on_device,
                method,
                # a buffer of its own: the sweeps write over it
                on_device.put_function(first),
                max_iter=max_iter,
                tol=tol,
                callback=callback,
                report=report,
                update_weights=update_weights,
            )
    return result_of(outcome, f0, graph, begin)


def as_run(
    method: Solver,
    max_iter: int | None,
    tol: float | None,
    dtype: npt.DTypeLike | None,
    callback: Callback | None,
    progress: bool,
) -> tuple[int, float | None, np.dtype[Any]]:
    """Check how a run is done; iterations at most, tolerance and type, the solver's own where there is none."""
    if callback is not None and not callable(callback):
        raise TypeError(f"callback must be callable, got {callback!r}")
    flag("progress", progress)
    most = method.most if max_iter is None else max_iter
    tol = method.tol if tol is None else tol
    most = integer("max_iter", most, low=0)
    tol = None if tol is None else number("tol", tol, low=0)
    return most, tol, computed_type(dtype)


def result_of(outcome: Outcome, f0: npt.ArrayLike, graph: Graph | GridGraph, begin: float) -> Result:
    """What the caller gets of a run that began at this time; Interrupted if it was."""
    problem, course = outcome.problem, outcome.course
    # an interruption may fall after the last check
    gap = course.gaps[-1] if course.checks[-1:] == [outcome.iterations] else None
    result = Result(
        value=as_given(problem.get_function(outcome.f), f0, graph),
        iterations=outcome.iterations,
        stop=outcome.stop,
        energy=np.array(course.energies),
        checks=np.array(course.checks),
        gap=gap,
        error_bound=None if gap is None else math.sqrt(2 * gap / float(np.min(problem.problem.lam))),
        eps=problem.eps,
        method=outcome.method,
        backend=repr(problem.backend),
        seconds=time.perf_counter() - begin,
    )
    if outcome.stop is Stop.INTERRUPTED:
        raise Interrupted(result)
    return result


def tiles_of(
    problem: Problem,
    device: Backend,
    method: Solver,
    allowed: Budget,
    max_iter: int,
    tol: float | None,
    callback: Callback | None,
    update_weights: int | None,
) -> Tiling | None:
    """How to cut a job that does not fit, None for one that does."""
    m = problem.f0.shape[1]
    job = Job(
        channels=m,
        norms=0 if problem.p == 2 or problem.norm == "edge" else 1 if problem.coupled else m,
        weights=problem.weights,
        directed=not isinstance(problem.gamma, str),
        per_vertex=problem.lam.ndim > 0,
        keeps=method.keeps(problem),
    )
    need = job.need(problem.graph, device)
    if allowed.holds(need) or max_iter == 0:
        return None
    why = why_whole(problem, method, callback=callback is not None, update_weights=update_weights)
    if why is not None:
        if not allowed.asked and need.total <= device.device.memory and need.largest <= device.largest_buffer:
            return None
        raise MemoryError(
            f"the job needs {readable(need.total)} on {device.device.id}, {readable(need.largest)} of them in one "
            f"array; {readable(allowed.total)} are allowed. It cannot be cut into tiles: {why}"
        )
    assert isinstance(problem.graph, GridGraph)
    # a block ends at every check and wherever weights are computed anew
    most = min(max_iter, method.check_every if tol is not None else max_iter, update_weights or max_iter)
    return tiling(problem.graph, job, device, allowed, lambda n: halo(problem, n), work_of(problem), most)


def _in_tiles(
    problem: Problem,
    device: Backend,
    method: Solver,
    tiles: Tiling,
    first: FloatArray,
    f0: npt.ArrayLike,
    max_iter: int,
    threshold: float | None,
    update_weights: int | None,
    progress: bool,
    begin: float,
) -> Result:
    assert isinstance(method, Jacobi)
    blocks = -(-max_iter // tiles.sweeps)
    with progress_bar(progress, len(tiles.tiles) * blocks, "tiles") as report:
        outcome = run_in_tiles(
            problem,
            device,
            method,
            tiles,
            first,
            max_iter=max_iter,
            threshold=threshold,
            update_weights=update_weights,
            report=lambda done, of: report(done),
        )
    result = Result.bare(
        as_given(outcome.value, f0, problem.graph),
        iterations=outcome.iterations,
        stop=outcome.stop,
        eps=problem.eps,
        method=outcome.method,
        backend=repr(device),
        seconds=time.perf_counter() - begin,
    )
    if outcome.stop is Stop.INTERRUPTED:
        raise Interrupted(result)
    return result


def as_given(value: FloatArray, f0: npt.ArrayLike, graph: Graph | GridGraph) -> npt.NDArray[Any]:
    """A regularized function (n, m) in the shape of the data."""
    if isinstance(graph, GridGraph) and graph.mask is not None:
        # Vertices outside the mask come back as they came, NaN included.
        outside = ~graph.mask.ravel()
        value[outside] = np.asarray(f0).reshape(value.shape)[outside]
    return value.reshape(np.shape(f0))
