"""The options of ``gpureg denoise``, :class:`Settings`, and the plan that follows from them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from .. import backends
from ..graphs.edges import Metric
from ..images.choose import each_channel, plan_denoising
from ..images.noise import Noise
from ..images.options import CHOICE, Choice, WeightKind
from ..images.passes import Quality
from ..images.plan import AveragePatches, Centre, DenoisePlan
from ..images.raster import Raster
from ..images.run import run_plan
from ..model.problem import Norm
from ..noise.photon import estimate_photon_noise
from ..tuning.fidelity import LamMethod

Averaging = Literal["none", "plain", "weighted"]
AVERAGING: dict[Averaging, AveragePatches] = {"none": False, "plain": True, "weighted": "weighted"}


@dataclass(frozen=True)
class Settings:
    """The options of ``gpureg denoise``, without IN and OUT."""

    sigma: float | tuple[float, ...] | Literal["photon"] | None = None
    offset: float | None = None
    p: float | None = None
    lam: float | LamMethod | None = None
    radius: float | None = None
    metric: Metric | None = None
    norm: Norm = "vertex"
    solver: Literal["jacobi", "certified"] = "jacobi"
    max_iter: int | None = None
    tol: float | None = None
    eps: float | None = None
    weights: WeightKind | None = None
    patch_radius: int | None = None
    h: float | None = None
    patch_sigma: float | None = None
    sigma_space: float | None = None
    sigma_value: float | None = None
    centre: Centre | None = None
    average_patches: Averaging | None = None
    k: int | None = None
    passes: int | None = None
    quality: Quality | None = None
    backend: str = "auto"
    dtype: str | None = None
    memory: int | None = None
    axes: str | None = None
    each: tuple[str, ...] = ()
    spacing: tuple[float, ...] | Literal["file"] | None = None
    mask: Path | None = None
    nodata: float | None = None
    guide: Path | None = None
    reference: Path | None = None
    explain: bool = False

    def run(self) -> dict[str, Any]:
        """Return the options for :func:`gpureg.run_plan`."""
        return {name: getattr(self, name) for name in ("solver", "norm", "backend", "dtype", "memory")}


def as_spacing(text: str) -> tuple[float, ...] | Literal["file"]:
    """Parse sizes of a voxel such as ``"3,1,1"``, or the word ``"file"``.

    Raises
    ------
    ValueError
        The text is neither.

    Examples
    --------
    >>> as_spacing("3,1,1")
    (3.0, 1.0, 1.0)
    """
    if text.strip().lower() == "file":
        return "file"
    try:
        sizes = tuple(float(size) for size in text.split(","))
    except ValueError:
        sizes = ()
    if not sizes or not all(math.isfinite(size) and size > 0 for size in sizes):
        raise ValueError(f"spacing must be finite numbers > 0 such as 3,1,1, or the word file, got {text!r}")
    return sizes


def expect_fitting(settings: Settings) -> None:
    """Refuse combinations of options that have no effect for any file.

    Raises
    ------
    ValueError
        The message names the option and what it needs.
    """
    if settings.offset is not None and settings.sigma != "photon":
        raise ValueError("--offset needs --sigma photon")
    filters = settings.p in (None, 2)
    kind = settings.weights
    if kind is None and (filters or settings.k is not None):
        kind = "patch"
    once = filters and settings.max_iter in (None, 0, 1) and settings.tol is None and settings.k is None
    one_sweep = "one sweep at p = 2: leave out --p, --max-iter, --tol and --k"
    averages = settings.average_patches in ("plain", "weighted")
    if settings.guide is not None and kind not in ("bilateral", "patch"):
        raise ValueError("--guide needs weights that compare pixels: --weights bilateral or patch")
    if settings.norm == "edge" and filters:
        raise ValueError("--norm edge needs a --p other than 2: for 2 both norms are the same")
    if settings.k is not None and (kind != "patch" or (filters and settings.weights is None)):
        raise ValueError("--k needs --weights patch, or a --p other than 2 and no --weights")
    if settings.centre is not None and kind not in ("bilateral", "patch"):
        raise ValueError("--centre needs --weights bilateral or patch")
    if settings.centre is not None and not once:
        raise ValueError(f"--centre is for {one_sweep}")
    if settings.centre == "none" and settings.lam is not None:
        raise ValueError(
            "--centre none leaves the pixel itself out, so that --lam has no effect: leave one of them out"
        )
    if (settings.centre is not None or averages) and settings.lam == 0:
        raise ValueError("--lam 0 leaves the pixel itself out: leave --lam out and give --centre none")
    if averages and kind != "patch":
        raise ValueError(f"--average-patches {settings.average_patches} needs --weights patch")
    if averages and not once:
        raise ValueError(f"--average-patches {settings.average_patches} is for {one_sweep}")
    if settings.passes not in (None, 1):
        if settings.guide is not None:
            raise ValueError(f"--passes {settings.passes} does not work with --guide")
        if settings.max_iter == 0:
            raise ValueError(f"--passes {settings.passes} needs at least one iteration: leave --max-iter 0 out")
    if isinstance(settings.lam, str):
        unseen = {
            "--guide": settings.guide is not None,
            "--norm edge": settings.norm == "edge",
            "--centre": settings.centre is not None,
            "--average-patches": settings.average_patches is not None,
        }
        for option, is_given in unseen.items():
            if is_given:
                raise ValueError(f"--lam {settings.lam} does not work with {option}: give --lam a number")


def plan_of(raster: Raster, settings: Settings, spacing: tuple[float, ...] | None) -> DenoisePlan:
    """Make the plan for a picture, a volume or a series.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.plan_denoising`.
    """
    given = {name: getattr(settings, name) for name in CHOICE if hasattr(settings, name)}
    if settings.offset is not None:
        given["sigma"] = estimate_photon_noise(
            raster.values, offset=settings.offset, channel_axis=raster.channel_axis, mask=raster.inside
        )
    averaging = None if settings.average_patches is None else AVERAGING[settings.average_patches]
    # the plan depends only on whether there is a guide
    guide = None if settings.guide is None else raster.values
    given |= {"spacing": spacing, "guide": guide, "average_patches": averaging, "mask": None}
    if "C" in settings.each and raster.channels > 1:
        plan = each_channel(raster, **cast("Choice", given))
    else:
        plan = plan_denoising(raster, **cast("Choice", given))
    if settings.offset is not None:
        plan = replace(plan, estimated=True)
    if plan.sigma is None:  # not used, but reported
        plan = replace(plan, sigma=Noise(None).found(raster).sigma, estimated=True)
    return plan


def rehearse(settings: Settings) -> None:
    """Raise the errors of options that are wrong for any file.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.jobs.denoise.denoise_file`.
    """
    expect_fitting(settings)
    backends.get(settings.backend, np.float32 if settings.dtype is None else settings.dtype)
    noise = np.random.default_rng(0).standard_normal((8, 8))
    if isinstance(settings.lam, str):  # the search needs the file
        settings = replace(settings, lam=None)
    if settings.spacing is not None:  # the radius is in its units
        settings = replace(settings, radius=None)
    if settings.sigma == "photon":  # so small an image does not tell the gain
        settings = replace(settings, sigma=1.0, offset=None)
    elif isinstance(settings.sigma, tuple):
        if not all(math.isfinite(sigma) and sigma >= 0 for sigma in settings.sigma):
            raise ValueError(f"--sigma must be finite and >= 0 in each channel, got {settings.sigma}")
        settings = replace(settings, sigma=settings.sigma[0])
    raster = Raster.of(noise)
    plan = plan_of(raster, settings, None)
    run = {**settings.run(), "backend": "numpy", "memory": None}
    run_plan(replace(plan, max_iter=min(plan.max_iter, 1)), raster, **run)
