"""The report on a simplified picture, for JSON and as text: :class:`SimplifyReport`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .._version import __version__
from ..model.result import Result
from ..regions.regions import Regions
from ..regions.simplify import ENOUGH
from .report import axes_line, done_line, left_out, note_lines, number
from .simplify_settings import Simplification

_SOURCES = {"extrema": "regional extrema of the intensity", "gradient": "regional minima of the gradient"}
_MODELS = {"mean": "the regions' means", "median": "the regions' medians", "source": "the sources' values"}
# The settings that a report always has, and those that it has if they are given.
_ALWAYS = ("sources", "model", "metric", "compactness", "p", "lam", "norm", "rings", "by_size", "weights")
_IF_GIVEN = ("h", "sigma_space", "sigma_value", "merge_tol")


@dataclass(frozen=True)
class Errors:
    """Sums of the squared differences from the picture over the pixels that count, and the range of its values.

    Attributes
    ----------
    fine, output : float
        Sums for the regions before regularization, and for the output.
    count : int
        Number of values in the sums.
    low, high : float
        Range of the picture's values.
    """

    fine: float = 0.0
    output: float = 0.0
    count: int = 0
    low: float = math.inf
    high: float = -math.inf

    def and_those_of(
        self,
        part: npt.NDArray[Any],
        fine: npt.NDArray[Any],
        value: npt.NDArray[Any],
        inside: npt.NDArray[np.bool_] | None,
    ) -> Errors:
        """Add the errors of a slice (h, ...); `inside` is its mask."""
        of_fine, of_output, count, low, high = self.fine, self.output, self.count, self.low, self.high
        # row by row: the differences of a large picture in float64 would need several times its memory
        for i, row in enumerate(part):
            valid = slice(None) if inside is None else inside[i]
            values = row[valid].astype(np.float64)
            if values.size:
                count += values.size
                low, high = min(low, float(values.min())), max(high, float(values.max()))
                of_fine += float(((fine[i][valid] - values) ** 2).sum())
                of_output += float(((value[i][valid] - values) ** 2).sum())
        return Errors(of_fine, of_output, count, low, high)

    def psnr(self, dtype: npt.DTypeLike) -> dict[str, float]:
        """Compute the PSNR in dB; the peak is the range of an integer type, otherwise that of the values."""
        kind = np.dtype(dtype)
        peak = float(np.iinfo(kind).max) if kind.kind == "u" else self.high - self.low
        return {
            name: 10 * math.log10(peak**2 * self.count / squares) if squares else math.inf
            for name, squares in (("fine", self.fine), ("output", self.output))
        }


@dataclass(frozen=True)
class RegionRun:
    """The result for one picture or slice.

    Attributes
    ----------
    regions : int
    percent : float
        Regions in percent of the pixels.
    smooth : float
        Standard deviation, in pixels, of the Gaussian that smoothed the picture for the partition.
    merged : int or None
        Number of regions after merging, None without merging.
    result : Result
        The result of the regularization, without its value.
    stages : mapping of str to float
        Seconds by stage.
    """

    regions: int
    percent: float
    smooth: float
    merged: int | None
    result: Result
    stages: Mapping[str, float]

    @classmethod
    def of(cls, regions: Regions, found: Regions) -> RegionRun:
        """Make the report of a run with these regions; `found` are the regions after merging, if any."""
        assert found.result is not None
        return cls(
            regions.n_regions,
            regions.percent,
            regions.smooth,
            None if found is regions else found.n_regions,
            replace(found.result, value=np.empty(0)),
            {stage: round(seconds, 4) for stage, seconds in found.seconds.items()},
        )

    def as_json(self) -> dict[str, Any]:
        """Return the run as a dictionary for JSON."""
        result = self.result
        return (
            {"regions": self.regions, "percent": self.percent, "smooth": self.smooth}
            | ({} if self.merged is None else {"merged": self.merged})
            | {"iterations": result.iterations, "stop": result.stop.name.lower(), "eps": result.eps}
            | {"energy": [number(energy) for energy in result.energy.tolist()]}
            | ({} if result.gap is None else {"gap": number(result.gap)})
            | {"stages": dict(self.stages), "backend": result.backend}
        )


@dataclass(frozen=True)
class SimplifyReport:
    """The report on a simplified picture, volume or series.

    Attributes
    ----------
    files : mapping
        What :func:`gpureg.jobs.report.about` returns for the files and the picture.
    asked : Simplification
    runs : tuple of RegionRun
        One for each simplified slice.
    errors : Errors
    through : str, default ""
        Letters of the axes whose slices were processed one by one.
    spacing : mapping of str to float, optional
        Size of a pixel along each axis, by its letter.
    outside_mask, nan, nodata : int, default 0
        Numbers of pixels that the mask excludes, that are NaN, and that have the value for no data.
    outputs : mapping of str to Path
        The files other than OUT, by the name of their option.
    """

    files: Mapping[str, Any]
    asked: Simplification
    runs: tuple[RegionRun, ...]
    errors: Errors
    through: str
    spacing: Mapping[str, float] | None
    outside_mask: int
    nan: int
    nodata: int
    outputs: Mapping[str, Path]

    @property
    def pixels(self) -> int:
        """Number of pixels that were not left out."""
        return int(self.errors.count // self.files["channels"])

    @property
    def regions(self) -> int:
        """Number of regions of all slices."""
        return sum(run.regions for run in self.runs)

    @property
    def merged(self) -> int | None:
        """Number of regions of all slices after merging, None without merging."""
        counts = [run.merged for run in self.runs if run.merged is not None]
        return sum(counts) if counts else None

    @property
    def stages(self) -> dict[str, float]:
        """Seconds by stage, for all slices."""
        return {stage: round(sum(run.stages[stage] for run in self.runs), 4) for stage in self.runs[0].stages}

    def percent(self, regions: int) -> float:
        """Return a number of regions in percent of the pixels."""
        return 100 * regions / self.pixels

    def as_json(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON."""
        asked = self.asked
        report = {**self.files, **{name: getattr(asked, name) for name in _ALWAYS}}
        report["smooth_given"] = asked.smooth is not None
        if asked.markers is not None:
            report["sources"] = str(asked.markers)
        report |= {name: getattr(asked, name) for name in _IF_GIVEN if getattr(asked, name) is not None}
        runs = [run.as_json() for run in self.runs]
        report |= {"each": self.through, "slices": runs} if self.through else runs[0]
        report |= {"regions": self.regions, "percent": self.percent(self.regions)}
        if self.merged is not None:
            report |= {"merged": self.merged, "merged_percent": self.percent(self.merged)}
        psnr = self.errors.psnr(self.files["dtype"])
        report |= {
            "pixels": self.pixels,
            "psnr": {name: number(value) for name, value in psnr.items()},
            "stages": self.stages,
            "seconds": round(sum(self.stages.values()), 4),
            "backend": self.runs[0].result.backend,
            "version": __version__,
        }
        if self.spacing is not None:
            report["spacing"] = dict(self.spacing)
        if asked.mask is not None:
            report |= {"mask": str(asked.mask), "outside_mask": self.outside_mask}
        if self.nan:
            report["nan"] = self.nan
        if self.nodata:
            report["nodata"] = self.nodata
        return report | {name: str(path) for name, path in self.outputs.items()}

    def lines(self) -> list[str]:
        """Return the report as lines of text."""
        report, (first, *_) = self.as_json(), self.runs
        lines = [] if self.files.get("axes_named", True) else [axes_line(report)]
        lines.append(f"sources  {self._sources()}{self._smoothing()}")
        each = f" in {len(self.runs)} slices along {self.through}" if self.through else ""
        lines.append(f"regions  {self.regions}, {self.percent(self.regions):.3g} % of {self.pixels} pixels{each}")
        if self.nan or self.outside_mask or self.nodata:
            lines.append(left_out(self.nan, self.outside_mask, self.nodata))
        lines.append(f"filter   {self._filter()}")
        if self.merged is not None:
            lines.append(f"merged   {self.merged} regions, {self.percent(self.merged):.3g} % of the pixels")
        psnr = self.errors.psnr(self.files["dtype"])
        lines.append(
            f"quality  PSNR {psnr['fine']:.2f} dB of {_MODELS[self.asked.model]}, {psnr['output']:.2f} dB of OUT"
        )
        result = first.result
        if result.gap is not None and not self.through:
            lines.append(f"minimum  the energy, {result.energy[-1]:.6g}, is at most {result.gap:.2g} above it")
        lines.append("seconds  " + ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in self.stages.items()))
        also = [f"{name.replace('_', ' ')} {path}" for name, path in self.outputs.items()]
        if also:
            lines.append(f"also     {', '.join(also)}")
        lines += note_lines(self.files)
        lines.append(done_line(report))
        return lines

    def _sources(self) -> str:
        sources = self.asked.sources
        if self.asked.markers is not None:
            return f"the markers {self.asked.markers}"
        return f"seeds {sources} pixels apart" if isinstance(sources, int) else _SOURCES[sources]

    def _smoothing(self) -> str:
        found = sorted({run.smooth for run in self.runs})
        if found == [0]:
            return ""
        reach = f"{found[0]:g}" + (f" to {found[-1]:g}" if len(found) > 1 else "")
        few = all(run.percent <= 100 * ENOUGH for run in self.runs)
        chosen = f"the least that leaves one to {1 / ENOUGH:g} pixels" if few else "the largest that is tried"
        why = chosen if self.asked.smooth is None else "as given"
        return f", seen through a Gaussian of {reach} pixels, {why}"

    def _filter(self) -> str:
        asked = self.asked
        values = {name: getattr(asked, name) for name in ("h", "sigma_space", "sigma_value")}
        given = "".join(f", {name} = {value:g}" for name, value in values.items() if value is not None)
        counts = sorted({run.result.iterations for run in self.runs})
        iterations = f"{counts[0]}" + (f" to {counts[-1]}" if len(counts) > 1 else "")
        more = "".join(
            (
                "; edge norm" if asked.norm == "edge" else "",
                f"; {asked.rings} rings" if asked.rings > 1 else "",
                "; lam by size" if asked.by_size else "",
            )
        )
        return (
            f"{asked.weights} weights{given}{more}; p = {asked.p:g}, lam = {asked.lam:g}, "
            f"{iterations} iteration{'' if counts == [1] else 's'}"
        )
