"""What ``gpureg denoise`` is asked for besides the files: :class:`Settings`, and the plan that follows from it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .. import backends, weights
from ..graphs.edges import Metric
from ..images.choose import plan_denoising
from ..images.plan import AveragePatches, Centre, DenoisePlan
from ..images.run import run_plan
from ..model.problem import Norm
from ..noise.white import estimate_noise
from ..solvers import Jacobi, Solver
from ..tuning.fidelity import LamMethod
from ..weights import Weights

Averaging = Literal["none", "plain", "weighted"]
AVERAGING: dict[Averaging, AveragePatches] = {"none": False, "plain": True, "weighted": "weighted"}


@dataclass(frozen=True)
class Settings:
    """What is asked for besides the files; the fields are the options of ``gpureg denoise``."""

    sigma: float | None = None
    p: float | None = None
    lam: float | LamMethod | None = None
    radius: float | None = None
    metric: Metric | None = None
    norm: Norm = "vertex"
    solver: Literal["jacobi", "certified"] = "jacobi"
    max_iter: int | None = None
    tol: float | None = None
    eps: float | None = None
    kind: Literal["constant", "bilateral", "patch"] | None = None
    patch_radius: int = 2
    h: float | None = None
    patch_std: float | None = None
    sigma_space: float | None = None
    sigma_value: float | None = None
    centre: Centre | None = None
    average_patches: Averaging | None = None
    nearest: int | None = None
    backend: str = "auto"
    dtype: str | None = None
    memory: int | None = None
    axes: str | None = None
    each: tuple[str, ...] = ()
    spacing: tuple[float, ...] | Literal["file"] | None = None
    mask: Path | None = None
    guide: Path | None = None
    reference: Path | None = None
    explain: bool = False

    def run(self) -> dict[str, Any]:
        """What :func:`gpureg.images.run.run_plan` is told besides the plan and the picture."""
        # without the pixel itself a sweep at p = 2 is a plain mean, and no iteration that could swing
        plain = self.centre == "none" and self.solver == "jacobi"
        solver: str | Solver = Jacobi(damping=1) if plain else self.solver
        return {
            "solver": solver,
            "norm": self.norm,
            "backend": self.backend,
            "dtype": self.dtype,
            "memory": self.memory,
        }


def as_spacing(text: str) -> tuple[float, ...] | Literal["file"]:
    """Sizes of a voxel from a text such as ``"3,1,1"``, or the word ``"file"``.

    Raises
    ------
    ValueError
        Anything else.

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
    """Refuse options that would have no effect beside the others, whatever the file holds.

    Raises
    ------
    ValueError
        Which one, and what it needs.
    """
    filters = settings.p in (None, 2)
    kind = settings.kind
    if kind is None and (filters or settings.nearest is not None):
        kind = "patch"
    once = filters and settings.max_iter in (None, 0, 1) and settings.tol is None and settings.nearest is None
    one_sweep = "one sweep at p = 2: leave out --p, --max-iter, --tol and --nearest"
    averages = settings.average_patches in ("plain", "weighted")
    if settings.guide is not None and kind not in ("bilateral", "patch"):
        raise ValueError("--guide needs weights that compare pixels: --weights bilateral or patch")
    if settings.norm == "edge" and filters:
        raise ValueError("--norm edge needs a --p other than 2, where both norms are the same")
    if settings.nearest is not None and (kind != "patch" or (filters and settings.kind is None)):
        raise ValueError("--nearest needs --weights patch, or a --p other than 2 and no --weights")
    if settings.centre is not None and kind not in ("bilateral", "patch"):
        raise ValueError("--centre needs --weights bilateral or patch")
    if settings.centre is not None and not once:
        raise ValueError(f"--centre is about {one_sweep}")
    if settings.centre == "none" and settings.lam is not None:
        raise ValueError(
            "--centre none leaves the pixel itself out, so that --lam has no meaning: leave one of them out"
        )
    if (settings.centre is not None or averages) and settings.lam == 0:
        raise ValueError("--lam 0 leaves the pixel itself out: leave --lam out and say --centre none")
    if averages and kind != "patch":
        raise ValueError(f"--average-patches {settings.average_patches} needs --weights patch")
    if averages and not once:
        raise ValueError(f"--average-patches {settings.average_patches} is about {one_sweep}")
    if isinstance(settings.lam, str):
        unseen = {
            "--guide": settings.guide is not None,
            "--norm edge": settings.norm == "edge",
            "--centre": settings.centre is not None,
            "--average-patches": settings.average_patches is not None,
        }
        for option, is_given in unseen.items():
            if is_given:
                raise ValueError(f"--lam {settings.lam} searches without {option}: give --lam a number beside it")


