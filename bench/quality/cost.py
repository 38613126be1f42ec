"""What each second costs: PSNR against seconds for all methods, as a table and drawn."""

from __future__ import annotations

from collections.abc import Sequence
from math import log10
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .measure import reached, taken
from .methods import DEFAULT, OURS, PEERS, REFERENCES
from .report import NAMES, Row, head, line, number

# The rest of scikit-image's filters are lighter; BM3D and BM4D are what is compared with.
COLOURS = {"ours": "#0072b2", "reference": "#d55e00", "filter": "#777777"}


class Point(NamedTuple):
    """A method's mean over the rows of a group."""

    who: str
    seconds: float
    psnr: float
    earlier: bool


class Panel(NamedTuple):
    """A group at one sigma: its scenes, and the methods that took part in all of them, the fastest first."""

    group: str
    sigma: float
    scenes: list[str]
    points: list[Point]


def panels(rows: Sequence[Row], run: str) -> list[Panel]:
    """The means of each group, at the middle one of its sigmas."""
    found = []
    for group in dict.fromkeys(row["group"] for row in rows):
        sigmas = sorted({row["sigma"] for row in rows if row["group"] == group})
        sigma = sigmas[(len(sigmas) - 1) // 2]
        chosen = [row for row in rows if row["group"] == group and row["sigma"] == sigma]
        points = []
        for who in (*OURS, *PEERS):
            values, times = [reached(row, who) for row in chosen], [taken(row, who) for row in chosen]
            known = [time for time in times if time is not None]
            if None not in values and len(known) == len(chosen):
                seconds = float(np.mean([time for time, _ in known]))
                points.append(Point(who, seconds, float(np.mean(values)), any(when != run for _, when in known)))
        points.sort(key=lambda point: point.seconds)
        found.append(Panel(NAMES.get(group, group), sigma, [row["scene"] for row in chosen], points))
    return found


def table(rows: Sequence[Row], run: str) -> str:
    """The methods by their seconds; bold where no faster one reaches as much."""
    parts = []
    for panel in panels(rows, run):
        lines = [f"### Cost: {panel.group}, sigma {panel.sigma:g}, mean of {', '.join(panel.scenes)}", ""]
        reference = next((point for point in panel.points if point.who in REFERENCES), None)
        name = reference.who if reference else "BM3D"
        lines += head(["method"], ["seconds", "PSNR, dB", f"- {name}, dB", f"times as fast as {name}"])
        best = -np.inf
        for point in panel.points:
            mark, best = ("**" if point.psnr > best else ""), max(best, point.psnr)
            apart = point.psnr - reference.psnr if reference else None
            faster = reference.seconds / point.seconds if reference else None
            seconds = f"{point.seconds:.3g}{'*' if point.earlier else ''}"
            who = f"{mark}{point.who}{mark}"
            lines.append(line(who, seconds, f"{point.psnr:.2f}", number(apart, "+.2f"), number(faster, ".3g")))
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def _drawn(points: Sequence[Point]) -> list[Point]:
    """What the figure shows: ways to call ours with equal results are one mark, and nobody chooses the true sigma."""
    found: list[Point] = []
    for point in points:
        twin = next(
            (k for k, p in enumerate(found) if _kind(p.who) == "ours" and abs(p.psnr - point.psnr) < 1e-6), None
        )
        if point.who == "sigma given":
            continue
        if twin is None or point.who not in OURS:
            found.append(point)
        else:
            names = sorted([*found[twin].who.split(" = "), point.who], key=lambda who: who != DEFAULT)
            found[twin] = found[twin]._replace(who=" = ".join(names))
    return found


def _kind(who: str) -> str:
    return "ours" if who.split(" = ")[0] in OURS else "reference" if who in REFERENCES else "filter"


# Where a name may stand: steps to the right of its mark and up from it, the best first.
_PLACES = [(1, 0), (-1, 0), (0, 1), (0, -1), *((side, up) for up in (1, -1, 2, -2, 3, -3) for side in (1, -1))]
Box = tuple[float, float, float, float]


def _meet(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _label(axes: Any, points: Sequence[Point]) -> None:
    """Each name beside its mark, where it covers no mark and no other name; ours choose first.

    In units of the panel's width and height, with sizes of letters that are about right.
    """
    (left, right), (low, high) = [log10(x) for x in axes.get_xlim()], axes.get_ylim()
    marks = {p.who: ((log10(p.seconds) - left) / (right - left), (p.psnr - low) / (high - low)) for p in points}
    boxes: list[Box] = [(x - 0.012, y - 0.016, x + 0.012, y + 0.016) for x, y in marks.values()]
    for point in sorted(points, key=lambda p: (not p.who.startswith(DEFAULT), _kind(p.who) == "filter")):
        who, bold = point.who, point.who.startswith(DEFAULT)
        (x, y), wide = marks[who], (0.0125 if bold else 0.0115) * len(who)
        own = (x - 0.012, y - 0.016, x + 0.012, y + 0.016)
        tries = []
        for rank, (side, up) in enumerate(_PLACES):
            start = x + 0.02 if side > 0 else x - 0.02 - wide if side < 0 else x - wide / 2
            middle = y + 0.038 * up
            box = (start, middle - 0.02, start + wide, middle + 0.02)
            hits = sum(_meet(box, other) for other in boxes if other != own)
            outside = min(box[:2]) < 0 or max(box[2:]) > 1
            tries.append((hits + 5 * outside, rank, box))
        _, rank, box = min(tries)
        boxes.append(box)
        side, up = _PLACES[rank]
        axes.annotate(
            who, (x + 0.02 * side, y + 0.038 * up), xycoords="axes fraction", va="center", fontsize=9,
            ha="left" if side > 0 else "right" if side < 0 else "center",
            color=COLOURS[_kind(who)], fontweight="bold" if bold else "normal",
        )  # fmt: skip


def draw(rows: Sequence[Row], run: str, about: dict[str, Any], path: Path) -> None:
    """Write the figure, a panel for each group; the extension of the path tells the format."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    found = [panel._replace(points=_drawn(panel.points)) for panel in panels(rows, run) if panel.points]
    across = min(2, len(found))
    down = -(-len(found) // across)
    figure, grid = plt.subplots(down, across, figsize=(7.2 * across, 5.4 * down), layout="constrained", squeeze=False)
    for axes in grid.flat[len(found) :]:
        axes.set_axis_off()
    for axes, panel in zip(grid.flat, found, strict=False):
        ours = [point for point in panel.points if _kind(point.who) == "ours"]
        axes.plot([p.seconds for p in ours], [p.psnr for p in ours], color=COLOURS["ours"], linewidth=1, alpha=0.5)
        for point in panel.points:
            kind = _kind(point.who)
            axes.plot(
                point.seconds, point.psnr, marker="o" if kind == "ours" else "s", color=COLOURS[kind], linestyle="",
                markersize=9 if point.who.startswith(DEFAULT) else 7,
                markerfacecolor=COLOURS[kind] if kind != "filter" else "white", zorder=3,
            )  # fmt: skip
        axes.set_xscale("log")
        axes.margins(x=0.22, y=0.12)
        axes.grid(True, which="major", color="#dddddd", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set_xlabel("seconds for an image, mean (logarithmic; to the left is better)")
        axes.set_ylabel("PSNR in dB, mean (up is better)")
        scenes = panel.scenes[0] if len(panel.scenes) == 1 else f"{len(panel.scenes)} images"
        axes.set_title(f"{panel.group}: {scenes}, sigma {panel.sigma:g} of 255", fontsize=11, loc="left")
        axes.autoscale_view()
        _label(axes, panel.points)
    told = "gpureg without parameters; BM3D, BM4D with the true sigma; scikit-image with it, tuned by the true PSNR"
    figure.suptitle(f"{told}\n{about['cpu']}, {about['cores']} cores, {about['date'][:10]}", fontsize=9)
    figure.savefig(path, dpi=130)
    plt.close(figure)
