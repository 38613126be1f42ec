"""Options that several public functions of images have in common, and their checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, cast

import numpy as np
import numpy.typing as npt

from ..checks import choice, flag, integer, number
from ..graphs.edges import METRICS, Metric
from ..model.problem import NORMS
from ..regularization.options import MODEL, RUN, Model, Run
from ..solvers import Solver
from ..tuning.fidelity import LAM_METHODS, LamMethod
from ..weights import Weights
from .borders import BORDERS, Border
from .noise import Sigma, check_sigma
from .passes import QUALITIES, Quality
from .plan import CENTRES, AveragePatches, Centre
from .raster import Raster

# The filter and two passes on groups of patches.
MOST_PASSES = 3
WeightKind = Literal["constant", "bilateral", "patch"]
WEIGHTS: tuple[WeightKind, ...] = ("constant", "bilateral", "patch")
# Options that belong to only one kind of weights.
OF_WEIGHTS: dict[str, WeightKind] = {
    "h": "patch",
    "patch_sigma": "patch",
    "sigma_space": "bilateral",
    "sigma_value": "bilateral",
}


class OnPixels(Run, total=False):
    """The pixels that take part, and the image that weights compare.

    Attributes
    ----------
    guide : array of the image's pixels, with or without channels, optional
        The image that the weights compare instead of the given one.
    mask : bool array of the image's pixels, optional
        True where a pixel takes part; None for everywhere.
    spacing : sequence of float, one per axis except the channels, optional
        Size of a pixel along each axis; None means 1.
    channel_axis : int, optional
        The axis of the channels; None for a grey image.
    """

    guide: npt.ArrayLike | None
    mask: npt.ArrayLike | None
    spacing: Sequence[float] | None
    channel_axis: int | None


class Filter(OnPixels, total=False):
    """Options of nonlocal means and of the bilateral filter: one sweep at p = 2.

    Attributes
    ----------
    lam : float or array of the image's pixels, default 2
        Twice the weight of the pixel itself, in the unit defined by `centre`.
    centre : {"once", "largest", "none"}, default "once"
        Weight of the pixel itself for lam = 2: 1, the largest weight of its neighbours, or 0.
    metric : {"chebyshev", "euclidean", "cityblock"}, default "chebyshev"
        Shape of the window.
    border : {"clip", "reflect", "symmetric", "nearest", "wrap", "constant"}, default "clip"
        Values beyond the border.
    constant : float, default 0
        The value beyond the border for "constant".
    """

    lam: float | npt.ArrayLike
    centre: Centre
    metric: Metric
    border: Border
    constant: float


class Choice(OnPixels, Model, total=False):
    """The options from which a plan is made; the plan chooses those that are None.

    Attributes
    ----------
    sigma : float, one per channel, array of the image's pixels, "photon", NoiseReport or PhotonNoise, optional
        Standard deviation of the noise.
    p : float, optional
        Degree of regularity.
    lam : float, array of the image's pixels, or the name of a search, optional
        Fidelity.
    radius, metric
        The window.
    weights : Weights, array with one value per directed edge, or a kind of weights, optional
    h, patch_radius, patch_sigma
        Parameters of the kind "patch".
    sigma_space, sigma_value
        Parameters of the kind "bilateral".
    k : int, optional
        Number of edges that each pixel uses, those to the nearest patches.
    centre, average_patches
        Options of a single sweep.
    max_iter : int, optional
        Maximum number of iterations.
    passes : int, optional
        1 for the filter alone, 2 or 3 for one or two passes on groups of similar patches after it.
    quality : {"fast", "balanced", "best"}, optional
        A word for the number of passes and how often groups are found.
    """

    sigma: Sigma | None
    p: float | None
    lam: float | npt.ArrayLike | LamMethod | None
    radius: float | None
    metric: Metric | None
    weights: Weights | npt.ArrayLike | WeightKind | None
    h: float | None
    patch_radius: int | None
    patch_sigma: float | None
    sigma_space: float | None
    sigma_value: float | None
    k: int | None
    centre: Centre | None
    average_patches: AveragePatches | None
    max_iter: int | None
    passes: int | None
    quality: Quality | None


class Denoise(Choice, total=False):
    """Options of :func:`gpureg.denoise_image`: those of a plan, and options of the model that are not in a plan.

    Attributes
    ----------
    gamma, coupled, update_weights
        As in :func:`gpureg.regularize`.
    """

    gamma: str | npt.ArrayLike
    coupled: bool
    update_weights: int | None


class RunPlan(Run, total=False):
    """Options of :func:`gpureg.run_plan`.

    Attributes
    ----------
    guide, mask, channel_axis
        As in :class:`OnPixels`.
    solver, norm, gamma, coupled, update_weights
        As in :func:`gpureg.regularize`.
    """

    guide: npt.ArrayLike | None
    mask: npt.ArrayLike | None
    channel_axis: int | None
    solver: str | Solver
    norm: Literal["vertex", "edge"]
    gamma: str | npt.ArrayLike
    coupled: bool
    update_weights: int | None


def _own(options: type, *bases: type) -> dict[str, Any]:
    """Return the options of a class that its bases do not have, each None."""
    inherited = {name for base in bases for name in base.__annotations__}
    return {name: None for name in options.__annotations__ if name not in inherited}


_PIXELS = _own(OnPixels, Run)
_MORE: dict[str, Any] = {"gamma": "sqrt", "coupled": True, "update_weights": None}

ON_PIXELS: dict[str, Any] = _PIXELS | RUN
FILTER: dict[str, Any] = {
    "lam": 2.0,
    "centre": "once",
    "metric": "chebyshev",
    "border": "clip",
    "constant": 0.0,
    **ON_PIXELS,
}
CHOICE: dict[str, Any] = _own(Choice, OnPixels, Model) | _PIXELS | MODEL
DENOISE: dict[str, Any] = _own(Choice, OnPixels, Model) | _MORE | _PIXELS | MODEL
RUN_PLAN: dict[str, Any] = _own(RunPlan, Run) | {"norm": "vertex", "solver": "jacobi"} | _MORE | RUN


def map_of(
    name: str,
    value: Any,
    shape: tuple[int, ...],
    *,
    low: float | None = None,
    above: float | None = None,
    finite: bool = True,
) -> Any:
    """Check a parameter that is a number, or an array of one value per pixel.

    Parameters
    ----------
    name : str
        Name of the parameter, for the error message.
    value : float or array
        The given value.
    shape : tuple of int
        Shape of the image without its channels.
    low, above, finite
        The range of a number, as in :func:`gpureg.checks.number`. The values of an array are checked at use.

    Returns
    -------
    float or array
        The number unchanged, or the array.

    Raises
    ------
    TypeError, ValueError
        Neither of them, a number out of its range, an array of another shape.
    """
    array = np.asarray(value)
    if array.ndim == 0:
        number(name, array[()] if isinstance(value, np.ndarray) else value, low=low, above=above, finite=finite)
        return value
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{name} must be a number or an array of them, got {array.dtype}")
    if array.shape != shape:
        raise ValueError(f"{name} must be a number or one value per pixel, shape {shape}; got shape {array.shape}")
    return array


def check_run(options: Run) -> None:
    """Check the options of a run; ``backend`` and ``dtype`` are checked at use.

    Raises
    ------
    TypeError, ValueError
    """
    flag("progress", options["progress"])
    if options["memory"] is not None:
        integer("memory", options["memory"], low=1)
    if options["callback"] is not None and not callable(options["callback"]):
        raise TypeError(f"callback must be callable, got {options['callback']!r}")


def check_filter(asked: Filter, shape: tuple[int, ...]) -> None:
    """Check the options of a filter, for an image of this shape without its channels.

    Raises
    ------
    TypeError, ValueError
        A number out of its range, an unknown name.
    """
    check_run(asked)
    choice("centre", asked["centre"], CENTRES)
    choice("border", asked["border"], BORDERS)
    choice("metric", asked["metric"], METRICS)
    number("constant", asked["constant"])
    map_of("lam", asked["lam"], shape, low=0, finite=False)


def check_averaging(average_patches: Any) -> None:
    """Check the value of `average_patches`.

    Raises
    ------
    ValueError
    """
    if not (isinstance(average_patches, bool | np.bool_) or average_patches == "weighted"):
        raise ValueError(f"average_patches must be True, False or 'weighted', got {average_patches!r}")


def check_choice(asked: Choice, raster: Raster) -> None:
    """Check the options of a plan for an image.

    Raises
    ------
    TypeError, ValueError
        A number out of its range, an unknown name, options that belong to other weights.
    """
    check_run(asked)
    given: Mapping[str, Any] = cast("Mapping[str, Any]", asked)
    for name, low in (("max_iter", 0), ("k", 1), ("patch_radius", 0)):
        if given[name] is not None:
            integer(name, given[name], low=low)
    if given["passes"] is not None:
        integer("passes", given["passes"], low=1, high=MOST_PASSES)
    if given["quality"] is not None:
        choice("quality", given["quality"], QUALITIES)
    for name in ("tol", "eps"):
        if given[name] is not None:
            number(name, given[name], low=0)
    for name in ("p", "h", "patch_sigma", "sigma_space", "sigma_value"):
        if given[name] is not None:
            number(name, given[name], above=0, finite=not name.startswith("sigma_"))
    if given["radius"] is not None:
        number("radius", given["radius"], finite=False)  # the grid checks that it reaches a neighbour
    check_sigma(given["sigma"], raster)
    lam = given["lam"]
    if isinstance(lam, str) and lam not in LAM_METHODS:
        raise ValueError(f"lam must be a number, one per pixel, or one of {', '.join(LAM_METHODS)}, got {lam!r}")
    if lam is not None and not isinstance(lam, str):
        map_of("lam", lam, raster.shape, low=0, finite=False)
    choice("norm", given["norm"], NORMS)
    if given["metric"] is not None:
        choice("metric", given["metric"], METRICS)
    if given["centre"] is not None:
        choice("centre", given["centre"], CENTRES)
        if given["centre"] == "none" and lam is not None:
            raise ValueError("centre='none' leaves the pixel itself out, so that lam has no meaning: give only one")
    if given["average_patches"] is not None:
        check_averaging(given["average_patches"])
    one_step = given["centre"] is not None or given["average_patches"]
    if one_step and lam is not None and not isinstance(lam, str) and np.ndim(lam) == 0 and lam == 0:
        raise ValueError("lam = 0 leaves the pixel itself out: give centre='none' instead of lam")
    if isinstance(given["weights"], str):
        choice("weights", given["weights"], WEIGHTS)
    for name, owner in OF_WEIGHTS.items():
        if given[name] is not None and not (isinstance(given["weights"], str) and given["weights"] == owner):
            raise ValueError(f"{name} needs weights='{owner}'")
    by_rule = given["weights"] is None and (given["p"] in (None, 2) or given["k"] is not None)
    named = isinstance(given["weights"], str) and given["weights"] == "patch"
    if given["patch_radius"] is not None and not (named or by_rule):
        raise ValueError("patch_radius needs weights='patch', or the rule's patches: without weights, p = 2 or k")
