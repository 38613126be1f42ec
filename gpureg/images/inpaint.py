"""Filling in of missing pixels: :func:`inpaint_image`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..checks import choice, integer, number
from ..doors import door
from ..frame import spread
from ..graphs.edges import METRICS, Metric
from ..graphs.grid import GridGraph
from ..model.problem import NORMS, default_eps
from ..model.result import Interrupted
from ..regularization.harmonic import harmonic
from ..regularization.options import MODEL, Model
from ..regularization.regularize import regularize
from ..solvers import resolve
from ..weights import Bilateral, Constant, Patch, Weights
from .guides import filled
from .options import check_run
from .raster import Raster
from .window import window_of

Mask = npt.NDArray[np.bool_]

_OPTIONS: dict[str, Any] = MODEL | {"tol": 1e-5}


@door(options=_OPTIONS)
def inpaint_image(
    image: npt.ArrayLike,
    missing: npt.ArrayLike,
    *,
    p: float = 2.0,
    radius: float | None = None,
    metric: Metric | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    update_weights: int | None = None,
    max_iter: int = 2000,
    spacing: Sequence[float] | None = None,
    channel_axis: int | None = None,
    **options: Unpack[Model],
) -> npt.NDArray[Any]:
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
        way; a large p tends to the absolutely minimal Lipschitz fill.
    radius : float, optional
        Radius of the window, in the units of `spacing`. None means the nearest neighbours for constant weights,
        otherwise 10 of the smallest cells (2 in a volume).
    metric : {"chebyshev", "euclidean", "cityblock"}, optional
        Shape of the window: square, disk or diamond.
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights`, or one value per directed edge of the grid. None means 1. Weights that
        compare values compare those of a first, harmonic fill.
    update_weights : int, optional
        Number of iterations after which the weights are computed again, from the current fill.
    max_iter : int, default 2000
        Maximum number of iterations.
    spacing : tuple of float, optional
        Size of a pixel along each axis; None means 1.
    channel_axis : int, optional
        The axis of the channels, which are regularized together; None for a grey image.
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`, with the spread of the known pixels; the default `tol` is 1e-5. dtype = None
        means float32, or float64 for integers of more than 16 bits.

    Returns
    -------
    array
        In the shape and dtype of `image`. Known pixels are unchanged, bit for bit; integers are rounded and clipped.
        A missing pixel without an edge of weight > 0 has the value of the first fill.

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
    on the part of the image that the missing pixels depend on. It starts at the solution for p = 2
    (:mod:`gpureg.regularization.harmonic`). p-Laplacian fills are smooth, without texture; patch weights copy texture
    from similar places.

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
    holes = np.asarray(missing)
    raster = _known(image, channel_axis, holes)
    _check(asked, p=p, radius=radius, metric=metric, update_weights=update_weights, max_iter=max_iter)
    if holes.all():
        raise ValueError("every pixel is missing: at least one value of missing must be False")
    if not holes.any():
        return raster.values.copy()
    kind = raster.chosen_type(asked.pop("dtype"))
    cells = raster.cells
    known_values = cells[~holes].astype(np.float64)
    eps, tol = asked.pop("eps"), asked.pop("tol")
    if eps is None:
        eps = default_eps(known_values, p)
    constant = weights is None or isinstance(weights, Constant)
    plain = constant and radius is None
    around, _ = window_of(holes.shape, radius=radius, metric=metric, spacing=spacing, local=constant)
    reach, metric, steps = around.radius, around.metric, around.spacing
    grid = GridGraph(holes.shape, reach, metric, spacing=steps)

    window = _window(holes, grid, weights, p)
    part, hole = cells[window], holes[window]
    known = ~hole
    f0: FloatArray = filled(part.astype(np.float64), known).reshape(-1, part.shape[-1])
    small = GridGraph(hole.shape, reach, metric, spacing=steps)
    computed: dict[str, Any] = {"backend": asked["backend"], "dtype": kind}
    first = small if plain else GridGraph(hole.shape, 1, "cityblock")
    f0, _ = harmonic(f0, first, known.ravel(), **computed)
    # Measured on the camera image. Holes 16, 32 and 64 pixels wide, filled from the nearest pixels, need 160, 840 and
    # 2320 sweeps to 0.1 % of the range at p = 2; with this start none. Patch weights (radius 2, h = 60, 15 x 15 window,
    # scratches) need 900 sweeps, 24 s, from the unweighted fill, and 50, 5 s in total, from the weighted fill.
    start = f0 if plain else harmonic(f0, small, known.ravel(), weights=weights, **computed)[0]
    found = (spread(known_values) or 1.0) / (spread(f0[known.ravel()]) or 1.0)
    try:
        value = regularize(
            f0,
            small,
            p=p,
            lam=np.where(known, np.inf, 0.0).ravel(),
            weights=weights,
            eps=eps,
            max_iter=max_iter,
            # relative to the spread of the whole image
            tol=None if tol is None else tol * found,
            update_weights=update_weights,
            initial=start,
            dtype=kind,
            **asked,
        ).value
    except Interrupted as interruption:
        whole = _painted(raster, interruption.result.value, window, hole)
        raise Interrupted(replace(interruption.result, value=whole)) from None
    return _painted(raster, value, window, hole)


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
    max_iter: int,
) -> None:
    """Check the arguments that do not depend on the image."""
    check_run(asked)  # type: ignore[arg-type]
    choice("norm", asked["norm"], NORMS)
    resolve(asked["solver"])
    number("p", p, above=0)
    for name in ("tol", "eps"):
        if asked[name] is not None:
            number(name, asked[name], low=0)
    if radius is not None:
        number("radius", radius, finite=False)
    if metric is not None:
        choice("metric", metric, METRICS)
    if update_weights is not None:
        integer("update_weights", update_weights, low=1)
    integer("max_iter", max_iter, low=0)


def _window(missing: Mask, grid: GridGraph, weights: Weights | npt.ArrayLike | None, p: float) -> tuple[slice, ...]:
    """Return the box of the pixels that missing pixels depend on; for unknown kinds of weights the whole image.

    A missing pixel depends on its neighbours, for p != 2 also on theirs (through gradient norms), and weights depend
    on the patches around both.
    """
    local = weights is None or isinstance(weights, Constant | Bilateral | Patch)
    if not local:
        return (slice(None),) * missing.ndim
    reach = np.abs(grid.offsets).max(axis=0, initial=0) * (1 if p == 2 else 2)
    reach = reach + (weights.patch_radius if isinstance(weights, Patch) else 0)
    box = []
    for axis in range(missing.ndim):
        places = np.flatnonzero(missing.any(axis=tuple(a for a in range(missing.ndim) if a != axis)))
        low, high = int(places[0]) - int(reach[axis]), int(places[-1]) + 1 + int(reach[axis])
        box.append(slice(max(0, low), min(missing.shape[axis], high)))
    return tuple(box)


def _painted(raster: Raster, value: FloatArray, window: tuple[slice, ...], hole: Mask) -> npt.NDArray[Any]:
    """Return a copy of the image with the missing pixels of the window filled in."""
    paint, kind = value.reshape(*hole.shape, -1)[hole], raster.values.dtype
    if kind.kind in "iu":
        limits = np.iinfo(kind)
        paint = np.clip(np.rint(paint), limits.min, limits.max)
    whole = raster.cells.copy()
    whole[window][hole] = paint.astype(kind)
    image = whole[..., 0] if raster.channel_axis is None else np.moveaxis(whole, -1, raster.channel_axis)
    return np.ascontiguousarray(image)
