"""The door for polygonal curves: :func:`denoise_curve` (section 5.3, figure 5)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, checked_points
from ..graphs.csr import Graph
from ..graphs.of_shapes import curve_graph
from ..model.result import Result
from ..noise.graphs import noise_on_graph
from ..regularization.regularize import regularize
from ..solvers import Certified, Solver
from ..solvers.loop import Callback
from ..weights import Weights

# Of fewer vertices noise cannot be told from shape.
_TELLING = 12

# Fidelities among which the noise chooses: ten to a decade.
_FIDELITIES = np.logspace(-5, 4, 91)


@dataclass(frozen=True, eq=False)
class Curves:
    """Polygonal curves, checked: one array of vertices each, and how each came."""

    points: list[FloatArray]
    closed: bool
    repeated: list[bool]
    dtypes: list[np.dtype[Any]]
    several: bool

    def graph(self) -> Graph:
        """All curves as one graph, the positions of each around its mean."""
        parts = [curve_graph(x - x.mean(axis=0), self.closed) for x in self.points]
        if len(parts) == 1:
            return parts[0]
        starts = np.cumsum([0, *(part.n_vertices for part in parts[:-1])])
        ends = np.cumsum([0, *(part.n_edges for part in parts)])
        return Graph(
            np.concatenate([[0], *(part.indptr[1:] + end for part, end in zip(parts, ends, strict=False))]),
            np.concatenate([part.indices + start for part, start in zip(parts, starts, strict=True)]),
            None,
            np.concatenate([part.positions for part in parts if part.positions is not None]),
        )

    def split(self, f: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
        """A function on the vertices of all curves, curve by curve."""
        return np.split(f, np.cumsum([len(x) for x in self.points[:-1]]))

    def as_came(self, values: list[FloatArray]) -> Any:
        """Vertices of each curve in its type, the first repeated where it was, alone where one came alone."""
        made = [
            (np.concatenate([x, x[:1]]) if again else x).astype(dtype)
            for x, again, dtype in zip(values, self.repeated, self.dtypes, strict=True)
        ]
        return made if self.several else made[0]


def curves_of(points: npt.ArrayLike | Sequence[npt.ArrayLike], closed: bool) -> Curves:
    """One curve, (n, d), or a list of them.

    Raises
    ------
    TypeError, ValueError
        Coordinates that are not real and finite, curves of too few vertices or of different dimensions.
    """
    if not isinstance(closed, bool):
        raise TypeError(f"closed must be True or False, got {closed!r}")
    several = isinstance(points, list | tuple) and all(np.ndim(x) == 2 for x in points)
    given: list[Any] = list(points) if several else [points]  # type: ignore[arg-type]
    if not given:
        raise ValueError("there is no curve: the list is empty")
    parts, repeated, dtypes = [], [], []
    for k, curve in enumerate(given):
        array = np.asarray(curve)
        x = checked_points(array, f"curve {k}" if several else "points")
        again = closed and len(x) > 1 and bool((x[0] == x[-1]).all())
        x = x[:-1] if again else x
        least = 3 if closed else 2
        if len(x) < least:
            what = f"curve {k}" if several else "the curve"
            raise ValueError(f"{what} has {len(x)} vertices; {'a closed' if closed else 'an open'} one needs {least}")
        parts.append(x)
        repeated.append(again)
        dtypes.append(array.dtype if array.dtype.kind == "f" else np.dtype(np.float64))
    if len({x.shape[1] for x in parts}) > 1:
        raise ValueError(f"all curves must have as many dimensions, got {sorted({x.shape[1] for x in parts})}")
    return Curves(parts, closed, repeated, dtypes, several)


@dataclass(frozen=True, eq=False)
class CurveDenoising:
    """What :func:`denoised_curves` did.

    Attributes
    ----------
    points : list of (n, d) float arrays
        The curves, without repeated points.
    sigma : list of float
        Noise of each curve: given, or estimated.
    lam : list of float, or (n,) array
        Fidelity of each curve, or of each vertex as given.
    p : float
    result : Result or None
        The run; None where no curve is noisy.
    """

    points: list[FloatArray]
    sigma: list[float]
    lam: list[float] | FloatArray
    p: float
    result: Result | None


def denoise_curve(
    points: npt.ArrayLike | Sequence[npt.ArrayLike],
    *,
    closed: bool = True,
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
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
    callback: Callback | None = None,
    progress: bool = False,
) -> Any:
    """Denoise polygonal curves; called with nothing else it estimates the noise of each.

    Parameters
    ----------
    points : (n, d) array, or a list of such
        The vertices in order, in any number of dimensions. A list, such as the outlines that
        ``skimage.measure.find_contours`` gives, is regularized as one graph, each curve by its own noise.
    closed : bool, default True
        Whether the last vertex is joined to the first. A first vertex repeated at the end is taken off, and put back.
    p : float, default 2
        Degree of regularity > 0. 1 makes the curve rest at places, with straight leaps between; < 1 simplifies it.
    lam : float or array, optional
        Fidelity >= 0, a number or one per vertex (of all curves in turn); larger stays closer, infinity pins. 0 is
        Laplacian smoothing, which shrinks (figure 5); with it give `max_iter`. None: from the noise, see Notes.
    sigma : float, optional
        Deviation of the noise of each coordinate. None estimates it, curve by curve, from second differences; of
        fewer than 12 vertices it is taken to be 0.
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights` on the graph of the curves, or one value per directed edge. None: 1.
    fixed : (n,) bool array, optional
        Vertices, of all curves in turn, that keep their place.
    keep_ends : bool, default True
        Whether the ends of open curves keep theirs.
    solver : str or Solver, optional
        None: ``gpureg.Certified(tol=1e-6)``, the minimiser, where there is one (p >= 1, lam > 0), "jacobi" elsewhere.
    norm, eps, max_iter, tol, backend, dtype, callback, progress
        As in :func:`gpureg.regularize`. `max_iter` of the "jacobi" that is chosen here is 1000.

    Returns
    -------
    array like `points`, or a list of such

    Raises
    ------
    TypeError, ValueError
        What is no curve, arguments out of their ranges.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    Minimises the energy of :func:`gpureg.regularize` for the positions. At p = 2 and w = 1 the curve's Fourier (open:
    cosine) coefficients are multiplied by h = lam / (lam + 2 mu), with mu = 2 - 2 cos of their frequency; lam is the
    one, of ten a decade, that makes Stein's unbiased estimate of the error least: sum (1 - h)^2 |F|^2 +
    2 sigma^2 d sum h. For another p it is that lam times G^(p - 2), G the root mean square of the gradient norm there,
    so that both smooth alike where the gradient is G.

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
    curves = curves_of(points, closed)
    found = denoised_curves(
        curves, p=p, lam=lam, sigma=sigma, weights=weights, fixed=fixed, keep_ends=keep_ends, norm=norm, eps=eps,
        solver=solver, max_iter=max_iter, tol=tol, backend=backend, dtype=dtype, callback=callback, progress=progress,
    )  # fmt: skip
    return curves.as_came(found.points)


def denoised_curves(
    curves: Curves,
    *,
    p: float = 2.0,
    lam: float | npt.ArrayLike | None = None,
    sigma: float | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    fixed: npt.ArrayLike | None = None,
    keep_ends: bool = True,
    solver: str | Solver | None = None,
    max_iter: int | None = None,
    **model: Any,
) -> CurveDenoising:
    """:func:`denoise_curve`, with all that there is to say about it.

    Raises
    ------
    TypeError, ValueError, BackendUnavailable, FloatingPointError, Interrupted
        As :func:`denoise_curve`.
    """
    if sigma is not None and not (isinstance(sigma, int | float | np.number) and math.isfinite(sigma) and sigma >= 0):
        raise ValueError(f"sigma must be a finite number >= 0, got {sigma!r}")
    if isinstance(p, bool) or not isinstance(p, int | float | np.number) or not p > 0:
        raise ValueError(f"p must be a number > 0, got {p!r}")
    graph = curves.graph()
    n = graph.n_vertices
    noise = [_noise(x, curves.closed) if sigma is None else float(sigma) for x in curves.points]
    asked: list[float] | FloatArray
    if lam is None:
        asked = [_fidelity(x, curves.closed, s, float(p)) for x, s in zip(curves.points, noise, strict=True)]
        fidelity = np.repeat(asked, [len(x) for x in curves.points])
    elif np.ndim(lam) == 0:
        asked = [float(lam)] * len(curves.points)  # type: ignore[arg-type]
        fidelity = np.full(n, asked[0])
    else:
        asked = fidelity = np.asarray(lam, dtype=np.float64)
        if fidelity.shape != (n,):
            raise ValueError(f"lam must be a number or one per vertex, ({n},), got {fidelity.shape}")
    fidelity = fidelity.copy()
    if fixed is not None:
        flags = np.asarray(fixed)
        if flags.dtype != np.bool_ or flags.shape != (n,):
            raise ValueError(f"fixed must be boolean of shape ({n},), one per vertex; got {flags.dtype} {flags.shape}")
        fidelity[flags] = math.inf
    if keep_ends and not curves.closed:
        fidelity[np.diff(graph.indptr) == 1] = math.inf
    if np.isinf(fidelity).all():
        return CurveDenoising(curves.points, noise, asked, float(p), None)
    if solver is None:
        exact = p >= 1 and fidelity.min() > 0
        solver = Certified(tol=1e-6) if exact else "jacobi"
        max_iter = 1000 if max_iter is None and not exact else max_iter
    f0 = graph.positions
    assert f0 is not None
    # one number where it is one: the fastest kernels and direct solvers are for that
    held: float | FloatArray = float(fidelity[0]) if (fidelity == fidelity[0]).all() else fidelity
    result = regularize(f0, graph, p=p, lam=held, weights=weights, solver=solver, max_iter=max_iter, **model)
    # what is pinned comes back as it was, to the bit
    moves = np.where(np.isinf(fidelity)[:, None], 0.0, result.value - f0)
    points = [x + move for x, move in zip(curves.points, curves.split(moves), strict=True)]
    return CurveDenoising(points, noise, asked, float(p), result)


def _noise(x: FloatArray, closed: bool) -> float:
    # of a square all four second differences are large, and none is noise
    return noise_on_graph(x - x.mean(axis=0), curve_graph(x, closed)) if len(x) >= _TELLING else 0.0


def _fidelity(x: FloatArray, closed: bool, sigma: float, p: float) -> float:
    """The fidelity that :func:`denoise_curve` takes where none is given."""
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
