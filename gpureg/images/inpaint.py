"""Filling in of missing pixels: :func:`inpaint_image`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, Unpack, overload

import numpy as np
import numpy.typing as npt

from ..checks import choice, flag, integer, number
from ..doors import door
from ..frame import spread
from ..graphs.edges import METRICS, Metric
from ..graphs.grid import GridGraph
from ..model.problem import NORMS, default_eps
from ..model.result import Interrupted, Result, Stop
from ..regularization.options import FILL, Fill, solver_of
from ..regularization.regularize import regularize
from ..solvers import Certified, resolve
from ..weights import Constant, Weights
from .missing import Part
from .options import check_run
from .raster import Raster
from .window import window_of

_OPTIONS: dict[str, Any] = FILL | {"return_result": False}
# Sweeps of a solver that is not certified, and the tolerance at which they end.
_SWEEPS, _TOL = 2000, 1e-5


class _Options(Fill, total=False):
    return_result: bool


@overload
def inpaint_image(
    image: npt.ArrayLike, missing: npt.ArrayLike, *, return_result: Literal[False] = False, **settings: Any
) -> npt.NDArray[Any]: ...
@overload
def inpaint_image(
    image: npt.ArrayLike, missing: npt.ArrayLike, *, return_result: Literal[True], **settings: Any
) -> tuple[npt.NDArray[Any], Result]: ...
@door(options=_OPTIONS)  # type: ignore[misc]  # the overloads leave the settings to this one
def inpaint_image(
    image: npt.ArrayLike,
    missing: npt.ArrayLike,
    *,
    p: float = 2.0,
    radius: float | None = None,
    metric: Metric | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    update_weights: int | None = None,
    max_iter: int | None = None,
    spacing: Sequence[float] | None = None,
    channel_axis: int | None = None,
    **options: Unpack[_Options],
) -> npt.NDArray[Any] | tuple[npt.NDArray[Any], Result]:
    """Fill in missing pixels of an image or a volume from those around them.

    Parameters
    ----------
    image : array
        Two or more axes, not counting the channels. Results and parameters are in its units.
    missing : bool array
        True where a pixel is missing, in the shape of the image without its channels. The image's values there are
        ignored and may be NaN.
    p : float, default 2
        Degree of regularity > 0: 2 is the harmonic fill; 1 is total variation, which continues edges along the shortest
        way; infinity is the absolutely minimal Lipschitz fill, and a large p is near it.
    radius : float, optional
        Radius of the window, in the units of `spacing`. None means the nearest neighbours for constant weights,
        otherwise 10 of the smallest cells (2 in a volume).
    metric : {"chebyshev", "euclidean", "cityblock"}, optional
        Shape of the window: square, disk or diamond.
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights`, or one value per directed edge of the grid. None means 1. Weights that
        compare values compare those of a first, harmonic fill.
    update_weights : int, optional
        Number of iterations after which the weights are computed again, from the current fill. Not with "certified".
    max_iter : int, optional
        Maximum number of iterations. None: 20 000 with "certified", otherwise 2000.
    spacing : tuple of float, optional
        Size of a pixel along each axis; None means 1.
    channel_axis : int, optional
        The axis of the channels, which are regularized together; None for a grey image.
    solver : str or Solver, optional
        None: "certified", which finds a minimiser, for p >= 1 and without `update_weights`, otherwise "jacobi".
    tol : float, optional
        None: 1e-10 (p = 2) or 1e-4 of the energy with "certified", otherwise 1e-5 of the spread of the known pixels.
    return_result : bool, default False
        Return the :class:`gpureg.Result` too, for its gap and how the run ended.
    norm, eps, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`, with the spread of the known pixels; for p = inf the default norm is "edge".
        dtype = None means float32, or float64 for integers of more than 16 bits.

    Returns
    -------
    array
        In the shape and dtype of `image`. Known pixels are unchanged, bit for bit; integers are rounded and clipped.
        A missing pixel that no path of edges of weight > 0 joins to a known one has the value of the first fill, or
        that of the nearest known pixel.
    result : Result
        If `return_result`: its value is the image; its energy and gap, in the units of the data, are those of the part
        of the image that the missing pixels depend on, before rounding to integers.

    Raises
    ------
    ValueError, TypeError
        No known pixel, a `missing` that is not boolean or not in the image's shape, known values that are not real and
        finite, or an argument out of its range.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Warns
    -----
    UserWarning
        As :func:`gpureg.denoise_image`.

    Notes
    -----
    This is one call of :func:`gpureg.regularize` (eq. 19, 20) with lam infinite at known pixels and 0 at missing ones,
    on the part of the image that the missing pixels depend on. It starts at the solution for p = 2. p-Laplacian fills
    are smooth, without texture; patch weights copy texture from similar places.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> slope = np.add.outer(np.arange(6.0), np.arange(8.0))
    >>> torn = slope.copy()
    >>> torn[2:4, 3:6] = np.nan
    >>> gr.inpaint_image(torn, np.isnan(torn), backend="numpy")[2].round(3)
    array([2., 3., 4., 5., 6., 7., 8., 9.])
    """
    asked: dict[str, Any] = _OPTIONS | options
    if p == np.inf and "norm" not in options:
        asked["norm"] = "edge"
    return_result = flag("return_result", asked.pop("return_result"))
    holes = np.asarray(missing)
    raster = _known(image, channel_axis, holes)
    _check(asked, p=p, radius=radius, metric=metric, update_weights=update_weights, max_iter=max_iter)
    if holes.all():
        raise ValueError("every pixel is missing: at least one value of missing must be False")
    if not holes.any():
        whole = raster.values.copy()
        return (whole, _nothing_missing(whole)) if return_result else whole
    kind = raster.chosen_type(asked.pop("dtype"))
    known_values = raster.cells[~holes].astype(np.float64)
    constant = weights is None or isinstance(weights, Constant)
    around, _ = window_of(holes.shape, radius=radius, metric=metric, spacing=spacing, local=constant)
    grid = GridGraph(holes.shape, around.radius, around.metric, spacing=around.spacing)
    solver, max_iter, tol = solver_of(asked, p, max_iter, sweeps=_SWEEPS, tol=_TOL, renewed=update_weights is not None)
    certified = isinstance(solver, Certified)
    part = Part.of(raster, holes, grid, weights, near=p == 2 or asked["norm"] == "edge", masked=certified)
    eps = asked.pop("eps")
    if eps is None and not certified:
        eps = default_eps(known_values, p)
    if tol is not None and not certified:
        # relative to the spread of the whole image
        tol *= (spread(known_values) or 1.0) / (spread(part.f0[part.known]) or 1.0)
    computed: dict[str, Any] = {"backend": asked["backend"], "dtype": kind}
    try:
        f0, start, told = part.started(weights, certified, computed)
        result = regularize(
            f0,
            part.graph,
            p=p,
            lam=np.where(told, 0.0, np.inf),
            weights=weights,
            eps=eps,
            max_iter=max_iter,
            update_weights=update_weights,
            initial=start,
            **{**asked, "solver": solver, "tol": tol, "dtype": kind},
        )
    except Interrupted as interruption:
        whole = part.painted(interruption.result.value)
        raise Interrupted(replace(interruption.result, value=whole, problem=None)) from None
    whole = part.painted(result.value)
    return (whole, replace(result, value=whole, problem=None)) if return_result else whole


def _nothing_missing(image: npt.NDArray[Any]) -> Result:
    """Return the result where no pixel is missing."""
    said = {"method": "No pixel is missing.", "backend": "none", "eps": 0.0, "seconds": 0.0}
    result = Result.bare(image.copy(), iterations=0, stop=Stop.GAP, **said)  # type: ignore[arg-type]
    return replace(result, gap=0.0, error_bound=0.0)


def _known(image: npt.ArrayLike, channel_axis: int | None, missing: npt.NDArray[Any]) -> Raster:
    """Check the image; the known pixels are its mask.

    Raises
    ------
    TypeError, ValueError
        As :meth:`Raster.of`; also a `missing` that is not boolean or not in the shape of the pixels.
    """
    if missing.dtype != np.bool_:
        raise ValueError(f"missing must be boolean, True where a pixel is missing, got {missing.dtype}")
    shape = list(np.shape(image))
    if channel_axis is not None:
        del shape[integer("channel_axis", channel_axis, low=-len(shape), high=len(shape) - 1)]
    if missing.shape != tuple(shape):
        raise ValueError(f"missing must have the shape of the image's pixels, {tuple(shape)}, got {missing.shape}")
    return Raster.of(image, channel_axis, ~missing)


def _check(
    asked: dict[str, Any],
    *,
    p: float,
    radius: float | None,
    metric: Metric | None,
    update_weights: int | None,
    max_iter: int | None,
) -> None:
    """Check the arguments that do not depend on the image."""
    check_run(asked)  # type: ignore[arg-type]
    choice("norm", asked["norm"], NORMS)
    if asked["solver"] is not None:
        resolve(asked["solver"])
    number("p", p, above=0, finite=False)
    for name in ("tol", "eps"):
        if asked[name] is not None:
            number(name, asked[name], low=0)
    if radius is not None:
        number("radius", radius, finite=False)
    if metric is not None:
        choice("metric", metric, METRICS)
    if update_weights is not None:
        integer("update_weights", update_weights, low=1)
    if max_iter is not None:
        integer("max_iter", max_iter, low=0)
