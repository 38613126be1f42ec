"""Regularize a function on a graph: :func:`regularize`."""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray
from ..backends import Backend, Chosen
from ..checks import flag, integer
from ..doors import door
from ..exchange import Lent
from ..graphs.accepted import GraphLike, as_graph
from ..model.memory import budget_of
from ..model.on_device import DeviceProblem
from ..model.problem import Norm, Problem, as_function, uses_degrees
from ..model.result import Interrupted, Result, Stop
from ..progress import progress_bar
from ..solvers import Solver, resolve, run
from ..solvers.loop import Callback, Outcome
from ..weights import Weights
from .by_channel import by_channel
from .lent import regularize_lent
from .lipschitz import is_limit, regularize_lipschitz
from .results import as_given, as_run, result_of, value_of
from .tiled import Cutting, run_in_tiles
from .tiling import Tiling


@door(lent=("f0",))
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
    backend: Chosen = "auto",
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
        channels. NaN and infinity are allowed only at vertices outside a grid's mask; such
        values do not change the result, except through patches that contain them (NaN counts as 0).
    graph : Graph or GridGraph
        The graph of n vertices; or a symmetric sparse matrix of weights of scipy, or a graph of networkx, whose loops
        are left out with a warning.
    p : float, default 2
        Degree of regularity > 0: 2 is Tikhonov, 1 total variation; near 0 the result is piecewise constant. Infinity,
        with norm="edge" and solver="certified", gives the absolutely minimal Lipschitz extension of pinned values.
    lam : float or array, default 1
        Fidelity >= 0, a number or one value per vertex. Larger values stay closer to the data; 0 means no data at a
        vertex, infinity pins it to the data.
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights`, or one value per stored directed edge. None: those of the graph, or 1.
    gamma : {"sqrt", "combinatorial", "normalized", "degree"} or array, default "sqrt"
        gamma(u, v) of eq. 4: sqrt(w), sqrt(w/2), sqrt(w/(2 deg u)), sqrt(w/deg u); or one value >= 0 per stored
        directed edge, symmetric or not, instead of any weights.
    norm : {"vertex", "edge"}, default "vertex"
        The smoothness: "vertex" is eq. 20, the gradient norm of a vertex raised to p (isotropic); "edge" is eq. 30,
        a sum over single edges (anisotropic). At p = 2 "edge" with lam is "vertex" with 2 lam.
    coupled : bool, default True
        Whether all m channels have one gradient norm (section 5.1), or each is regularized as if it were alone, with
        an `eps`, a tolerance and a stop of its own. Weights that depend on the data are computed from all channels.
    eps : float, optional
        Smoothing of the gradient norm (eq. 15), in the data's units. None: 1e-3 of the data's spread, or 0 if it is not
        needed, for p = 2 and with the certified solver. The spread is twice the range of the middle 90 percent of the
        values of a channel, about the range of noisy data, or half that of the middle 98 percent if this is larger; the
        largest over the channels counts. If both are 0, fewer values are left out, but one at each end; if only these
        differ, it is the standard deviation, and for constant data their absolute value.
    solver : str or Solver, default "jacobi"
        "jacobi" (eq. 25, 31), "euler" (eq. 24), "certified" (a minimiser, for p >= 1, with a bound on its energy above
        the minimum), or an object of :class:`gpureg.Jacobi`, :class:`gpureg.Euler` or :class:`gpureg.Certified`.
    max_iter : int, optional
        Maximal number of iterations. None: 100 with "jacobi" and "euler", 20 000 with "certified".
    tol : float, optional
        Tolerance of the stop test. "jacobi" and "euler" stop once the largest change in one iteration is at most this
        share of the data's spread (for a small lam the error can be far larger than the last change; ``stop`` of the
        solver object selects other tests), and make no test if None. "certified" stops once the duality gap is at most
        this share of the energy; None: 1e-4.
    update_weights : int, optional
        Compute the weights from the current iterate each time after this number of iterations, at least once before
        `tol` may end the run (footnote 1 of the paper: iterated bilateral filter and nonlocal means); `weights` must be
        an object of :mod:`gpureg.weights`. The energy is that of the current weights, and may jump. Not with
        "certified".
    initial : array, optional
        The initial iterate, in the shape of `f0`. None: `f0`.
    backend : str or sequence of str, default "auto"
        "auto", "numpy", "opencl", "warp", or a device such as "opencl:1". GPUREG_BACKEND overrides "auto". A list of
        devices, or "all" for all of the best kind, shares a job on a grid that can be cut into tiles; another job, or
        one whose halos would cost all the gain, runs on the first device.
    dtype : dtype, optional
        Type to compute in, float32 or float64. None: float32, but float64 for data with values so far beyond the others
        (10^18 times their spread) that float32 does not hold their squares.
    callback : callable, optional
        Called with a :class:`gpureg.Check` before the first iteration and at every check; returning True stops the run.
    progress : bool, default False
        Show a progress bar on the error stream of the terminal.
    memory : int, optional
        Bytes that the job may use on the device. None: half of a CPU's memory, 90 percent of what a GPU has free. The
        environment variable GPUREG_MEMORY, such as "4GiB", can reduce this limit.

    Returns
    -------
    Result
        The value, in the shape of `f0`, and information about the run. Its type is the one computed in, or float64 for
        data that need it (float64, integers of more than 16 bits); where lam is infinite it is the data, bit for bit.
        The data's offset and a power of two are taken out before computing and put back. A job on a grid that
        does not fit into memory is done in tiles, with a halo that gives the same value bit for bit, but no energies.

    Raises
    ------
    ValueError, TypeError
        An argument out of range; the message says what was given and what is allowed.
    BackendUnavailable
        A backend or device that is not available.
    FloatingPointError
        Values that are no longer finite.
    Interrupted
        Ctrl-C during the iterations: a KeyboardInterrupt whose ``result`` has the last complete iterate.
    MemoryError
        A job that exceeds `memory` or the device and cannot be cut into tiles; the message says why.

    Notes
    -----
    Minimises the energy (eq. 19, 20)::

        1/p sum_u |grad_w f(u)|^p + 1/2 sum_u lam(u) |f(u) - f0(u)|^2

    with the gradient norm smoothed by eps (eq. 15). For the edge norm the first term is
    1/(2 p) sum_u sum_v |d_w(f)(u, v)|^p (eq. 30), with smoothed differences. For p < 1 the energy is not convex: the
    result is a local minimum, which depends on `initial` and the solver, without a bound on the distance from the
    global minimum. p = infinity minimises the largest slope |d_w(f)(u, v)| for values with lam infinite, and lam 0 at
    all other vertices, then the largest of the other slopes, and so on, for each channel by itself; ``energy`` is the
    largest slope and ``gap`` how far it is above the least Lipschitz constant, `max_iter` counts linear systems.

    Examples
    --------
    A step with two outliers, by total variation on a path:

    >>> import numpy as np, gpureg as gr
    >>> f0 = np.array([0, 0, 0.3, 0, 1, 1, 0.8, 1])
    >>> result = gr.regularize(f0, gr.GridGraph(8), p=1, lam=4, max_iter=2000, tol=1e-6, backend="numpy")
    >>> result.value.round(2)
    array([0.17, 0.18, 0.2 , 0.25, 0.78, 0.84, 0.84, 0.84])
    >>> print(result.stop)
    The largest change in one iteration fell to the tolerance.
    """
    begin = time.perf_counter()
    graph = as_graph(graph, degrees=uses_degrees(gamma))
    method = resolve(solver)
    data: object = f0
    given: dict[str, Any] = {"p": p, "lam": lam, "weights": weights, "gamma": gamma, "norm": norm, "eps": eps}
    given |= {"coupled": coupled, "update_weights": update_weights, "initial": initial, "max_iter": max_iter}
    given |= {"tol": tol, "backend": backend, "callback": callback, "progress": progress, "memory": memory}
    if is_limit(p):
        host = data.to_host() if isinstance(data, Lent) else f0
        return regularize_lipschitz(host, graph, method, given | {"dtype": dtype})
    max_iter, tol, kind = as_run(method, max_iter, tol, dtype, callback, progress)
    if isinstance(data, Lent):
        given |= {"max_iter": max_iter, "tol": tol}
        direct = regularize_lent(data, graph, method, given | {"dtype": None if dtype is None else kind})
        if direct is not None:
            return direct
        f0 = data.to_host()
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
    if update_weights is None and not flag("coupled", coupled) and as_function(graph, f0, "f0").shape[1] > 1:
        model = {"p": p, "lam": lam, "gamma": gamma, "norm": norm, "eps": eps}
        how = {"solver": method, "max_iter": max_iter, "tol": tol, "dtype": dtype, "memory": memory}
        options = {**model, **how, "backend": backend, "progress": progress}
        found = by_channel(regularize, f0, graph, weights=weights, initial=initial, callback=callback, options=options)
        return replace(found, value=as_given(found.value, f0, graph))
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
        dtype=None if dtype is None else kind,
        smoothed=method.smooths,
        framed=True,
    )
    kind = problem.f0.dtype
    method.accept(problem)
    start = None if initial is None else as_function(graph, initial, "initial")
    if start is not None and start.shape != problem.f0.shape:
        raise ValueError(f"initial must have the shape of f0, {np.shape(f0)}, got {np.asarray(initial).shape}")
    devices = backends.several(backend, kind)
    threshold = None if tol is None else tol * problem.spread
    cutting = Cutting(problem, method, max_iter, tol, callback, update_weights)
    tiles = cutting.tiles(devices, budget_of(devices, memory))
    first = problem.f0 if start is None else problem.framed(start)
    # the loop reports overflow with a clear message
    with np.errstate(over="ignore", invalid="ignore"):
        if tiles is None:
            outcome, said = _whole(cutting, devices[0], first, progress)
            if outcome is not None:
                asked = None if update_weights is not None else problem.detached(f0)
                return result_of(outcome, value_of(outcome, f0, graph), begin, asked)
            devices[0].release()
            tiles = cutting.halved(devices[0], said)
        return _in_tiles(cutting, devices, tiles, first, f0, threshold, progress, begin)


def _whole(cutting: Cutting, device: Backend, first: FloatArray, progress: bool) -> tuple[Outcome | None, str]:
    """Run a job as a whole; None if the device has no memory for it, and what it says."""
    try:
        with progress_bar(progress, cutting.max_iter) as report:
            on_device = DeviceProblem.put(cutting.problem, device)
            return run(
                on_device,
                cutting.method,
                # a new buffer, because the sweeps overwrite it
                on_device.put_function(first),
                max_iter=cutting.max_iter,
                tol=cutting.tol,
                callback=cutting.callback,
                report=report,
                update_weights=cutting.update_weights,
            ), ""
    except MemoryError as error:
        if cutting.callback is not None:
            raise
        said = str(error) or type(error).__name__
    # only now has the error with its frames let go of the arrays; circles of them are found by the collector
    gc.collect()
    return None, said


def _in_tiles(
    cutting: Cutting,
    devices: Sequence[Backend],
    tiles: Tiling,
    first: FloatArray,
    f0: npt.ArrayLike,
    threshold: float | None,
    progress: bool,
    begin: float,
) -> Result:
    problem, blocks = cutting.problem, -(-cutting.max_iter // tiles.sweeps)
    with progress_bar(progress, len(tiles.tiles) * blocks, "tiles") as report:
        outcome = run_in_tiles(
            cutting, devices, tiles, first, threshold=threshold, report=lambda done, of: report(done)
        )
    result = Result.bare(
        as_given(problem.back(outcome.value), f0, problem.graph),
        iterations=outcome.iterations,
        stop=outcome.stop,
        eps=problem.eps * problem.frame.scale,
        method=outcome.method,
        backend=outcome.devices,
        seconds=time.perf_counter() - begin,
        problem=None if cutting.update_weights is not None else problem.detached(f0),
    )
    if outcome.stop is Stop.INTERRUPTED:
        raise Interrupted(result)
    return result
