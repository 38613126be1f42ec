"""What was done with a picture file: as JSON can hold it, and in a few lines."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ._version import __version__
from .files.pictures import Picture
from .images.plan import DenoisePlan
from .model.result import Result

_WHITE = {"uint8": " of 255", "uint16": " of 65535"}


def number(value: float) -> float | str:
    """A number as JSON can hold it."""
    return value if math.isfinite(value) else str(value)


def _run(plan: DenoisePlan, result: Result) -> dict[str, Any]:
    return {
        "sigma": plan.sigma,
        "sigma_estimated": plan.estimated,
        "filter": plan.describe(),
        "p": plan.p,
        "lam": number(float(np.asarray(plan.lam))),
        "lam_reason": plan.reasons.get("lam", "given"),
        "radius": plan.radius,
        "metric": plan.metric,
        "iterations": result.iterations,
        "stop": result.stop.name.lower(),
        "energy": [number(energy) for energy in result.energy.tolist()],
        "eps": result.eps,
    } | ({} if result.gap is None else {"gap": number(result.gap)})


def about(source: Path, target: Path, picture: Picture) -> dict[str, Any]:
    """What a report says of the files and the picture in them, as JSON can hold it."""
    files: dict[str, Any] = {
        "input": str(source),
        "output": str(target),
        "width": picture.size("X"),
        "height": picture.size("Y"),
        "channels": picture.channels,
        "dtype": str(picture.pixels.dtype),
        "alpha": picture.alpha is not None,
    }
    if picture.is_stack:
        files |= {"axes": picture.axes, "axes_named": picture.tags.named, "shape": list(picture.pixels.shape)}
    return files


def report_of(
    runs: Sequence[tuple[DenoisePlan, Result]], source: Path, target: Path, picture: Picture, *, through: str = ""
) -> dict[str, Any]:
    """A report as JSON can hold it; `through` names the axes whose slices were treated one by one."""
    report = about(source, target, picture)
    if through:
        report |= {"each": through, "slices": [_run(plan, result) for plan, result in runs]}
    else:
        report |= _run(*runs[0])
    report |= {
        "backend": runs[0][1].backend,
        "seconds": round(sum(result.seconds for _, result in runs), 4),
        "version": __version__,
    }
    return report


def axes_line(report: dict[str, Any]) -> str:
    """That axes were taken on trust, and what says otherwise."""
    series = report["axes"].replace("Z", "T")
    return f"axes     {report['axes']}: a volume, since the file names no axis; --axes {series} makes it a series"


def left_out(nans: int, outside: int) -> str:
    """How many pixels took no part."""
    counts = ((nans, "NaN"), (outside, "outside the mask"))
    return "left out " + ", ".join(f"{count} pixel(s) {why}" for count, why in counts if count)


def quality_line(psnr: Mapping[str, float | str], ssim: Mapping[str, float | str]) -> str:
    """PSNR and SSIM of input and output."""
    before, after = (float(psnr[which]) for which in ("input", "output"))
    line = f"quality  PSNR {before:.2f} -> {after:.2f} dB"
    before, after = (float(ssim[which]) for which in ("input", "output"))
    # a picture with fewer than three pixels along an axis has no SSIM
    return line if math.isnan(after) else f"{line}, SSIM {before:.3f} -> {after:.3f}"


def done_line(report: dict[str, Any]) -> str:
    """How long it took and where, the picture's size, and the file."""
    if "axes" in report:
        letters = zip(report["axes"], report["shape"], strict=True)
        size = " x ".join(f"{length} {letter}" for letter, length in letters if letter != "C")
    else:
        size = f"{report['width']} x {report['height']}"
    size += f", {report['channels']} channel(s){', alpha' if report['alpha'] else ''}"
    return f"done     {report['seconds']:.2f} s on {report['backend']}; {size} -> {report['output']}"


def as_lines(report: dict[str, Any]) -> str:
    """A report for a reader: noise, filter, done, and what else there is to say."""
    runs = report.get("slices", [report])
    white = _WHITE.get(report["dtype"], "")
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
