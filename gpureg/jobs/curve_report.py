"""The report on curves, for JSON and as text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import metrics
from .._version import __version__
from ..arrays import FloatArray, IntArray
from ..curves.cleaning import Found
from ..curves.crossings import Crossings
from ..curves.files import left_words
from ..curves.skeletons import Skeleton
from ..model.result import Result
from ..shapes.ends import Ends
from .report import Change, Displacement, ShapeReport, noise_line, number

_WHY = {
    "given": "as given",
    "source": "as the file says",
    "repeated": "first vertex repeated",
    "near": "ends near",
    "apart": "ends apart",
    "few": "fewer than three vertices",
}


@dataclass(frozen=True, eq=False)
class Worked:
    """Curves after denoising or simplification, and the parameters.

    Attributes
    ----------
    points : list of (k, 2) float arrays
        The vertices of each curve, after.
    kept : list of (k,) int arrays
        Their indices among the vertices before.
    what : {"directions", "positions", "heights"}
        What was regularized, or that vertices were removed by their heights.
    simplified : bool
        Whether vertices were removed, instead of moved.
    p : float or None
        Degree of regularity; None without a run.
    lam : list of float
        Fidelity of each curve; empty without a run.
    sigma : list of float
        Noise of each curve, if they were denoised.
    estimated : bool
        Whether the noise was estimated.
    results : list of Result
        The runs of the model.
    tolerance : float or None
        The height up to which vertices were removed.
    found : list of Found
        Outliers, gaps and repeated vertices of each curve, if they were denoised.
    crossings : Crossings or None
        Pairs of segments that meet without a common end, before and after.
    refused : int
        Number of vertices that stay, or move less, so that curves do not cross.
    """

    points: list[FloatArray]
    kept: list[IntArray]
    what: str
    simplified: bool
    p: float | None
    lam: list[float]
    sigma: list[float]
    estimated: bool
    results: list[Result]
    tolerance: float | None = None
    found: Sequence[Found] = ()
    crossings: Crossings | None = None
    refused: int = 0

    def describe(self) -> str:
        """Describe the work in one line."""
        if self.what == "heights":
            if self.tolerance is None:
                return "the lowest vertices removed, down to the number of each curve"
            return f"vertices removed up to a height of {self.tolerance:g} of a curve's diagonal"
        verb = f"vertices kept where the {self.what} jump" if self.simplified else f"{self.what} of the vertices"
        if not self.results:
            return f"{verb}: there is no noise to remove"
        many = " in the middle" if len(set(self.lam)) > 1 else ""
        lam = f"{np.median(self.lam):.4g}{many}"
        steps = self.results[0].iterations
        return f"{verb}; p = {self.p:g}, lam = {lam}, {f'{steps} iterations' if steps else 'solved directly'}"


@dataclass(frozen=True)
class Measures:
    """Lengths, areas and distances of curves before and after.

    Attributes
    ----------
    length : Change
        The length of all curves together.
    area : Change or None
        The area inside all closed curves.
    hausdorff : float
        The largest distance of a curve from the curve before.
    reference : Change or None
        The largest distance from the curve with the same number in the reference.
    """

    length: Change
    area: Change | None
    hausdorff: float
    reference: Change | None

    @classmethod
    def of(
        cls, before: list[FloatArray], after: list[FloatArray], closed: list[bool], truth: list[FloatArray] | None
    ) -> Measures:
        """Measure curves, lists of (n, 2) arrays, before and after.

        Raises
        ------
        ValueError
            The reference has another number of curves.
        """
        if truth is not None and len(truth) != len(before):
            raise ValueError(f"--reference has {len(truth)} curves, IN has {len(before)}")
        shut = [k for k, is_closed in enumerate(closed) if is_closed]
        area = None
        if shut:
            area = Change.of(lambda x: float(sum(abs(metrics.curve_area(x[k])) for k in shut)), before, after)
        return cls(
            Change.of(lambda x: float(sum(_each(metrics.curve_length, closed, x))), before, after),
            area,
            max(_each(metrics.curve_hausdorff, closed, before, after)),
            None
            if truth is None
            else Change.of(lambda x: max(_each(metrics.curve_hausdorff, closed, x, truth)), before, after),
        )

    def as_json(self) -> dict[str, Any]:
        """Return the measures as a dictionary for JSON."""
        area = {} if self.area is None else {"area": self.area.as_json()}
        reference = {} if self.reference is None else {"reference": self.reference.as_json()}
        return {"length": self.length.as_json()} | area | {"hausdorff": self.hausdorff} | reference


def _each(measure: Callable[..., float], closed: list[bool], *curves: list[FloatArray]) -> list[float]:
    """Measure each curve, or each pair of curves."""
    return [measure(*xs, closed=shut) for *xs, shut in zip(*curves, closed, strict=True)]


@dataclass(frozen=True, eq=False, kw_only=True)
class CurveReport(ShapeReport):
    """The report on curves.

    Attributes
    ----------
    before : list of (n, 2) float arrays
        The curves before.
    worked : Worked
        The curves after.
    ends : list of Ends
        Which are closed, and how that is known.
    measures : Measures
    unit : str or None
        Unit of lengths, if it is not the unit of the file.
    skeleton : Path or None
        File with the skeletons.
    bones : list of Skeleton
        The skeletons.
    left : tuple of str
        The curves of the input that could not be treated, each with the reason.
    left_out : bool
        Whether they are missing in the output, because it has another format; otherwise they are as they were.
    """

    before: list[FloatArray]
    worked: Worked
    ends: list[Ends]
    measures: Measures
    unit: str | None = None
    skeleton: Path | None = None
    bones: Sequence[Skeleton] = ()
    left: tuple[str, ...] = ()
    left_out: bool = False

    @property
    def branches(self) -> int:
        """Number of branches of the skeletons."""
        return sum(bone.n_branches for bone in self.bones)

    @property
    def _tips(self) -> int:
        return sum(bone.n_ends for bone in self.bones)

    @property
    def _vertices(self) -> Change:
        return Change.of(lambda points: sum(map(len, points)), self.before, self.worked.points)

    def as_json(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON."""
        return super().as_json() | {"seconds": round(self.seconds, 4)}

    def _told(self) -> dict[str, Any]:
        worked = self.worked
        report: dict[str, Any] = {
            "curves": len(self.before),
            "closed": sum(ends.closed for ends in self.ends),
            "ends": [{"closed": ends.closed, "why": ends.why, "gap": ends.gap} for ends in self.ends],
            "vertices": self._vertices.as_json(),
            "method": "simplify" if worked.simplified else "denoise",
            "filter": self.filter,
        }
        if worked.p is not None:
            report |= {"p": worked.p, "lam": [number(lam) for lam in worked.lam]}
        if worked.tolerance is not None:
            report["tolerance"] = worked.tolerance
        if worked.crossings is not None:
            report["crossings"] = worked.crossings._asdict()
        if worked.refused:
            report["refused"] = worked.refused
        if self.left:
            report["untreated"] = list(self.left)
        if not worked.simplified:
            moved = [np.linalg.norm(a - b, axis=1) for a, b in zip(self.before, worked.points, strict=True)]
            report |= {"sigma": worked.sigma, "sigma_estimated": worked.estimated}
            report["displacement"] = Displacement.of(np.concatenate(moved)).as_json()
            report["found"] = [
                {
                    "outliers": one.outliers.tolist(),
                    "gaps": one.gaps.tolist(),
                    "repeats": one.repeats,
                    "opened": one.opened,
                }
                for one in worked.found
            ]
        report |= self.measures.as_json() | {"backend": self.backend, "version": __version__}
        if self.unit is not None:
            report["unit"] = self.unit
        if self.skeleton is not None:
            report["skeleton"] = {"file": str(self.skeleton), "branches": self.branches, "ends": self._tips}
        return report

    def _noise(self) -> list[str]:
        if self.worked.simplified:
            return []
        middle = " in the middle" if len(self.before) > 1 else ""
        return [noise_line(float(np.median(self.worked.sigma)), middle, self.worked.estimated)]

    def _found(self) -> list[str]:
        lines = [ends_line(self.ends)]
        counts, measures = self._vertices, self.measures
        if self.worked.simplified:
            lines.append(f"left     {counts.after} of {counts.before} vertices, {counts.percent:.3g} %")
        told = {"area": measures.area, "length": measures.length}
        words = [f"{name} {x.percent:.5g} %" for name, x in told.items() if x is not None and x.before]
        unit = f" {self.unit}" if self.unit is not None else ""
        lines.append(f"quality  {', '.join([*words, f'Hausdorff distance {measures.hausdorff:.3g}{unit}'])}")
        if (error := measures.reference) is not None:
            lines.append(f"errors   Hausdorff distance {error.before:.3g} -> {error.after:.3g}")
        if self.skeleton is not None:
            lines.append(f"skeleton {self.branches} branches, {self._tips} ends -> {self.skeleton}")
        return lines

    def cautions(self) -> list[str]:
        """Return the lines on outliers, gaps, repeated vertices, crossings, and curves that were not treated."""
        lines = [found_line(self.worked.found)] if any(map(_anything, self.worked.found)) else []
        if (counts := self.worked.crossings) is not None and max(counts.before, counts.after):
            option = f", {counts.new} new: --valid prevents them" if counts.new else ""
            what = "curves cross" if counts.between else "a curve crosses itself (others were not counted)"
            lines.append(f"crossing {counts.before} -> {counts.after} places where {what}{option}")
        if self.worked.refused:
            verb = "stay" if self.worked.simplified else "move less"
            lines.append(f"valid    {self.worked.refused} vertices {verb}, so that curves do not cross")
        if self.left:
            how = "left out, since OUT has another format" if self.left_out else "as they were"
            lines.append(f"left     {left_words(self.left)}: {how}")
        return lines

    def _size(self) -> str:
        count = len(self.before)
        return f"{count} curve{'s' if count > 1 else ''}, {self._vertices.before} vertices"


