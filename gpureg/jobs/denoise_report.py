"""The report on a denoised picture file, for JSON and as text: :class:`DenoiseReport`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .._version import __version__
from ..images.plan import DenoisePlan
from ..model.problem import Norm
from ..model.result import Result
from .report import WHITE, axes_line, done_line, left_out, note_lines, number, quality_line, run_of


@dataclass(frozen=True)
class DenoiseReport:
    """The report on a denoised picture, volume or series.

    Attributes
    ----------
    files : mapping
        What :func:`gpureg.jobs.report.about` returns for the files and the picture.
    runs : tuple of (DenoisePlan, Result)
        One for each denoised slice; the results have no values.
    through : str, default ""
        Letters of the axes whose slices were processed one by one.
    lam_search : str, optional
        The method that searched for lam.
    norm : {"vertex", "edge"}, default "vertex"
    spacing : mapping of str to float, optional
        Size of a pixel along each axis, by its letter.
    mask, guide, reference : Path, optional
        Other files that were read.
    outside_mask, nan, nodata : int, default 0
        Numbers of pixels that the mask excludes, that are NaN, and that have the value for no data.
    parts : int, default 0
        Number of parts in which the file was read and denoised; 0 if it was in memory.
    quality : pair of (psnr, ssim), optional
        For the input and the output, if there is a reference.
    explained : str, optional
        The plans, if they were asked for.
    """

    files: Mapping[str, Any]
    runs: tuple[tuple[DenoisePlan, Result], ...]
    through: str = ""
    lam_search: str | None = None
    norm: Norm = "vertex"
    spacing: Mapping[str, float] | None = None
    mask: Path | None = None
    outside_mask: int = 0
    nan: int = 0
    nodata: int = 0
    parts: int = 0
    guide: Path | None = None
    reference: Path | None = None
    quality: tuple[tuple[float, float], tuple[float, float]] | None = None
    explained: str | None = None

    @property
    def axes_guessed(self) -> bool:
        """Whether the file does not name the axes of its stack."""
        return not self.files.get("axes_named", True)

    @property
    def seconds(self) -> float:
        """Duration of all runs."""
        return round(sum(result.seconds for _, result in self.runs), 4)

    @property
    def backend(self) -> str:
        """Backend of the runs."""
        return self.runs[0][1].backend

    def measured(self) -> dict[str, dict[str, float | str]]:
        """Return PSNR and SSIM of input and output by name, for JSON; empty without a reference."""
        if self.quality is None:
            return {}
        return {
            name: {which: number(values[i]) for which, values in zip(("input", "output"), self.quality, strict=True)}
            for i, name in enumerate(("psnr", "ssim"))
        }

    def as_json(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON."""
        runs = [run_of(plan, result) for plan, result in self.runs]
        report = {**self.files, **({"each": self.through, "slices": runs} if self.through else runs[0])}
        report |= {"backend": self.backend, "seconds": self.seconds, "version": __version__}
        if self.lam_search is not None:
            report["lam_search"] = self.lam_search
        if self.norm != "vertex":
            report["norm"] = self.norm
        if self.spacing is not None:
            report["spacing"] = dict(self.spacing)
        if self.mask is not None:
            report |= {"mask": str(self.mask), "outside_mask": self.outside_mask}
        if self.nan:
            report["nan"] = self.nan
        if self.nodata:
            report["nodata"] = self.nodata
        if self.parts:
            report["parts"] = self.parts
        if self.guide is not None:
            report["guide"] = str(self.guide)
        if self.quality is not None:
            report |= {"reference": str(self.reference), **self.measured()}
        if self.explained is not None:
            report["explain"] = self.explained.splitlines()
        return report

    def lines(self) -> list[str]:
        """Return the report as lines of text."""
        report, (plan, result) = self.as_json(), self.runs[0]
        plans = [plan for plan, _ in self.runs]
        sigmas = [plan.sigma for plan in plans if plan.sigma is not None]
        sigma = f"{min(sigmas):.4g}" + (f" to {max(sigmas):.4g}" if len(sigmas) > 1 else "")
        origin = "estimated" if plan.estimated else "as given"
        lines = [axes_line(report)] if self.axes_guessed else []
        slices = f" in each of {len(plans)} slices along {self.through}" if self.through else ""
        lines.append(f"noise    sigma = {sigma}{WHITE.get(self.files['dtype'], '')}, {origin}{slices}")
        lines += _noise_lines(plan)
        filters = [plan.describe() for plan in plans]
        first = "" if len(set(filters)) == 1 else " (first slice)"
        more = "; edge norm" if self.norm == "edge" else ""
        more += f"; guided by {self.guide}" if self.guide is not None else ""
        lines.append(f"filter   {filters[0]}{more}{first}")
        if self.lam_search is not None and result.iterations:
            lines.append(f"lam      {float(plan.lam):.4g}; {plan.reasons.get('lam', 'given')}{first}")  # type: ignore[arg-type]
        if self.nan or self.outside_mask or self.nodata:
            lines.append(left_out(self.nan, self.outside_mask, self.nodata))
        if self.quality is not None:
            lines.append(quality_line(**self.measured()))
        if result.gap is not None and not self.through:
            lines.append(f"minimum  the energy, {result.energy[-1]:.6g}, is at most {result.gap:.2g} above it")
        lines += note_lines(self.files)
        lines.append(done_line(report))
        return lines


def _noise_lines(plan: DenoisePlan) -> list[str]:
    """Return lines on noise that is not white, from the first plan."""
    own = [each for _, each in plan.groups] or [plan]
    gains = [line.gain for each in own for line in each.photon if line is not None]
    lines = []
    if gains:
        known = ", ".join(f"{gain:.3g}" for gain in gains)
        lines.append(f"growth   the noise grows with the value (gain {known}): a map of it was used")
    if plan.report is not None and any(each.replaces_impulses for each in own):
        share = max(channel.impulses for channel in plan.report.channels if channel.has_impulses)
        lines.append(f"impulses {100 * share:.2g} % of the pixels were replaced by what their neighbours say")
    return lines
