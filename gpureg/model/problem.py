"""The variational problem, with checked arguments."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, all_finite, computed_type, unmasked
from ..backends import Smoothness
from ..checks import choice, flag, number
from ..frame import AS_GIVEN, Frame, spread
from ..graphs.csr import Graph
from ..graphs.edges import check_weights, opposite_edges
from ..graphs.grid import AnyGraph, GridGraph
from ..weights import Weights

Gamma = Literal["sqrt", "combinatorial", "normalized", "degree"]
GAMMAS: tuple[Gamma, ...] = ("sqrt", "combinatorial", "normalized", "degree")
Norm = Literal["vertex", "edge"]
NORMS: tuple[Norm, ...] = ("vertex", "edge")

# The default eps, as a share of the data's spread (eq. 15).
RELATIVE_EPS = 1e-3

# The largest values, in units of a frame, of which float32 holds the squares, and sums of them.
SQUARES = 2.0**60


def as_function(graph: AnyGraph, values: npt.ArrayLike, name: str) -> FloatArray:
    """Check a function on the vertices; return it as floats, (n, m), as a view if possible.

    Outside the mask of a grid values need not be finite; those that are not become 0.
    """
    array = unmasked(values, name)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{name} must hold real numbers, got {array.dtype}")
    n = graph.n_vertices
    shape = graph.shape if isinstance(graph, GridGraph) else (n,)
    if array.shape[: len(shape)] == shape and array.ndim - len(shape) in (0, 1):
        flat = array.reshape(n, -1) if array.size else array
    elif array.ndim in (1, 2) and len(array) == n:
        flat = array.reshape(n, -1) if array.size else array
    else:
        allowed = f"({n},) or ({n}, m)"
        if isinstance(graph, GridGraph):
            allowed += f", {shape} or ({', '.join(map(str, shape))}, m)"
        raise ValueError(f"{name} must have shape {allowed}, got {array.shape}")
    if flat.ndim != 2 or flat.shape[1] == 0:
        raise ValueError(f"{name} must have one or more channels, got shape {array.shape}")
    wide = flat.dtype.itemsize > (4 if flat.dtype.kind == "f" else 2)
    flat = flat.astype(np.float64 if wide else np.float32, copy=False)
    if all_finite(flat):
        return flat
    bad = ~np.isfinite(flat)
    if isinstance(graph, GridGraph) and graph.mask is not None:
        outside = ~graph.mask.reshape(-1, 1)
        flat = np.where(bad & outside, flat.dtype.type(0), flat)
        bad &= ~outside
    if bad.any():
        raise ValueError(
            f"{name} must be finite, got {flat[bad][0]} at {int(bad.sum())} place(s); "
            "on a grid, a mask can leave such vertices out"
        )
    return flat


def lam_numbers(lam: float | npt.ArrayLike) -> npt.NDArray[Any]:
    """Check that a fidelity is a number or numbers; return an array, () or of its shape."""
    array = np.asarray(lam)
    if array.ndim == 0:
        number("lam", array.item(), finite=False)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"lam must be a real number or an array of them, got {array.dtype}")
    return array


def as_lam(graph: AnyGraph, lam: float | npt.ArrayLike) -> FloatArray:
    """Check the fidelity; return float64, () for a number, (n, 1) for one value per vertex."""
    array = lam_numbers(lam)
    shape = graph.shape if isinstance(graph, GridGraph) else (graph.n_vertices,)
    if array.shape not in ((), (graph.n_vertices,), shape):
        raise ValueError(f"lam must be a number or one value per vertex, shape {shape}, got shape {array.shape}")
    if np.isnan(array).any() or (array.size and array.min() < 0):
        worst = array.min()
        raise ValueError(f"lam must be >= 0 (0: no data there, infinity: pinned), got {worst}")
    return array.astype(np.float64) if array.ndim == 0 else array.reshape(-1, 1).astype(np.float64)


def uses_degrees(gamma: object) -> bool:
    """Return whether a gamma is divided by the degrees of the vertices, in which a loop would count."""
    return isinstance(gamma, str) and gamma in ("normalized", "degree")


def as_gamma(graph: AnyGraph, gamma: str | npt.ArrayLike) -> Gamma | FloatArray:
    """Check a gamma; return its name, or one value per directed edge in the form of ``Backend.put_edges``."""
    if isinstance(gamma, str):
        return choice("gamma", gamma, GAMMAS)
    array = unmasked(gamma, "gamma")
    if array.dtype.kind not in "iuf" or array.ndim == 0:
        raise TypeError(f"gamma must be a name, {', '.join(GAMMAS)}, or one number per directed edge, got {gamma!r}")
    if isinstance(graph, GridGraph):
        array = graph.edges.listed(array, "gamma")
    elif array.shape != (graph.n_edges,):
        raise ValueError(f"gamma must have shape ({graph.n_edges},), one per stored directed edge, got {array.shape}")
    values: FloatArray = array.astype(np.float64)
    if not np.isfinite(values).all() or (values.size and values.min() < 0):
        bad = values[~(np.isfinite(values) & (values >= 0))][0]
        raise ValueError(f"gamma must be finite and >= 0, got {bad}")
    return graph.edges.scatter(values[:, None]) if isinstance(graph, GridGraph) else values[:, None]


def as_weights(graph: AnyGraph, weights: Weights | npt.ArrayLike | None) -> Weights | FloatArray | None:
    """Check weights; return a weight function for this graph, or values in the form of ``Backend.prepare``."""
    if weights is None or isinstance(weights, Weights):
        return None if weights is None else weights.on(graph)
    if np.asarray(weights).dtype.kind not in "biuf":
        raise TypeError(f"weights must be an object of gpureg.weights or an array of numbers, got {weights!r}")
    if isinstance(graph, GridGraph):
        return graph.edges.scatter_half(weights)
    given = check_weights(weights, (graph.n_edges,), "one per stored directed edge")
    if not np.array_equal(given, given[opposite_edges(graph.indptr, graph.indices)]):
        Graph(graph.indptr, graph.indices, given)  # says which edge has two weights
    return given


@dataclass(frozen=True, eq=False)
class Problem:
    """The problem of minimising R_eps(f) + 1/2 sum_u lam(u) |f(u) - f0(u)|^2 over f, with checked arguments.

    Parameters
    ----------
    graph : Graph or GridGraph
    f0 : (n, m) float array
        The data, in units of the frame.
    p : float
        Degree of regularity > 0.
    lam : () or (n, 1) float64 array
        Fidelity >= 0, a number or one value per vertex; an array is infinite outside a grid's mask.
    weights : Weights, array or None
        None: those of the graph.
    gamma : {"sqrt", "combinatorial", "normalized", "degree"} or array
        A name, or one value per directed edge in the form of ``Backend.put_edges``; then there are no weights.
    norm : {"vertex", "edge"}
        The smoothness of eq. 20, or of eq. 30.
    coupled : bool
        Whether all channels have one gradient norm, or one each.
    eps : float
        Smoothing of the gradient norm, eq. 15, in units of the frame.
    frame : Frame
        The units of f0, lam, weights and eps; by default those of the data.
    data : (n, m) float array, optional
        The data as they were given; None means f0.
    """

    graph: AnyGraph
    f0: FloatArray
    p: float
    lam: FloatArray
    weights: Weights | FloatArray | None
    gamma: Gamma | FloatArray
    norm: Norm
    coupled: bool
    eps: float
    frame: Frame = AS_GIVEN
    data: FloatArray | None = None

    @classmethod
    def make(
        cls,
        f0: npt.ArrayLike,
        graph: AnyGraph,
        *,
        p: float = 2.0,
        lam: float | npt.ArrayLike = 1.0,
        weights: Weights | npt.ArrayLike | None = None,
        gamma: str | npt.ArrayLike = "sqrt",
        norm: Norm = "vertex",
        coupled: bool = True,
        eps: float | None = None,
        dtype: np.dtype[Any] | None,
        smoothed: bool = True,
        framed: bool | Frame = False,
    ) -> Problem:
        """Check the caller's arguments; a ValueError or TypeError says what is wrong.

        If not `smoothed`, the solver does not need eps, and its default is 0. If `framed`, the problem is in the units
        of a frame, in which float32 is enough for data of any offset and scale; a dtype of None is then float64 for
        data with values so far beyond the others that float32 does not hold their squares, otherwise float32. A given
        frame is used, so that a part of the data is computed with as the whole.
        """
        data = as_function(graph, f0, "f0")
        p = number("p", p, above=0)
        edge_factor = as_gamma(graph, gamma)
        if not isinstance(edge_factor, str) and weights is not None:
            raise ValueError("gamma as an array is used instead of the weights: leave weights=None")
        choice("norm", norm, NORMS)
        coupled = flag("coupled", coupled)
        fidelity = as_pinned(graph, as_lam(graph, lam))
        problem = cls(
            graph,
            data,
            p,
            fidelity,
            as_weights(graph, weights),
            edge_factor,
            norm,
            coupled,
            _given_eps(eps, p, known_rows(graph, data, fidelity), smoothed),
        )
        if framed:
            problem = problem._in_a_frame(dtype, framed if isinstance(framed, Frame) else None)
            dtype = problem.f0.dtype
        problem._check_eps(computed_type(dtype), smoothed)
        return problem

    def _in_a_frame(self, dtype: np.dtype[Any] | None, given: Frame | None = None) -> Problem:
        """Return the problem in the units of a frame, with data of this type."""
        # with a factor per vertex, or any gamma that is not symmetric, a constant has a gradient
        symmetric = isinstance(self.gamma, str) and not uses_degrees(self.gamma)
        frame = given or Frame.of(known_rows(self.graph, self.f0, self.lam), centred=symmetric)
        weights = self.weights
        if isinstance(weights, Weights):
            weights = weights.scaled(frame.scale)
            if weights is None:
                frame, weights = AS_GIVEN, self.weights
        if dtype is None:
            dtype = real_type(frame, self.f0)
        return replace(
            self,
            f0=self._in(frame, dtype),
            lam=frame.lam(self.lam, self.p),
            weights=weights,
            eps=self.eps / frame.scale,
            frame=frame,
            data=self.f0,
        )

    def _in(self, frame: Frame, dtype: np.dtype[Any]) -> FloatArray:
        """Return the data in the units of a frame, of this type."""
        return frame.into(self.f0, dtype)

    def _check_eps(self, dtype: np.dtype[Any], smoothed: bool) -> None:
        p, eps, limits = self.p, self.eps, np.finfo(dtype)
        if p >= 2 or not (smoothed or eps > 0):
            return
        # (g2 + eps^2)^((p - 2)/2) must be finite where the data is flat, and so must sums of a few thousand of them
        if eps == 0 or eps**2 < limits.tiny or (p - 2) * math.log(eps) > math.log(float(limits.max)) - 12:
            raise ValueError(
                f"eps = {eps * self.frame.scale:g} is too small for p = {p:g} in {dtype}: 1/eps^(2-p) must be finite. "
                "Use a larger eps (None picks 1e-3 of the data's spread), or float64"
            )

    def framed(self, f: FloatArray) -> FloatArray:
        """Return a function in the data's units, (n, m), in those of the frame."""
        return self.frame.into(f, self.f0.dtype)

    def back(self, f: FloatArray) -> FloatArray:
        """Return a function in the units of the frame, (n, m), in those of the data, a new array.

        It has the data's type if that is wider. Where lam is infinite it has the data, bit for bit.
        """
        data = self.f0 if self.data is None else self.data
        value = self.frame.back(f, np.promote_types(f.dtype, data.dtype))
        pinned = np.isinf(self.lam)
        if pinned.any():
            value = data.astype(value.dtype) if pinned.ndim == 0 else np.where(pinned, data, value)
        return value

    def detached(self, given: npt.ArrayLike) -> Problem:
        """Return the problem with copies of data that share memory with an array of the caller, who may change it."""
        array = np.asarray(given)
        own = {
            name: values.copy()
            for name, values in (("f0", self.f0), ("data", self.data))
            if values is not None and np.may_share_memory(values, array)
        }
        return replace(self, **own) if own else self  # type: ignore[arg-type]

    @property
    def smoothness(self) -> Smoothness:
        """The settings of the model for the backends, apart from the weights."""
        return Smoothness(self.p, self.eps, self.coupled, self.norm == "edge")

    @property
    def spread(self) -> float:
        """The spread of the data (:func:`gpureg.frame.spread`) where there are any; 1 for constant data."""
        return spread(known_rows(self.graph, self.f0, self.lam)) or 1.0


