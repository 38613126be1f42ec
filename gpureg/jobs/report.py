"""The common parts of reports: lines of text, and the report on a mesh, points or curves."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from .._version import __version__
from ..arrays import FloatArray
from ..files.formats import written_otherwise
from ..files.pictures import Picture
from ..images.plan import DenoisePlan
from ..model.result import Result

T = TypeVar("T")

WHITE = {"uint8": " of 255", "uint16": " of 65535"}


def number(value: float) -> float | str:
    """Convert NaN and infinity to text for JSON."""
    return value if math.isfinite(value) else str(value)


def run_of(plan: DenoisePlan, result: Result) -> dict[str, Any]:
    """Return the report on one run of the model, for JSON."""
    return {
        "sigma": None if plan.sigma is None else number(plan.sigma),
        "sigma_estimated": plan.estimated,
        "noise": None if plan.report is None else plan.report.as_json(),
        "filter": plan.describe(),
        "p": plan.p,
        "lam": number(float(np.asarray(plan.lam))),
        "lam_reason": plan.reasons.get("lam", "given"),
        "radius": plan.radius,
        "metric": plan.metric,
        "passes": 1 + len(plan.passes),
        "iterations": result.iterations,
        "stop": result.stop.name.lower(),
        "energy": [number(energy) for energy in result.energy.tolist()],
        "eps": result.eps,
    } | ({} if result.gap is None else {"gap": number(result.gap)})


def about(source: Path, target: Path, picture: Picture) -> dict[str, Any]:
    """Return the report on the files and the picture, for JSON."""
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
    notes = [*picture.notes, *written_otherwise(target, picture)]
    return files | ({"notes": notes} if notes else {})


def note_lines(report: Mapping[str, Any]) -> list[str]:
    """Return the lines on what was converted or left out between the files."""
    return [f"note     {note}" for note in report.get("notes", ())]


def axes_line(report: dict[str, Any]) -> str:
    """Say that axes were guessed, and which option changes them."""
    series = report["axes"].replace("Z", "T")
    return f"axes     {report['axes']}: a volume, since the file names no axis; --axes {series} makes it a series"


def left_out(nans: int, outside: int, nodata: int = 0) -> str:
    """Say how many pixels were left out."""
    counts = ((nans, "NaN"), (nodata, "without data"), (outside, "outside the mask"))
    return "left out " + ", ".join(f"{count} pixel(s) {why}" for count, why in counts if count)


def quality_line(psnr: Mapping[str, float | str], ssim: Mapping[str, float | str]) -> str:
    """Return the line with PSNR and SSIM of input and output."""
    before, after = (float(psnr[which]) for which in ("input", "output"))
    line = f"quality  PSNR {before:.2f} -> {after:.2f} dB"
    before, after = (float(ssim[which]) for which in ("input", "output"))
    # a picture with fewer than three pixels along an axis has no SSIM
    return line if math.isnan(after) else f"{line}, SSIM {before:.3f} -> {after:.3f}"


def done_line(report: dict[str, Any]) -> str:
    """Return the line with the duration, the backend, the size of the picture, and the file."""
    if "axes" in report:
        letters = zip(report["axes"], report["shape"], strict=True)
        size = " x ".join(f"{length} {letter}" for letter, length in letters if letter != "C")
    else:
        size = f"{report['width']} x {report['height']}"
    size += f", {report['channels']} channel(s){', alpha' if report['alpha'] else ''}"
    return f"done     {report['seconds']:.2f} s on {report['backend']}; {size} -> {report['output']}"


@dataclass(frozen=True)
class Change:
    """A number before and after."""

    before: Any
    after: Any

    @classmethod
    def of(cls, measure: Callable[[T], Any], before: T, after: T) -> Change:
        """Measure both."""
        return cls(measure(before), measure(after))

    def as_json(self) -> dict[str, Any]:
        """Return both for JSON."""
        return {"before": self.before, "after": self.after}

    @property
    def percent(self) -> float:
        """After in percent of before."""
        return float(100 * self.after / self.before)


@dataclass(frozen=True)
class Displacement:
    """The largest and the mean displacement of vertices."""

    largest: float
    mean: float

    @classmethod
    def of(cls, distance: FloatArray) -> Displacement:
        """Compute both from the distances (n,)."""
        return cls(float(distance.max()), float(distance.mean()))

    def as_json(self) -> dict[str, Any]:
        """Return both for JSON."""
        return {"largest": self.largest, "mean": self.mean}


@dataclass(frozen=True, eq=False, kw_only=True)
class ShapeReport(ABC):
    """The report on a shape.

    Attributes
    ----------
    input, output : Path
        IN and OUT.
    filter : str
        Description of the work in one line.
    results : sequence of Result
        The runs of the model.
    seconds : float
        Duration of the work.
    picture : Path or None
        File of the picture.
    """

    input: Path
    output: Path
    filter: str
    results: Sequence[Result] = ()
    seconds: float
    picture: Path | None = None

    @property
    def backend(self) -> str | None:
        """Backend of the runs; None without runs."""
        return self.results[0].backend if self.results else None

    def as_json(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON."""
        report = {"input": str(self.input), "output": str(self.output)} | self._told()
        return report if self.picture is None else report | {"picture": str(self.picture)}

    def lines(self) -> list[str]:
        """Return the report as lines of text."""
        on = f" on {self.backend}" if self.backend else ""
        size = self._size()
        return [
            *self._noise(),
            f"filter   {self.filter}",
            *self._found(),
            *self.cautions(),
            *([] if self.picture is None else [f"picture  {self.picture}"]),
            f"done     {self.seconds:.2f} s{on}{f'; {size}' if size else ''} -> {self.output}",
        ]

    def cautions(self) -> list[str]:
        """Return the lines on what could not be treated, or came out otherwise than a user may expect."""
        return []

    @abstractmethod
    def _told(self) -> dict[str, Any]:
        """Return the report for JSON, without the files."""

    def _noise(self) -> list[str]:
        """Return the line on the noise, or no line."""
        return []

    @abstractmethod
    def _found(self) -> list[str]:
        """Return the lines on the result."""

    def _size(self) -> str:
        """Return the size of the shape."""
        return ""

    def _runs(self) -> dict[str, Any]:
        """Return the report on the runs and the version, for JSON."""
        return {
            "iterations": sum(run.iterations for run in self.results),
            "stop": [run.stop.name.lower() for run in self.results],
            "backend": self.backend,
            "seconds": round(self.seconds, 4),
            "version": __version__,
        }


def noise_line(sigma: float, share: str, estimated: bool) -> str:
    """Return the line with the standard deviation of the noise, and its origin."""
    return f"noise    sigma = {sigma:.4g}{share}, {'estimated' if estimated else 'as given'}"
