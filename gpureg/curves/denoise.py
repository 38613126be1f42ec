"""Denoise polygonal curves: :func:`denoise_curve` (section 5.3, figure 5)."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, checked_flags
from ..checks import flag
from ..doors import door, part_of
from ..graphs.of_shapes import curve_graph
from ..model.result import Result
from ..noise.graphs import noise_on_graph
from ..regularization.denoised import Denoised, check_numbers, checked_fidelity
from ..regularization.options import RUN, Run
from ..regularization.regularize import regularize
from ..solvers import Certified, Solver
from ..weights import Weights
from .curves import Curves, curves_of

# With fewer vertices noise cannot be distinguished from shape.
_TELLING = 12

# Candidates for the default fidelity: ten per decade.
_FIDELITIES = np.logspace(-5, 4, 91)


@dataclass(frozen=True, eq=False, kw_only=True)
class CurveDenoising(Denoised[tuple[float, ...]]):
    """The result of denoising curves: see :class:`Denoised`; arrays have the vertices of one curve after another.

    Attributes
    ----------
    filter : {"positions"}
    sigma : tuple of float
        Noise of each curve: given, or estimated.
    lam : tuple of float, or (n,) array
        Fidelity of each curve, or of each vertex if `lam` was an array.
    curves : Curves
        The input curves.
    """

    WHAT: ClassVar[Mapping[str, str]] = {"positions": "positions of the vertices"}

    curves: Curves

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
    graph = curves.graph()
    n = graph.n_vertices
    shapes = list(zip(curves.points, curves.closed, strict=True))
    noise = tuple(_noise(x, shut) if sigma is None else float(sigma) for x, shut in shapes)
    asked: tuple[float, ...] | FloatArray
    given = None if lam is None else checked_fidelity(lam, n)
    if isinstance(given, np.ndarray):
        asked = given
        fidelity = given.copy()
    else:
        if given is None:
            asked = tuple(_fidelity(x, shut, s, float(p)) for (x, shut), s in zip(shapes, noise, strict=True))
        else:
            asked = (given,) * len(shapes)
        fidelity = np.repeat(asked, [len(x) for x in curves.points])
    if fixed is not None:
        fidelity[checked_flags("fixed", fixed, n)] = math.inf
    if flag("keep_ends", keep_ends):
        fidelity[np.diff(graph.indptr) == 1] = math.inf
    results: tuple[Result, ...] = ()
    value = together = np.concatenate(curves.points)
    if not np.isinf(fidelity).all():
        if solver is None:
            exact = p >= 1 and fidelity.min() > 0
            solver = Certified(tol=1e-6) if exact else "jacobi"
            max_iter = 1000 if max_iter is None and not exact else max_iter
        f0 = graph.positions
        assert f0 is not None
        # one number if all are equal: the fastest kernels and direct solvers need that
        held: float | FloatArray = float(fidelity[0]) if (fidelity == fidelity[0]).all() else fidelity
        result = regularize(
            f0, graph, p=p, lam=held, weights=weights, norm=norm, eps=eps, solver=solver, max_iter=max_iter, tol=tol,
            **options,
        )  # fmt: skip
        results = (result,)
        # pinned vertices are returned unchanged, bit for bit
        value = together + np.where(np.isinf(fidelity)[:, None], 0.0, result.value - f0)
    return CurveDenoising(
        value=value,
        filter="positions",
        sigma=noise,
        estimated=sigma is None,
        p=float(p),
        lam=asked,
        results=results,
        displacement=np.linalg.norm(value - together, axis=1),
        seconds=time.perf_counter() - begin,
        curves=curves,
    )


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


def _noise(x: FloatArray, closed: bool) -> float:
    # a square has four large second differences and no noise
    return noise_on_graph(x - x.mean(axis=0), curve_graph(x, closed)) if len(x) >= _TELLING else 0.0


def _fidelity(x: FloatArray, closed: bool, sigma: float, p: float) -> float:
    """Compute the default fidelity of :func:`denoise_curve` for one curve, (n, d)."""
    from scipy import fft

    if not sigma > 0:
        return math.inf
    n, d = x.shape
    f = x - x.mean(axis=0)
    power = np.abs(fft.fft(f, axis=0, norm="ortho") if closed else fft.dct(f, axis=0, norm="ortho")) ** 2
    power = power.sum(axis=1)
    mu = 2 - 2 * np.cos((2 if closed else 1) * np.pi * np.arange(n) / n)
    h = _FIDELITIES[:, None] / (_FIDELITIES[:, None] + 2 * mu)
    best = int(np.argmin(((1 - h) ** 2 * power).sum(axis=1) + 2 * sigma**2 * d * h.sum(axis=1)))
    lam = float(_FIDELITIES[best])
    if p == 2:
        return lam
    slope = math.sqrt(2 * float((mu * h[best] ** 2 * power).sum()) / n)
    return lam * slope ** (p - 2) if slope > 0 else math.inf
