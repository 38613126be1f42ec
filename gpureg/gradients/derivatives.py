"""Derivatives of any function of a result: :func:`derivatives`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..checks import integer, number
from ..doors import calling_back, door, warn
from ..exchange import as_came, on_host
from ..graphs.grid import AnyGraph, GridGraph
from ..model.problem import Problem, as_function
from ..model.result import Result
from ..weights import Weights
from .energy import HostEnergy
from .implicit import Minimised
from .parts import edges_as_given, joined, lam_as_given
from .unrolled import Damping, Swept

# A distance of the result from the minimiser, as a share of the data's spread, beyond which there is a warning.
_FAR = 1e-3


@dataclass(frozen=True, eq=False)
class Derivatives:
    """The derivatives of a number L with respect to what its function was computed from, in float64.

    Attributes
    ----------
    f0 : array
        With respect to the data, in their shape.
    lam : float or array
        With respect to the fidelity: a number if it was a number, otherwise one per vertex, (n,), on a grid of its
        shape. 0 where lam is infinite; where lam is 0, from above.
    weights : array or None
        With respect to the weights, as weights can be given: one per stored directed edge, (n_edges,), on a grid one
        per offset, ``(*shape, K)``, 0 where there is no edge. Both directions have half of the derivative, so that
        ``(weights * change).sum()`` is that of L for a symmetric change. None if gamma is an array.
    gamma : array or None
        With respect to gamma(u, v), in the form of `weights`, each direction by itself; None unless gamma is an array.
    p : float
        With respect to p, for a fixed eps.
    eps : float
        With respect to eps in the data's units, the one that was used: if None was given, it is the same as if this
        number had been. With coupled=False, for the same change in all channels.
    value : array
        The function at which the derivatives were taken, in the shape of the data: the minimiser, or the last sweep.
    distance : float
        The largest difference between `value` and the value of the result.
    notes : tuple of str
        What was assumed, and why a field is None, as sentences.
    """

    f0: npt.NDArray[Any]
    lam: float | npt.NDArray[Any]
    weights: npt.NDArray[Any] | None
    gamma: npt.NDArray[Any] | None
    p: float
    eps: float
    value: npt.NDArray[Any]
    distance: float
    notes: tuple[str, ...]

    # as arrays of the library of g
    _exchanged: ClassVar[tuple[str, ...]] = ("f0", "lam", "weights", "gamma", "value")


@door
def derivatives(
    result: Result,
    g: npt.ArrayLike | Callable[[Any], npt.ArrayLike],
    *,
    unrolled: int | None = None,
    damping: float | None = None,
    initial: npt.ArrayLike | None = None,
) -> Derivatives:
    """Compute the derivatives of any number L(value) with respect to data, fidelity, weights, p and eps.

    Parameters
    ----------
    result : Result
        A result of :func:`gpureg.regularize` or :func:`gpureg.regularization_path`.
    g : array or callable
        The gradient of L with respect to ``result.value``, in its shape; or a function that returns it for a value.
        The function is called with the exact minimiser (the last sweep), so that the result may be far from it.
    unrolled : int, optional
        Differentiate this number of plain Jacobi sweeps instead of the minimiser. The memory is that of as many
        functions.
    damping : float, optional
        With `unrolled`, the damping of the sweeps as in :class:`gpureg.Jacobi`. None: as it chooses.
    initial : array, optional
        With `unrolled`, the start of the sweeps, a constant. None: the data, which then count twice.

    Returns
    -------
    Derivatives

    Raises
    ------
    TypeError
        Something else than a result.
    ValueError
        A result that does not know its problem: of jobs with `update_weights`, with data that stay on a device, or of
        another function; a g of another shape; and without `unrolled`, p < 1, or p < 2 with eps = 0.
    ArithmeticError
        The minimiser was not found exactly enough, or the Hessian there is singular; the message says where.

    Warns
    -----
    RuntimeWarning
        The result is so far from the minimiser, or from the last sweep, that a g taken there is not the gradient;
        connected parts of the graph have no data.

    Notes
    -----
    Without `unrolled` these are the derivatives of the minimiser, by one system with the Hessian of the energy
    (docs/mathematics.md). They would be wrong, by a factor for p near 1, at a point that is not the minimiser.
    Therefore it is computed again, in float64 on the host, by Newton's method from ``result.value``.

    Where the sweeps converge and are many, the derivatives of both are the same. With few sweeps they differ, as the
    sweeps end elsewhere: then `unrolled` has those of what the sweeps compute, and the other ones those of the
    minimiser, whatever solver found the result. For p < 1, where minimisers are many and local, only sweeps have
    derivatives. For p > 2 the default damping 1/(p - 1) depends on p, which the derivative with respect to p includes.

    Weights of an object of :mod:`gpureg.weights` count as constants, also where they were computed from the data. They
    are computed again: a guide must still be as it was. In a connected part of the graph without data any constant is a
    minimiser: all derivatives through it count 0.

    Examples
    --------
    The derivative of the squared error with respect to lam, and a step against it:

    >>> import numpy as np, gpureg as gr
    >>> clean = np.array([0.0, 0, 0, 0, 1, 1, 1, 1])
    >>> f0 = clean + np.array([0.1, -0.1, 0.2, 0, -0.2, 0.1, 0, 0.1])
    >>> model = {"p": 1.5, "eps": 0.01, "solver": "certified", "tol": 1e-10, "dtype": float, "backend": "numpy"}
    >>> def error(lam):
    ...     return gr.regularize(f0, gr.GridGraph(8), lam=lam, **model)
    >>> result = error(8.0)
    >>> found = gr.derivatives(result, 2 * (result.value - clean))
    >>> change = ((error(8.001).value - clean) ** 2).sum() - ((error(7.999).value - clean) ** 2).sum()
    >>> bool(abs(found.lam - change / 0.002) < 1e-4 * abs(found.lam))
    True
    """
    if not isinstance(result, Result):
        raise TypeError(f"result must be a Result of gpureg.regularize, got {type(result).__name__}")
    sweeps = None if unrolled is None else integer("unrolled", unrolled, low=1)
    if sweeps is None and (damping is not None or initial is not None):
        raise ValueError("damping and initial belong to unrolled=K: the minimiser does not depend on them")
    if damping is not None:
        damping = number("damping", damping, above=0, high=1)
    problems = _problems(result, sweeps)
    graph, shape = problems[0].graph, np.shape(result.value)
    reached = as_function(graph, result.value, "result.value").astype(np.float64)
    start = None if initial is None else as_function(graph, initial, "initial").astype(np.float64)
    if start is not None and start.shape != reached.shape:
        raise ValueError(f"initial must have the {reached.shape[1]} channel(s) of the data, got {start.shape[1]}")
    energies = [HostEnergy.of(problem) for problem in problems]
    given: Any = None if callable(g) else _gradient(g, graph, reached.shape)
    found = [
        _found(energy, reached[:, own], None if start is None else start[:, own], sweeps, damping)
        for own, energy in zip(_channels(problems), energies, strict=True)
    ]
    value = np.concatenate([one.energy.on.problem.frame.back(one.f, np.dtype(np.float64)) for one in found], axis=1)
    inside = np.ones(len(value), bool)
    if isinstance(graph, GridGraph) and graph.mask is not None:
        inside = graph.mask.ravel()
        value = np.where(inside[:, None], value, np.reshape(result.value, value.shape))
    away = np.abs(value - reached)[inside]
    distance = float(away.max(initial=0))
    if callable(g):
        with calling_back():
            given = on_host(g(as_came(value.reshape(shape))), "g")
        given = _gradient(given, graph, reached.shape)
    elif distance > _FAR * max(problem.spread * problem.frame.scale for problem in problems):
        at = "the minimiser" if sweeps is None else f"the last of {sweeps} sweeps"
        warn(
            f"the result is up to {distance:.3g} away from {at}, where the derivatives are taken, and g was computed "
            "at the result. Give g as a function of the value, or a result with a smaller tol",
            RuntimeWarning,
        )
    parts = [
        one.derivatives(given[:, own]).in_units_of_the_data(one.energy)
        for own, one in zip(_channels(problems), found, strict=True)
    ]
    whole = joined(parts)
    notes = _notes(energies, sweeps)
    f0 = np.where(inside[:, None], whole.f0, given).reshape(shape)
    is_array = not isinstance(problems[0].gamma, str)
    edges = edges_as_given(energies[0], whole.edges)
    return Derivatives(
        f0,
        lam_as_given(problems[0], whole.lam),
        None if is_array else edges,
        edges if is_array else None,
        whole.p,
        whole.eps,
        value.reshape(shape),
        distance,
        notes,
    )


def _problems(result: Result, sweeps: int | None) -> Sequence[Problem]:
    """Return the problems of a result, one per gradient norm of all channels, or raise ValueError."""
    of = result.problem
    if of is None:
        raise ValueError(
            "this result does not know its problem: it is not of regularize or regularization_path, or it had "
            "update_weights, or its data stayed on a device, where numpy arrays are needed"
        )
    problems = of if isinstance(of, tuple) else (of,)
    for problem in problems:
        p, eps = problem.p, problem.eps
        if math.isinf(p):
            raise ValueError("p = inf has no derivatives here: its solutions are found through largest slopes")
        if sweeps is not None:
            if p != 2 and eps == 0:
                raise ValueError(f"sweeps with p = {p:g} have derivatives only for eps > 0: give regularize an eps")
            continue
        if p < 1:
            raise ValueError(
                f"below p = 1 (here {p:g}) minimisers are local and can jump: unrolled=K differentiates sweeps instead"
            )
        if p < 2 and eps == 0:
            raise ValueError(
                f"for p < 2 (here {p:g}) and eps = 0 the energy has no second derivatives where a gradient vanishes: "
                "give regularize an eps > 0 (solver='certified' computes with 0 unless one is given)"
            )
    return problems


def _gradient(g: npt.ArrayLike, graph: AnyGraph, shape: tuple[int, ...]) -> FloatArray:
    """Check a gradient, and return it as (n, m) in float64."""
    found = as_function(graph, g, "g").astype(np.float64)
    if found.shape != shape:
        raise ValueError(f"g must have the {shape[1]} channel(s) of result.value, got {found.shape[1]}")
    return found


def _channels(problems: Sequence[Problem]) -> list[slice]:
    """Return the channels of each problem."""
    ends = np.cumsum([0, *(problem.f0.shape[1] for problem in problems)]).tolist()
    return [slice(begin, end) for begin, end in itertools.pairwise(ends)]


def _found(
    energy: HostEnergy, reached: FloatArray, start: FloatArray | None, sweeps: int | None, damping: float | None
) -> Minimised | Swept:
    """Find where the derivatives are taken; `reached` and `start`, (n, m), are in the units of the data."""
    frame, exact = energy.on.problem.frame, np.dtype(np.float64)
    if sweeps is None:
        return Minimised.of(energy, frame.into(reached, exact))
    first = None if start is None else frame.into(start, exact)
    return Swept.of(energy, first, sweeps, Damping.of(energy, damping))


def _notes(energies: Sequence[HostEnergy], sweeps: int | None) -> tuple[str, ...]:
    """Return what was assumed, as sentences, and warn of parts without data."""
    problem, notes = energies[0].on.problem, []
    if not isinstance(problem.gamma, str):
        notes.append("There are no weights: gamma was given as an array.")
    if isinstance(problem.weights, Weights):
        notes.append("The weights count as constants, also where they depend on the data.")
    lonely = int(energies[0].without_data.sum())
    if lonely and sweeps is None:
        sentence = (
            f"{lonely} vertices are in connected parts of the graph without data, where any constant is a minimiser: "
            "derivatives through it count 0"
        )
        warn(sentence, RuntimeWarning)
        notes.append(f"{sentence}.")
    return tuple(notes)
