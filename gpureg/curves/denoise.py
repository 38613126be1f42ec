"""Denoise polygonal curves: :func:`denoise_curve` (section 5.3, figure 5)."""

from __future__ import annotations

import functools
import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, checked_flags
from ..backends import BackendUnavailable
from ..checks import flag
from ..doors import door, outside, part_of
from ..graphs.csr import Graph
from ..model.result import Result
from ..regularization.denoised import Denoised, check_numbers, checked_fidelity
from ..regularization.options import RUN, Run
from ..regularization.regularize import regularize
from ..solvers import Certified, Solver
from ..weights import Weights
from .chain import Chain
from .cleaning import Cleaned, Found
from .crossings import crossings_of, expect_plane, without_crossings
from .curves import Curves, curves_of
from .fidelity import fitted


@dataclass(frozen=True, eq=False, kw_only=True)
class CurveDenoising(Denoised[tuple[float, ...]]):
    """The result of denoising curves: see :class:`Denoised`; arrays have the vertices of one curve after another.

    Attributes
    ----------
    filter : {"positions"}
    sigma : tuple of float
        Noise of each curve: given, or estimated; the median over its vertices.
    lam : tuple of float, or (n,) array
        Fidelity of each curve, the median over the vertices that can move; one per vertex if `lam` was an array.
    curves : Curves
        The input curves.
    found : tuple of Found
        The outliers, gaps and repeated vertices of each curve; nothing if `lam` was given.
    crossings : (int, int) or None
        Pairs of segments that meet without a common end, before and after; None for curves that are not in the plane.
    shortened : int
        Number of vertices whose displacement was made shorter because of ``valid=True``.
    """

    WHAT: ClassVar[Mapping[str, str]] = {"positions": "positions of the vertices"}

    curves: Curves
    found: tuple[Found, ...] = ()
    crossings: tuple[int, int] | None = None
    shortened: int = 0

    @property
    def points(self) -> list[FloatArray]:
        """The denoised curves, (n, d) each, without repeated vertices."""
        return self.curves.split(self.value)

    def _parameters(self) -> str:
        middle = " in the middle" if len(set(np.asarray(self.lam).tolist())) > 1 else ""
        return f"p = {self.p:g}, lam = {np.median(self.lam):.4g}{middle}"


def denoised(
    points: npt.ArrayLike | Sequence[npt.ArrayLike] | Curves,
    *,
    closed: bool | None = None,
    p: float = 2.0,
    lam: float | npt.ArrayLike | None = None,
    sigma: float | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    fixed: npt.ArrayLike | None = None,
    keep_ends: bool = True,
    valid: bool = False,
    norm: Literal["vertex", "edge"] = "vertex",
    eps: float | None = None,
    solver: str | Solver | None = None,
    max_iter: int | None = None,
    tol: float | None = None,
    **options: Unpack[Run],
) -> CurveDenoising:
    """Denoise curves and return a full report; the parameters and errors are those of :func:`denoise_curve`."""
    begin = time.perf_counter()
    curves = curves_of(points, closed)
    check_numbers({"eps": eps, "tol": tol}, p=p, sigma=sigma, max_iter=max_iter)
    n = sum(map(len, curves.points))
    given = None if lam is None else checked_fidelity(lam, n)
    held = np.zeros(n, bool) if fixed is None else checked_flags("fixed", fixed, n).copy()
    task = _Task.of(curves, given, sigma, float(p), held, flag("keep_ends", keep_ends), _is_array(weights))
    results: tuple[Result, ...] = ()
    moved = task.f0
    if not np.isinf(task.fidelity).all():
        initial = None
        if solver is None:
            exact = p >= 1 and task.fidelity.min() > 0
            solver = Certified(tol=1e-6) if exact else "jacobi"
            max_iter = 1000 if max_iter is None and not exact else max_iter
            initial = task.minimiser if weights is None else None
        # one number if all are equal: the fastest kernels and direct solvers need that
        same = (task.fidelity == task.fidelity[0]).all()
        run = functools.partial(
            regularize, task.f0, task.graph, p=p, lam=float(task.fidelity[0]) if same else task.fidelity,
            weights=weights, norm=norm, eps=eps, solver=solver, max_iter=max_iter, tol=tol, initial=initial,
        )  # fmt: skip
        result = _in_double(run, options) if initial is not None else run(**options)
        results = (result,)
        # pinned vertices are returned unchanged, bit for bit
        moved = np.where(np.isinf(task.fidelity)[:, None], task.f0, result.value)
    together = np.concatenate(curves.points)
    moves, shortened = task.displacements(moved), 0
    if flag("valid", valid):
        expect_plane(curves.points)
        moves, shortened = without_crossings(together, moves, [len(x) for x in curves.points], curves.closed)
    value = together + moves
    return CurveDenoising(
        value=value,
        filter="positions",
        sigma=task.sigma,
        estimated=sigma is None,
        p=float(p),
        lam=given if isinstance(given, np.ndarray) else task.lam,
        results=results,
        displacement=np.linalg.norm(value - together, axis=1),
        seconds=time.perf_counter() - begin,
        curves=curves,
        found=task.found,
        crossings=crossings_of(curves.points, curves.split(value), curves.closed),
        shortened=shortened,
    )


