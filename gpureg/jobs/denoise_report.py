"""What was done with a picture file: as JSON can hold it, and in a few lines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .._version import __version__
from ..files.pictures import Picture
from ..images.plan import DenoisePlan
from ..model.result import Result
from .report import WHITE, about, axes_line, done_line, left_out, quality_line, run_of


def report_of(
    runs: Sequence[tuple[DenoisePlan, Result]], source: Path, target: Path, picture: Picture, *, through: str = ""
) -> dict[str, Any]:
    """A report as JSON can hold it; `through` names the axes whose slices were treated one by one."""
    report = about(source, target, picture)
    if through:
        report |= {"each": through, "slices": [run_of(plan, result) for plan, result in runs]}
    else:
        report |= run_of(*runs[0])
    report |= {
        "backend": runs[0][1].backend,
        "seconds": round(sum(result.seconds for _, result in runs), 4),
        "version": __version__,
    }
    return report


def as_lines(report: dict[str, Any]) -> str:
    """A report for a reader: noise, filter, done, and what else there is to say."""
    runs = report.get("slices", [report])
    white = WHITE.get(report["dtype"], "")
    sigmas = [run["sigma"] for run in runs]
    sigma = f"{min(sigmas):.4g}" + (f" to {max(sigmas):.4g}" if len(runs) > 1 else "")
    origin = "estimated" if runs[0]["sigma_estimated"] else "as given"
    lines = [axes_line(report)] if not report.get("axes_named", True) else []
    slices = f" in each of {len(runs)} slices along {report['each']}" if "each" in report else ""
    lines.append(f"noise    sigma = {sigma}{white}, {origin}{slices}")
    same = len({run["filter"] for run in runs}) == 1
    more = "; edge norm" if report.get("norm") == "edge" else ""
    more += f"; guided by {report['guide']}" if "guide" in report else ""
    lines.append(f"filter   {runs[0]['filter']}{more}{'' if same else ' (first slice)'}")
    if "lam_search" in report and runs[0]["iterations"]:
        lines.append(f"lam      {runs[0]['lam']:.4g}; {runs[0]['lam_reason']}{'' if same else ' (first slice)'}")
    if report.get("nan") or report.get("outside_mask"):
        lines.append(left_out(report.get("nan", 0), report.get("outside_mask", 0)))
    if "psnr" in report:
        lines.append(quality_line(report["psnr"], report["ssim"]))
    if report.get("gap") is not None:
        lines.append(f"minimum  the energy, {report['energy'][-1]:.6g}, is at most {report['gap']:.2g} above it")
    lines.append(done_line(report))
    return "\n".join(lines)