def plan_of(
    part: npt.NDArray[Any],
    settings: Settings,
    spacing: tuple[float, ...] | None,
    axis: int | None,
    mask: npt.NDArray[np.bool_] | None,
) -> DenoisePlan:
    """What to do with a picture, a volume or a series.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.plan_denoising`.
    """

    def noise_of_it() -> float:
        return estimate_noise(part, channel_axis=axis, mask=mask)

    function: Weights | None = None
    reasons: dict[str, str] = {}
    if settings.kind is not None:
        noise = noise_of_it() if settings.sigma is None else settings.sigma
        lacks = {"bilateral": settings.sigma_value is None, "patch": settings.h is None}.get(settings.kind, False)
        if lacks and noise == 0:
            pass  # nothing to choose from, and nothing to do
        elif settings.kind == "constant":
            function = weights.constant()
        elif settings.kind == "bilateral":
            reach = 3.0 * min(spacing or (1.0,)) if settings.sigma_space is None else settings.sigma_space
            function = weights.bilateral(reach, 3 * noise if settings.sigma_value is None else settings.sigma_value)
            if settings.sigma_space is None or settings.sigma_value is None:
                in_space = "3 of the finest pixels" if settings.sigma_space is None else "given"
                reasons["reach"] = f"{in_space}, {'3 sigma' if settings.sigma_value is None else 'given'}"
        else:
            channels = 1 if axis is None else part.shape[axis]
            ndim = part.ndim - (axis is not None)
            samples = (2 * settings.patch_radius + 1) ** ndim if settings.patch_std is None else 1
            h = 0.6 * noise * math.sqrt(samples * channels) if settings.h is None else settings.h
            function = weights.patch(settings.patch_radius, h, sigma=noise, a=settings.patch_std)
            if (settings.patch_radius, settings.patch_std) == (Settings.patch_radius, Settings.patch_std):
                reasons["patch"] = "default"
            if settings.h is None:
                reasons["h"] = "rule: 0.6 sigma sqrt(samples)"
    plan = plan_denoising(
        part,
        sigma=settings.sigma,
        p=settings.p,
        lam=settings.lam,
        radius=settings.radius,
        metric=settings.metric,
        weights=function,
        guide=None if settings.guide is None else part,  # that there is one is what matters here
        nearest=settings.nearest,
        norm=settings.norm,
        solver=settings.run()["solver"],
        max_iter=settings.max_iter,
        tol=settings.tol,
        eps=settings.eps,
        mask=mask,
        spacing=spacing,
        channel_axis=axis,
        backend=settings.backend,
        dtype=settings.dtype,
        memory=settings.memory,
    )
    if plan.sigma is None:  # it decided nothing, but is reported
        plan = replace(plan, sigma=noise_of_it(), estimated=True)
    if settings.average_patches is not None:
        plan = replace(plan, average_patches=AVERAGING[settings.average_patches])
        reasons["averaging"] = "given"
    if settings.centre is not None:
        plan = replace(plan, centre=settings.centre)
    if settings.centre == "none":
        plan = replace(plan, lam=0.0)
        reasons["lam"] = "the centre is left out, as given"
    return replace(plan, reasons={**plan.reasons, **reasons})


def rehearse(settings: Settings) -> None:
    """Raise what any picture would: options that are wrong whatever the file holds.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.jobs.denoise.denoise_file`.
    """
    expect_fitting(settings)
    backends.get(settings.backend, np.float32 if settings.dtype is None else settings.dtype)
    noise = np.random.default_rng(0).standard_normal((8, 8))
    if isinstance(settings.lam, str):  # which is searched for in each file
        settings = replace(settings, lam=None)
    if settings.spacing is not None:  # in whose units the radius is
        settings = replace(settings, radius=None)
    plan = plan_of(noise, settings, None, None, None)
    run = {**settings.run(), "backend": "numpy", "memory": None}
    run_plan(replace(plan, max_iter=min(plan.max_iter, 1)), noise, **run)
