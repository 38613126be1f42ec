"""Options that several doors of images take and hand on as one, and how they are checked."""

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
from .plan import CENTRES, AveragePatches, Centre

WeightKind = Literal["constant", "bilateral", "patch"]
WEIGHTS: tuple[WeightKind, ...] = ("constant", "bilateral", "patch")
# Options that belong to one kind of weights alone.
OF_WEIGHTS: dict[str, WeightKind] = {
    "h": "patch",
    "patch_sigma": "patch",
    "sigma_space": "bilateral",
    "sigma_value": "bilateral",
}


class OnPixels(Run, total=False):
    """Which pixels take part, and what weights compare.

    Attributes
    ----------
    guide : array of the image's pixels, with or without channels, optional
        What the weights compare instead of the image.
    mask : bool array of the image's pixels, optional
        True where a pixel takes part; None for everywhere.
    spacing : sequence of float, one per axis without that of the channels, optional
        Size of a pixel along each axis; None means 1.
    channel_axis : int, optional
        The axis of the channels; None for a grey image.
    """

    guide: npt.ArrayLike | None
    mask: npt.ArrayLike | None
    spacing: Sequence[float] | None
    channel_axis: int | None


class Filter(OnPixels, total=False):
    """What nonlocal means and the bilateral filter have in common: one step at p = 2.

    Attributes
    ----------
    lam : float or array of the image's pixels, default 2
        Twice the weight of the pixel itself, in the units that `centre` says.
    centre : {"once", "largest", "none"}, default "once"
        What lam = 2 makes of the pixel itself.
    metric : {"chebyshev", "euclidean", "cityblock"}, default "chebyshev"
        Shape of the window.
    border : {"clip", "reflect", "symmetric", "nearest", "wrap", "constant"}, default "clip"
        What a window that reaches over the border sees.
    constant : float, default 0
        The value beyond the border for "constant".
    """

    lam: float | npt.ArrayLike
    centre: Centre
    metric: Metric
    border: Border
    constant: float


class Choice(OnPixels, Model, total=False):
    """What a plan is made from; what is left out, None, is chosen.

    Attributes
    ----------
    sigma : float or array of the image's pixels, optional
        Standard deviation of the noise.
    p : float, optional
        Degree of regularity.
    lam : float, array of the image's pixels, or the name of a search, optional
        Fidelity.
    radius, metric
        The window.
    weights : Weights, array with one value per directed edge, or a kind of weights, optional
    h, patch_radius, patch_sigma
        What the kind "patch" is made of.
    sigma_space, sigma_value
        What the kind "bilateral" is made of.
    k : int, optional
        Edges of each pixel that stay, those to the nearest patches.
    centre, average_patches
        What one sweep does besides.
    max_iter : int, optional
        Iterations at most.
    """

    sigma: float | npt.ArrayLike | None
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


class Denoise(Choice, total=False):
    """What :func:`gpureg.denoise_image` takes: a choice, and what of the model no plan says.

    Attributes
    ----------
    gamma, coupled, update_weights
        As in :func:`gpureg.regularize`.
    """

    gamma: str | npt.ArrayLike
    coupled: bool
    update_weights: int | None


class RunPlan(Run, total=False):
    """What :func:`gpureg.run_plan` takes besides the plan and the image.

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
    """The options that some have and their bases do not, None each."""
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
        The parameter, for the error.
    value : float or array
        What was given.
    shape : tuple of int
        The image's, without its channels.
    low, above, finite
        The range of a number, as in :func:`gpureg.checks.number`. What an array holds is checked where it is used.

    Returns
    -------
    float or array
        A number as it came, or the array.

    Raises
    ------
    TypeError, ValueError
        Neither, a number out of its range, an array of another shape.
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
    """Refuse options of a run that are wrong whatever is run; ``backend`` and ``dtype`` are checked at use.

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
    """Refuse what no filter can be made from, for an image of this shape without its channels.

    Raises
    ------
    TypeError, ValueError
        A number out of its range, an unknown word.
    """
    check_run(asked)
    choice("centre", asked["centre"], CENTRES)
    choice("border", asked["border"], BORDERS)
    choice("metric", asked["metric"], METRICS)
    number("constant", asked["constant"])
    map_of("lam", asked["lam"], shape, low=0, finite=False)


def check_averaging(average_patches: Any) -> None:
    """Refuse what is no value of `average_patches`.

    Raises
    ------
    ValueError
    """
    if not (isinstance(average_patches, bool | np.bool_) or average_patches == "weighted"):
        raise ValueError(f"average_patches must be True, False or 'weighted', got {average_patches!r}")


def check_choice(asked: Choice, shape: tuple[int, ...]) -> None:
    """Refuse what no plan can be made from, for an image of this shape without its channels.

    Raises
    ------
    TypeError, ValueError
        A number out of its range, an unknown word, options that belong to other weights.
    """
    check_run(asked)
    given: Mapping[str, Any] = cast("Mapping[str, Any]", asked)
    for name, low in (("max_iter", 0), ("k", 1), ("patch_radius", 0)):
        if given[name] is not None:
            integer(name, given[name], low=low)
    for name in ("tol", "eps"):
        if given[name] is not None:
            number(name, given[name], low=0)
    for name in ("p", "h", "patch_sigma", "sigma_space", "sigma_value"):
        if given[name] is not None:
            number(name, given[name], above=0, finite=not name.startswith("sigma_"))
    if given["radius"] is not None:
        number("radius", given["radius"], finite=False)  # how far it must reach the grid says
    if given["sigma"] is not None:
        map_of("sigma", given["sigma"], shape, low=0)
    lam = given["lam"]
    if isinstance(lam, str) and lam not in LAM_METHODS:
        raise ValueError(f"lam must be a number, one per pixel, or one of {', '.join(LAM_METHODS)}, got {lam!r}")
    if lam is not None and not isinstance(lam, str):
        map_of("lam", lam, shape, low=0, finite=False)
    choice("norm", given["norm"], NORMS)
    if given["metric"] is not None:
        choice("metric", given["metric"], METRICS)
    if given["centre"] is not None:
        choice("centre", given["centre"], CENTRES)
        if given["centre"] == "none" and lam is not None:
            raise ValueError("centre='none' leaves the pixel itself out, so that lam has no meaning: leave one out")
    if given["average_patches"] is not None:
        check_averaging(given["average_patches"])
    one_step = given["centre"] is not None or given["average_patches"]
    if one_step and lam is not None and not isinstance(lam, str) and np.ndim(lam) == 0 and lam == 0:
        raise ValueError("lam = 0 leaves the pixel itself out: leave lam out and say centre='none'")
    if isinstance(given["weights"], str):
        choice("weights", given["weights"], WEIGHTS)
    for name, owner in OF_WEIGHTS.items():
        if given[name] is not None and not (isinstance(given["weights"], str) and given["weights"] == owner):
            raise ValueError(f"{name} needs weights='{owner}'")
    by_rule = given["weights"] is None and (given["p"] in (None, 2) or given["k"] is not None)
    named = isinstance(given["weights"], str) and given["weights"] == "patch"
    if given["patch_radius"] is not None and not (named or by_rule):
        raise ValueError("patch_radius needs weights='patch', or the patches of the rule for p = 2 or k")
