"""Denoise polygonal curves: :func:`denoise_curve` (section 5.3, figure 5)."""

from __future__ import annotations

import functools
import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, checked_flags
from ..backends import BackendUnavailable
from ..checks import flag
from ..doors import door, outside, part_of
from ..model.result import Result
from ..regularization.denoised import Denoised, check_numbers, checked_fidelity
from ..regularization.options import RUN, Run
from ..regularization.regularize import regularize
from ..solvers import Certified, Solver
from ..weights import Weights
from .cleaning import Found
from .crossings import Crossings, crossed, crossings_of, expect_plane, without_crossings
from .curves import Curves, curves_of
from .noise import TELLING, blurred_axis
from .task import Task


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
    crossings : Crossings or None
        Pairs of segments that meet without a common end, before and after; None for curves that are not in the plane.
    shortened : int
        Number of vertices whose displacement was made shorter because of ``valid=True``.
    """

    WHAT: ClassVar[Mapping[str, str]] = {"positions": "positions of the vertices"}

    curves: Curves
    found: tuple[Found, ...] = ()
    crossings: Crossings | None = None
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
    still = np.zeros(n, bool) if fixed is None else checked_flags("fixed", fixed, n)
    task = Task.of(curves, given, sigma, float(p), still, flag("keep_ends", keep_ends), _is_array(weights))
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
        held = float(task.fidelity[0]) if same else task.fidelity
        # the energy of f / unit with lam unit^(2 - p) is that of f: squares must stay in the range of float32
        unit = _unit(task.f0)
        run = functools.partial(
            regularize, task.f0 / unit, task.graph, p=p, lam=held if p == 2 else held * unit ** (2 - p),
            weights=weights, norm=norm, eps=None if eps is None else eps / unit, solver=solver, max_iter=max_iter,
            tol=tol, initial=None if initial is None else initial / unit,
        )  # fmt: skip
        result = _in_double(run, options) if initial is not None else run(**options)
        results = (result,)
        # pinned vertices are returned unchanged, bit for bit
        moved = np.where(np.isinf(task.fidelity)[:, None], task.f0, result.value * unit)
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
        found=task.found if lam is None else tuple(replace(one, few=False) for one in task.found),
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


def _unit(f: FloatArray) -> float:
    """Return 1, or a power of two near the size of `f` if squares of float32 could overflow or vanish."""
    size = float(np.abs(f).max())
    return 1.0 if size == 0 or 1e-6 < size < 1e9 else 2.0 ** round(math.log2(size))


def _is_array(weights: Any) -> bool:
    return weights is not None and not isinstance(weights, Weights)


def warnings_of(found: CurveDenoising) -> list[str]:
    """List in sentences what a user must know of the result."""
    told = list(found.curves.left)
    for k, one in enumerate(found.found):
        which = f"curve {k}" if found.curves.several else "the curve"
        if len(one.outliers):
            numbers = ", ".join(map(str, one.outliers[:5].tolist())) + (", ..." if len(one.outliers) > 5 else "")
            count = f"{len(one.outliers)} vertices are outliers" if len(one.outliers) > 1 else "1 vertex is an outlier"
            told.append(
                f"{which}: {count} ({numbers}): left out, and put between the neighbours; lam= keeps every vertex"
            )
        if one.opened:
            told.append(
                f"{which} is closed as given, but its ends are {found.curves.ends[k].gap:.3g} apart, far more than "
                "other vertices: it was not smoothed across them"
            )
    told += _not_told(found)
    told += crossed(found.crossings)
    if found.shortened:
        told.append(f"{found.shortened} vertices moved less than they would, so that the result does not cross itself")
    return told


def _not_told(found: CurveDenoising) -> list[str]:
    """Say which curves are too short to tell their noise, and which coordinates have the noise of others."""
    told = []
    few = sum(one.few for one in found.found)
    if few:
        which = f"{few} of {len(found.found)} curves" if found.curves.several else "the curve"
        told.append(
            f"the noise of {which} cannot be told from fewer than {TELLING} different vertices: they stay as they are; "
            "sigma= says it"
        )
    if not (found.estimated and found.found):
        return told
    for k, (x, after, shut) in enumerate(zip(found.curves.points, found.points, found.curves.closed, strict=True)):
        blurred = blurred_axis(x, after - x, shut)
        if blurred is not None:
            low, high, least, most = blurred
            told.append(
                f"{'the curve' if not found.curves.several else f'curve {k}'}: the noise is {least:.3g} in coordinate "
                f"{low} and {most:.3g} in coordinate {high}; all are smoothed alike, and coordinate {low} moved by "
                "more than its noise: scale the coordinates to the same noise first"
            )
    return told


@door(options=RUN)
@part_of(denoised)
def denoise_curve(found: CurveDenoising) -> Any:
    """Denoise polygonal curves; without parameters it estimates the noise of each curve.

    Parameters
    ----------
    points : (n, d) array, or a list of (n, d) arrays
        The vertices in order, in any dimension; or a line or polygon of shapely, also several. A list, such as the
        outlines of ``skimage.measure.find_contours``, is regularized as one graph, with the noise of each curve.
    closed : bool, optional
        Whether the last vertex is joined to the first. None: decided for each curve. A curve is closed if the first
        vertex is repeated at the end (to 1e-6 of the mean segment), or if the distance of the ends is at most twice the
        95 % quantile of the segments' lengths, and in each coordinate at most four times the largest step. A repeated
        vertex is removed, and added again to the result.
    p : float, default 2
        Degree of regularity > 0. With 1 vertices gather at points joined by straight lines; < 1 simplifies the curve.
    lam : float or (n,) array, optional
        Fidelity >= 0, a number or one per vertex (of one curve after another). Larger values stay closer to the data;
        infinity pins. 0 is Laplacian smoothing, which shrinks the curve (figure 5), and needs `max_iter`. None:
        computed from the noise, see Notes.
    sigma : float, optional
        Standard deviation of the noise of each coordinate. None: estimated from differences of the fourth order, in
        each curve and, where it varies, along the curve; 0 for curves of fewer than 12 vertices.
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights` on the graph of the curves, or one value per directed edge, with which the
        curves are taken as they are. None: 1.
    fixed : (n,) bool array, optional
        Vertices, of one curve after another, whose position does not change.
    keep_ends : bool, default True
        Whether to fix the ends of open curves.
    valid : bool, default False
        In the plane: shorten the moves that make curves cross which did not before, and move vertices at the same
        place, such as those of a common border, together.
    solver : str or Solver, optional
        None: ``gpureg.Certified(tol=1e-6)``, the minimiser, for p >= 1 and lam > 0; otherwise "jacobi".
    norm, eps, max_iter, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`. If "jacobi" is the default solver, the default of `max_iter` is 1000. Without
        `lam`, `weights` and `solver` the default `dtype` for p = 2 is float64, if the device has it.

    Returns
    -------
    array like `points`, or a list of arrays, or objects of shapely

    Raises
    ------
    TypeError, ValueError
        Not a curve; arguments out of range.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Warns
    -----
    UserWarning
        Outliers were found; a curve is too short to tell its noise; one coordinate has far more noise than another; the
        ends of a curve given as closed are far apart; the result crosses itself at more places
        than the input; moves were shortened because of `valid`.

    Notes
    -----
    Minimises the energy of :func:`gpureg.regularize` for the positions. Without `lam`, a few vertices do not decide for
    the rest: consecutive vertices that are equal to 1e-6 of the mean segment count once. Outliers, up to three vertices
    with legs of more than three median segments that lead there and back, and vertices more than 4.5 sigma off the fit,
    are left out. A segment of more than eight times the median of the five before and of the five after is a gap, which
    is not smoothed across.

    The default lam minimises Stein's unbiased estimate of the error, in units of the variance::

        sum |u - f|^2 / sigma^2 + 2 d sum h

    with the result u at p = 2 and the leverages h, the derivatives of u by f at the same vertex. It is one number, one
    of ten per decade, for each piece between gaps, times sigma^-2 where the noise varies along the piece. It varies
    along a piece itself where that lowers the estimate clearly, as in curves with several densities of vertices. For
    another p it is the number for the piece times G^(p - 2), with G the root mean square of the gradient norm of that
    result, so that both smooth equally where the gradient is G.

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
    for sentence in warnings_of(found):
        warnings.warn(sentence, UserWarning, stacklevel=outside())
    return found.curves.as_came(found.points)