def _in_double(run: Callable[..., Result], options: Run) -> Result:
    """Run from the minimiser, which float64 proves to be one at once, if the device has float64."""
    if options.get("dtype") is not None:
        return run(**options)
    try:
        return run(**{**options, "dtype": np.float64})
    except BackendUnavailable:
        return run(**options)


def _is_array(weights: Any) -> bool:
    return weights is not None and not isinstance(weights, Weights)


@dataclass(frozen=True, eq=False)
class _Task:
    """What to regularize: the vertices of all curves without repeats and outliers, cut at their gaps.

    Attributes
    ----------
    cleaned : list of Cleaned
    orders : list of (k,) int arrays
        The order of the vertices of each curve in the graph: indices in ``Cleaned.alive``.
    graph : Graph
    f0 : (m, d) array
        Their positions, each curve about its mean.
    fidelity : (m,) array
        Infinite where a vertex is pinned.
    lam : tuple of float
        The fidelity of each curve.
    minimiser : (m, d) array or None
        The result for p = 2, if it is known.
    """

    cleaned: list[Cleaned]
    orders: list[IntArray]
    graph: Graph
    f0: FloatArray
    fidelity: FloatArray
    lam: tuple[float, ...]
    minimiser: FloatArray | None

    @classmethod
    def of(
        cls,
        curves: Curves,
        lam: float | FloatArray | None,
        sigma: float | None,
        p: float,
        held: npt.NDArray[np.bool_],
        keep_ends: bool,
        whole: bool,
    ) -> _Task:
        """Find the task.

        Parameters
        ----------
        curves : Curves
        lam : float or (n,) array, optional
            The caller's fidelity: the curves stay as they are.
        sigma : float, optional
        p : float
        held : (n,) bool array
            Vertices that do not move.
        keep_ends : bool
        whole : bool
            Whether the curves stay as they are also without `lam`.
        """
        fixed = curves.split(held)
        robust = lam is None and not whole
        cleaned = [
            Cleaned(x, shut, still, sigma, robust)
            for x, shut, still in zip(curves.points, curves.closed, fixed, strict=True)
        ]
        pinned = []
        for curve, still, shut in zip(cleaned, fixed, curves.closed, strict=True):
            pins = np.zeros(len(curve.merged), bool)
            np.logical_or.at(pins, curve.of, still)
            if keep_ends and not shut:
                pins[[0, -1]] = True
            pinned.append(pins)
        minimiser: FloatArray | None = None
        if lam is None:
            fits = fitted(cleaned, pinned, p)
            each = [fit.lam for fit in fits]
            free = [np.median(fit[np.isfinite(fit)]) if np.isfinite(fit).any() else math.inf for fit in each]
            known = tuple(float(x) for x in free)
        else:
            each = curves.split(lam.copy()) if isinstance(lam, np.ndarray) else [np.full(len(x), lam) for x in curves.points]
            known = () if isinstance(lam, np.ndarray) else (lam,) * len(each)
            each = [np.where(pins, math.inf, x) for x, pins in zip(each, pinned, strict=True)]
        parts = [curve.pieces() for curve in cleaned]
        orders = [order for order, *_ in parts]
        chain = Chain(np.concatenate([part[1] for part in parts]), np.concatenate([part[2] for part in parts]))
        f0 = np.concatenate([_centred(c.points, c.points)[order] for c, order in zip(cleaned, orders, strict=True)])
        if lam is None and p == 2:
            minimiser = np.concatenate(
                [_centred(fit.u, c.points)[order] for fit, c, order in zip(fits, cleaned, orders, strict=True)]
            )
        fidelity = np.concatenate([x[order] for x, order in zip(each, orders, strict=True)])
        return cls(cleaned, orders, chain.graph(f0), f0, fidelity, known, minimiser)

    @property
    def sigma(self) -> tuple[float, ...]:
        """The noise of each curve."""
        return tuple(float(np.median(curve.sigma)) for curve in self.cleaned)

    @property
    def found(self) -> tuple[Found, ...]:
        """What was found in each curve."""
        return tuple(curve.found() for curve in self.cleaned)

    def displacements(self, value: FloatArray) -> FloatArray:
        """Compute the displacement of each vertex of the input, (n, d), from new positions (m, d) in the graph."""
        moves, begin = [], 0
        for curve, order in zip(self.cleaned, self.orders, strict=True):
            mine = slice(begin, begin + len(order))
            begin += len(order)
            moved = np.empty_like(value[mine])
            # exactly 0 for a vertex that is pinned, or if nothing was done
            moved[order] = value[mine] - self.f0[mine]
            new = curve.points + moved
            step = curve.filled(new) - curve.merged
            step[curve.alive] = moved
            moves.append(step[curve.of])
        return np.concatenate(moves)


