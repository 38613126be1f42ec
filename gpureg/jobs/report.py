"""Lines that several reports have in common."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..files.pictures import Picture
from ..images.plan import DenoisePlan
from ..model.result import Result

WHITE = {"uint8": " of 255", "uint16": " of 65535"}


def number(value: float) -> float | str:
    """A number as JSON can hold it."""
    return value if math.isfinite(value) else str(value)


def run_of(plan: DenoisePlan, result: Result) -> dict[str, Any]:
    """What a report says of one run of the model."""
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