def real_type(frame: Frame, values: npt.NDArray[Any], units: Sequence[float] = ()) -> np.dtype[Any]:
    """Return the type to compute in for data (n, m), divided by units, in a frame: that which holds their squares."""
    if values.dtype.kind in "iu" and values.dtype.itemsize <= 2 and frame.scale * min(units, default=1.0) > 2.0**-40:
        return np.dtype(np.float32)
    reach = frame.reach(values / np.asarray(units)) if len(units) else frame.reach(values)
    return np.dtype(np.float64 if reach > SQUARES else np.float32)


def known_rows(graph: AnyGraph, f: FloatArray, lam: FloatArray) -> FloatArray:
    """Return the rows of a function, (n, m), at vertices inside the mask with a fidelity > 0; if it is 0, at all."""
    known = np.ones(1, bool) if lam.ndim == 0 else lam[:, 0] > 0
    if isinstance(graph, GridGraph) and graph.mask is not None:
        # lam is infinite outside the mask
        inside = graph.mask.ravel()
        known = known & inside if (known & inside).any() else inside
    return f if known.all() or not known.any() else f[known]


def as_pinned(graph: AnyGraph, lam: FloatArray) -> FloatArray:
    """Make a fidelity per vertex infinite outside the mask, where values do not change."""
    if lam.ndim == 0 or not isinstance(graph, GridGraph) or graph.mask is None:
        return lam
    return np.where(graph.mask.reshape(-1, 1), lam, np.inf)


def default_eps(f0: FloatArray, p: float) -> float:
    """Return the default smoothing: 1e-3 of the spread of the data, (n, m), or 0 for p = 2, which does not use it.

    The spread is that of :func:`gpureg.frame.spread`. For constant data it is their absolute value, or 1.
    """
    if p == 2:
        return 0.0
    return RELATIVE_EPS * (spread(f0) or (abs(float(f0.flat[0])) if f0.size else 0.0) or 1.0)


def _given_eps(eps: float | None, p: float, f0: FloatArray, smoothed: bool) -> float:
    if eps is None:
        return default_eps(f0, p) if smoothed else 0.0
    return number("eps", eps, low=0)