def _anything(found: Found) -> bool:
    return bool(len(found.outliers) or len(found.gaps) or found.repeats or found.opened or found.few)


def found_line(found: Sequence[Found]) -> str:
    """Say what was kept from deciding for the rest of the curves."""
    counts = {
        "outlier(s), put between their neighbours": sum(len(one.outliers) for one in found),
        "gap(s), not smoothed across": sum(len(one.gaps) for one in found),
        "repeat(s), counted once": sum(one.repeats for one in found),
        "closed curve(s) with ends far apart, treated as open": sum(one.opened for one in found),
        "curve(s) too short to tell their noise, left as they are": sum(one.few for one in found),
    }
    return f"found    {'; '.join(f'{count} {what}' for what, count in counts.items() if count)}"


def ends_line(ends: Sequence[Ends]) -> str:
    """Describe which curves are closed, why, and the distance of their ends."""
    if len(ends) == 1:
        return f"ends     {ends[0].describe()}"
    gaps: dict[tuple[bool, str], list[float]] = {}
    for one in ends:
        gaps.setdefault((one.closed, one.why), []).append(one.gap)
    words = []
    for (closed, why), apart in gaps.items():
        to = f" to {max(apart):.3g}" if len(apart) > 1 else ""
        far = "" if why == "repeated" else f", {min(apart):.3g}{to} apart"
        words.append(f"{len(apart)} {'closed' if closed else 'open'} ({_WHY[why]}{far})")
    return f"ends     {', '.join(words)}"
