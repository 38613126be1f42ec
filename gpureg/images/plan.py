"""The parameters with which an image is denoised: :class:`DenoisePlan`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..frame import Frame
from ..graphs.edges import Metric
from ..noise.impulses import ImpulseRule
from ..noise.photon import PhotonNoise
from ..noise.report import NoiseReport
from ..tuning.explanation import table
from ..weights import Bilateral, Compared, Constant, Patch, Smoothed, Weights
from .passes import PassNoise, PatchPass, many, patches_of, windows_of

Centre = Literal["once", "largest", "none"]
CENTRES: tuple[Centre, ...] = ("once", "largest", "none")
AveragePatches = bool | Literal["weighted"]


@dataclass(frozen=True)
class DenoisePlan:
    """The parameters of :func:`denoise_image`, chosen or given.

    Attributes
    ----------
    sigma : float or None
        Standard deviation of the noise, in the image's units, the root mean square over channels and pixels; None if it
        was not given and not needed, NaN if it cannot be told.
    estimated : bool
        Whether it was estimated.
    weights : Weights or array
    radius, metric
        The neighbourhood of :class:`gpureg.GridGraph`.
    p, lam, max_iter, tol, eps
        As in :func:`gpureg.regularize`; with ``max_iter`` 0 the image does not change.
    spacing : tuple of float or None
        Size of a pixel along each axis; None if `radius` is in cells.
    window : tuple of int
        Sides of the neighbourhood in cells.
    centre : {"once", "largest", "none"}
        Weight of the pixel itself for lam = 2 in one sweep at p = 2: 1, the largest weight of its neighbours, or 0
        (then lam is 0).
    average_patches : bool or "weighted"
        Whether whole patches are estimated, and a pixel is the mean over all patches that cover it; "weighted" weights
        each patch by the sum of its weights.
    average_radius : int or None
        Radius of these patches; None for the radius of the weights' patches.
    k : int or None
        Number of edges that each pixel uses, those to the nearest patches; None for the whole window.
    sigmas : tuple of float
        Standard deviation of the noise of each channel; empty if it is not known.
    photon : tuple of (PhotonNoise or None)
        For each channel how the noise grows with the signal, if it does; empty for none. The weights and `lam` are for
        a pixel with noise `sigma`; :func:`run_plan` scales them by the noise at each pixel of a smoothed image.
    impulses : tuple of (ImpulseRule or None)
        For each channel how impulses (single pixels that have nothing to do with their neighbours) are found. They are
        replaced by the median of their neighbours; lam is 0 where all channels have one. Empty for none.
    units : tuple of float
        What the channels are divided by before they are compared, and multiplied with after; empty for 1.
    flat_side : int
        Areas of exactly equal values with this side or more, which hold no noise, take no part, like pixels outside a
        mask; 0 if all take part.
    frame : Frame or None
        The offset and the unit of the values with which a single sweep computes, so that parts of the image give the
        bits of the whole; None to choose them from the values.
    passes : tuple of PatchPass
        Passes on groups of similar patches, which follow the filter in this order: each finds its groups in the last
        result, and estimates the noisy patches of a group together. Empty for the filter alone.
    noise : PassNoise or None
        The noise that these passes remove.
    groups : tuple of (channels, DenoisePlan)
        Channels that are denoised by themselves, each group with its plan; empty if all are denoised together. Then the
        other attributes are those of the first group, except `sigma`, `sigmas`, `same` and `report`.
    same : tuple of int
        With groups, for each channel the first channel that has exactly the same values, and whose result it gets.
    report : NoiseReport or None
        What was found of the noise, if it was estimated; see :func:`gpureg.describe_noise`.
    reasons : mapping of str to str
        Reasons for the parameters that were not given; see :meth:`explain`.

    Notes
    -----
    The filter is the sweep or the iterations that `weights`, `radius`, `p`, `lam` and `max_iter` describe.
    ``dataclasses.replace(plan, passes=())`` is the plan of the filter alone; the reason for the passes, or why there
    are none, is ``reasons["groups"]``.
    """

    sigma: float | None
    estimated: bool
    weights: Weights | npt.ArrayLike
    radius: float
    metric: Metric
    p: float
    lam: float | npt.ArrayLike
    max_iter: int
    tol: float | None = None
    eps: float | None = None
    spacing: tuple[float, ...] | None = None
    window: tuple[int, ...] = ()
    centre: Centre = "once"
    average_patches: AveragePatches = False
    average_radius: int | None = None
    k: int | None = None
    sigmas: tuple[float, ...] = ()
    photon: tuple[PhotonNoise | None, ...] = ()
    impulses: tuple[ImpulseRule | None, ...] = ()
    units: tuple[float, ...] = ()
    flat_side: int = 0
    frame: Frame | None = None
    passes: tuple[PatchPass, ...] = ()
    noise: PassNoise | None = None
    groups: tuple[tuple[tuple[int, ...], DenoisePlan], ...] = ()
    same: tuple[int, ...] = ()
    report: NoiseReport | None = field(default=None, compare=False, repr=False)
    reasons: Mapping[str, str] = field(default_factory=dict, compare=False)

    def compared(self) -> tuple[Any, str]:
        """Return the innermost weight function, and a description of the blur and colours that it compares."""
        w: Any = self.weights
        seen = ""
        while isinstance(w, Compared):
            if isinstance(w, Smoothed):
                seen = (", opponent colours" if w.opponent else "") + f", blurred by {w.std:.2g}" * (w.std > 0)
            w = w.weights
        return w, seen

    @property
    def replaces_impulses(self) -> bool:
        """Whether impulses are replaced in any channel."""
        return any(rule is not None for rule in self.impulses)

    def describe(self) -> str:
        """Describe the plan in one line."""
        if self.groups:
            alike = {plan.describe() for _, plan in self.groups}
            if len(alike) == 1:
                return f"{_named(self.groups)}: {alike.pop()}"
            return "; ".join(f"{_named((group,))}: {group[1].describe()}" for group in self.groups)
        before = "impulses replaced, then " if self.replaces_impulses else ""
        if self.max_iter == 0:
            if self.replaces_impulses:
                return "impulses replaced by the median of their neighbours"
            found = np.ndim(self.lam) == 0 and self.lam == math.inf
            why = self.reasons.get("idle", "no noise was found")
            return f"nothing to do: {why}" if found else "nothing to do: 0 iterations"
        w, seen = self.compared()
        window = "x".join(map(str, self.window)) + " window"
        if self.metric != "chebyshev":
            window = (
                f"{2 * len(self.window)} neighbours"
                if self.metric == "cityblock" and max(self.window) <= 3
                else f"{window} ({self.metric})"
            )
        if isinstance(w, Patch):
            shape = "flat" if w.patch_sigma is None else f"Gaussian (patch_sigma = {w.patch_sigma:.3g})"
            patches = "x".join([str(2 * w.patch_radius + 1)] * len(self.window)) + f" {shape} patches"
            kind = f"nonlocal weights{seen}, {window}, {patches}, h = {w.h:.4g}"
            kind += ", averaged patches" if self.average_patches else ""
            kind += f", {self.k} nearest" if self.k else ""
        elif isinstance(w, Bilateral):
            kind = f"bilateral weights, {window}, sigma_space = {w.sigma_space:.4g}"
            kind += f", sigma_value = {w.sigma_value:.4g}"
        elif isinstance(w, Constant):
            kind = f"constant weights, {window}"
        else:
            kind = f"{type(w).__name__} weights, {window}"
        lam = f"{float(self.lam):.4g}" if np.ndim(self.lam) == 0 else "a map"  # type: ignore[arg-type]
        lam += " of the largest weight" if self.centre == "largest" else ""
        iterations = "1 iteration" if self.max_iter == 1 else f"at most {self.max_iter} iterations"
        kind += ", adapted to noise that grows with the signal" if self.photon else ""
        after = f", then {many(self.passes)} on groups of similar patches" if self.passes else ""
        return f"{before}{kind}; p = {self.p:g}, lam = {lam}, {iterations}{after}"

    def _origin(self) -> str:
        """Return where an estimate of the noise comes from."""
        if any(line is not None for line in self.photon):
            return "estimated: root mean square over the image"
        if self.report is not None and any(x.correlated or x.period == 2 for x in self.report.channels):
            return "estimated from pixels 6 apart"
        return "estimated from the image where its texture is weakest"

    def explain(self) -> str:
        """Describe each parameter in one line: its value and the reason for it."""
        if self.groups:
            return "\n".join(f"{_named((group,))}\n{group[1].explain()}" for group in self.groups)
        (w, seen), ndim, one = self.compared(), len(self.window), np.ndim(self.lam) == 0
        rows = {"noise": ("unknown", "not looked for: it decides nothing")}
        if self.sigma is not None:
            rows["noise"] = f"sigma = {self.sigma:.4g}", self._origin() if self.estimated else "given"
        if any(line is not None for line in self.photon):
            lines = ", ".join(f"{line.gain:.3g}" for line in self.photon if line is not None)
            rows["growth"] = f"gain = {lines}", "the noise grows with the signal: a map of it is used"
        if self.flat_side:
            rows["flat"] = "left out", "large areas of equal values hold no noise"
        if self.replaces_impulses:
            rows["impulses"] = "replaced", "single pixels have nothing to do with their neighbours"
        if self.max_iter == 0:
            return f"{table(rows)}\n{self.describe()}"
        rows["weights"] = type(w).__name__.lower(), self.reasons.get("weights", "given")
        if isinstance(w, Patch):
            shape = "flat" if w.patch_sigma is None else f"Gaussian, patch_sigma = {w.patch_sigma:.3g}"
            sides = "x".join([str(2 * w.patch_radius + 1)] * ndim)
            rows["patch"] = f"{sides}, {shape}", self.reasons.get("patch", "given")
            if seen:
                rows["compared"] = seen.removeprefix(", "), self.reasons.get("patch", "given")
            rows["h"] = f"{w.h:.4g}", self.reasons.get("h", "given")
        if isinstance(w, Bilateral):
            rows["reach"] = (
                f"{w.sigma_space:.4g} in space, {w.sigma_value:.4g} in value",
                self.reasons.get("reach", "given"),
            )
        rows["window"] = f"{'x'.join(map(str, self.window))}, {self.metric}", self.reasons.get("window", "given")
        if self.average_patches:
            radius = w.patch_radius if self.average_radius is None else self.average_radius
            kind = "by their weights" if self.average_patches == "weighted" else "plainly"
            sides = "x".join([str(2 * radius + 1)] * ndim)
            why = self.reasons.get("averaging", self.reasons.get("patch", "given"))
            rows["averaging"] = f"{sides} patches, {kind}", why
        if self.k is not None:
            rows["k"] = f"{self.k}", self.reasons.get("k", "given")
        rows["p"] = f"{self.p:g}", self.reasons.get("p", "given")
        rows["lam"] = f"{float(np.asarray(self.lam)):.4g}" if one else "a map", self.reasons.get("lam", "given")
        rows["iterations"] = f"at most {self.max_iter}", self.reasons.get("iterations", "given")
        if self.tol is not None:
            rows["tol"] = f"{self.tol:g}", self.reasons.get("tol", "given")
        if self.eps is not None or self.p != 2:
            rows["eps"] = (
                ("1e-3 of the spread, 0 if certified", "rule") if self.eps is None else (f"{self.eps:g}", "given")
            )
        if "groups" in self.reasons:
            size = f"{many(self.passes)}, {windows_of(self.passes)}; " if self.passes else ""
            rows["groups"] = patches_of(self.passes), f"{size}{self.reasons['groups']}"
        return table(rows)


def _named(groups: tuple[tuple[tuple[int, ...], DenoisePlan], ...]) -> str:
    """Return the name of groups of channels, such as "channels 0 and 2 together, channel 1"."""
    if len(groups) > 1 and all(len(channels) == 1 for channels, _ in groups):
        return "each channel by itself"
    return ", ".join(
        f"channel {channels[0]}" if len(channels) == 1 else f"channels {' and '.join(map(str, channels))} together"
        for channels, _ in groups
    )
