"""What was done with a picture that was simplified: as JSON can hold it, and in a few lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .._version import __version__
from ..files.pictures import Picture
from ..regions.regions import Regions
from ..regions.simplify import ENOUGH
from .report import about, axes_line, done_line, left_out, number

_SOURCES = {"extrema": "regional extrema of the intensity", "gradient": "regional minima of the gradient"}
_MODELS = {"mean": "the regions' means", "median": "the regions' medians", "source": "the sources' values"}


@dataclass
class Errors:
    """Squared differences from the picture, added up over its pixels that take part, and the range of its values."""

    fine: float = 0.0
    output: float = 0.0
    count: int = 0
    low: float = math.inf
    high: float = -math.inf

    def add(
        self,
        part: npt.NDArray[Any],
        fine: npt.NDArray[Any],
        value: npt.NDArray[Any],
        inside: npt.NDArray[np.bool_] | None,
    ) -> None:
        """Add those of a slice."""
        # row by row: as float64 the differences of a large picture would take several times its memory
        for i, row in enumerate(part):
            kept = slice(None) if inside is None else inside[i]
            values = row[kept].astype(np.float64)
            if values.size:
                self.count += values.size
                self.low, self.high = min(self.low, float(values.min())), max(self.high, float(values.max()))
                self.fine += float(((fine[i][kept] - values) ** 2).sum())
                self.output += float(((value[i][kept] - values) ** 2).sum())

    def psnr(self, dtype: npt.DTypeLike) -> dict[str, float | str]:
        """Peak signal-to-noise ratios in dB; the peak is the range of an integer type, or that of the values."""
        kind = np.dtype(dtype)
        peak = float(np.iinfo(kind).max) if kind.kind == "u" else self.high - self.low
        return {
            name: number(10 * math.log10(peak**2 * self.count / squares) if squares else math.inf)
            for name, squares in (("fine", self.fine), ("output", self.output))
        }


def run_of(regions: Regions, found: Regions) -> dict[str, Any]:
    """What became of one picture or slice: its regions, and `found`, the same or what they were joined to."""
    result = found.result
    assert result is not None
    return (
        {"regions": regions.n_regions, "percent": regions.percent, "smooth": regions.smooth}
        | ({} if found is regions else {"merged": found.n_regions})
        | {"iterations": result.iterations, "stop": result.stop.name.lower(), "eps": result.eps}
        | {"energy": [number(energy) for energy in result.energy.tolist()]}
        | ({} if result.gap is None else {"gap": number(result.gap)})
        | {"stages": {stage: round(seconds, 4) for stage, seconds in found.seconds.items()}, "backend": result.backend}
    )


def report_of(
    runs: Sequence[dict[str, Any]],
    errors: Errors,
    source: Path,
    target: Path,
    picture: Picture,
    asked: dict[str, Any],
    *,
    through: str = "",
) -> dict[str, Any]:
    """A report as JSON can hold it; `through` names the axes whose slices were treated one by one."""
    report = about(source, target, picture) | asked
    report |= {"each": through, "slices": list(runs)} if through else runs[0]
    pixels = errors.count // picture.channels
    report["regions"] = sum(run["regions"] for run in runs)
    report["percent"] = 100 * report["regions"] / pixels
    if "merged" in runs[0]:
        report["merged"] = sum(run["merged"] for run in runs)
        report["merged_percent"] = 100 * report["merged"] / pixels
    stages = {stage: round(sum(run["stages"][stage] for run in runs), 4) for stage in runs[0]["stages"]}
    return report | {
        "pixels": pixels,
        "psnr": errors.psnr(picture.pixels.dtype),
        "stages": stages,
        "seconds": round(sum(stages.values()), 4),
        "backend": runs[0]["backend"],
        "version": __version__,
    }


def as_lines(report: dict[str, Any]) -> str:
    """A report for a reader."""
    runs = report.get("slices", [report])
    lines = [] if report.get("axes_named", True) else [axes_line(report)]
    lines.append(f"sources  {_sources(report['sources'])}{_smoothing(report, runs)}")
    each = f" in {len(runs)} slices along {report['each']}" if "each" in report else ""
    lines.append(f"regions  {report['regions']}, {report['percent']:.3g} % of {report['pixels']} pixels{each}")
    if report.get("nan") or report.get("outside_mask"):
        lines.append(left_out(report.get("nan", 0), report.get("outside_mask", 0)))
    lines.append(f"filter   {_filter(report, runs)}")
    if "merged" in report:
        lines.append(f"merged   {report['merged']} regions, {report['merged_percent']:.3g} % of the pixels")
    fine, output = (float(report["psnr"][which]) for which in ("fine", "output"))
    lines.append(f"quality  PSNR {fine:.2f} dB of {_MODELS[report['model']]}, {output:.2f} dB of OUT")
    if "gap" in report:
        lines.append(f"minimum  the energy, {report['energy'][-1]:.6g}, is at most {report['gap']:.2g} above it")
    lines.append("seconds  " + ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in report["stages"].items()))
    also = [
        f"{name.replace('_', ' ')} {report[name]}" for name in ("labels", "random_colours", "fine") if name in report
    ]
    if also:
        lines.append(f"also     {', '.join(also)}")
    lines.append(done_line(report))
    return "\n".join(lines)


def _sources(sources: str | int) -> str:
    if isinstance(sources, int):
        return f"seeds {sources} pixels apart"
    return _SOURCES.get(sources, f"the markers {sources}")


def _smoothing(report: dict[str, Any], runs: Sequence[dict[str, Any]]) -> str:
    found = sorted({run["smooth"] for run in runs})
    if found == [0]:
        return ""
    reach = f"{found[0]:g}" + (f" to {found[-1]:g}" if len(found) > 1 else "")
    few = all(run["percent"] <= 100 * ENOUGH for run in runs)
    chosen = f"the least that leaves one to {1 / ENOUGH:g} pixels" if few else "the largest that is tried"
    return f", seen through a Gaussian of {reach} pixels, {'as given' if report['smooth_given'] else chosen}"


def _filter(report: dict[str, Any], runs: Sequence[dict[str, Any]]) -> str:
    given = "".join(f", {name} = {report[name]:g}" for name in ("h", "sigma_space", "sigma_value") if name in report)
    counts = sorted({run["iterations"] for run in runs})
    iterations = f"{counts[0]}" + (f" to {counts[-1]}" if len(counts) > 1 else "")
    more = "".join(
        (
            "; edge norm" if report["norm"] == "edge" else "",
            f"; {report['rings']} rings" if report["rings"] > 1 else "",
            "; lam by size" if report["by_size"] else "",
        )
    )
    weights = f"{report['weights']} weights{given}{more}"
    return (
        f"{weights}; p = {report['p']:g}, lam = {report['lam']:g}, {iterations} iteration{'' if counts == [1] else 's'}"
    )