def _centred(x: FloatArray, by: FloatArray) -> FloatArray:
    centred: FloatArray = x - by.mean(axis=0)
    return centred


@door(options=RUN)
@part_of(denoised)
def denoise_curve(found: CurveDenoising) -> Any:
    """Denoise polygonal curves; without parameters it estimates the noise of each curve.

    Parameters
    ----------
    points : (n, d) array, or a list of (n, d) arrays
        The vertices in order, in any dimension. A list, such as the outlines of ``skimage.measure.find_contours``, is
        regularized as one graph, with the noise of each curve.
    closed : bool, optional
        Whether the last vertex is joined to the first. None: decided for each curve. A curve is closed if the first
        vertex is repeated at the end (to 1e-6 of the mean segment), or if the distance of the ends is at most twice the
        95 % quantile of the segments' lengths. A repeated vertex is removed, and added again to the result.
    p : float, default 2
        Degree of regularity > 0. With 1 vertices gather at points joined by straight lines; < 1 simplifies the curve.
    lam : float or (n,) array, optional
        Fidelity >= 0, a number or one per vertex (of one curve after another). Larger values stay closer to the data;
        infinity pins. 0 is Laplacian smoothing, which shrinks the curve (figure 5), and needs `max_iter`. None:
        computed from the noise, see Notes.
    sigma : float, optional
        Standard deviation of the noise of each coordinate. None: estimated for each curve from second differences; 0
        for curves of fewer than 12 vertices.
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights` on the graph of the curves, or one value per directed edge. None: 1.
    fixed : (n,) bool array, optional
        Vertices, of one curve after another, whose position does not change.
    keep_ends : bool, default True
        Whether to fix the ends of open curves.
    solver : str or Solver, optional
        None: ``gpureg.Certified(tol=1e-6)``, the minimiser, for p >= 1 and lam > 0; otherwise "jacobi".
    norm, eps, max_iter, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`. If "jacobi" is the default solver, the default of `max_iter` is 1000.

    Returns
    -------
    array like `points`, or a list of arrays

    Raises
    ------
    TypeError, ValueError
        Not a curve; arguments out of range.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    Minimises the energy of :func:`gpureg.regularize` for the positions. At p = 2 and w = 1 this multiplies the curve's
    Fourier coefficients (open curves: cosine coefficients) by h = lam / (lam + 2 mu), with mu = 2 - 2 cos of their
    frequency. The default lam, one of ten per decade, minimises Stein's unbiased estimate of the error::

        sum (1 - h)^2 |F|^2 + 2 sigma^2 d sum h

    For another p it is that lam times G^(p - 2), with G the root mean square of the gradient norm of that result, so
    that both smooth equally where the gradient is G.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    >>> circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    >>> noisy = circle + np.random.default_rng(0).normal(0, 0.05, circle.shape)
    >>> clean = gr.denoise_curve(noisy, backend="numpy")
    >>> bool(np.abs(clean - circle).mean() < 0.4 * np.abs(noisy - circle).mean())
    True
    """
    return found.curves.as_came(found.points)
