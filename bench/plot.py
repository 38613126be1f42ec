"""The picture: time against size, ours and the peers', and how near each row comes to its bound."""

from __future__ import annotations

from math import log10
from pathlib import Path
from typing import Any

# One hue per device or peer in all panels; peers are dashed and hollow besides.
OURS = ("#0072b2", "#56b4e9", "#d55e00", "#e69f00", "#882255", "#44aa99")
PEERS = ("#000000", "#009e73", "#cc79a7", "#7f7f7f", "#999933", "#6600cc", "#aa4400")


def _times(axes: Any, case: dict[str, Any], colours: dict[str, str]) -> None:
    """Time against pixels, log-log, each line with its name at its end."""
    lines: dict[str, list[dict[str, Any]]] = {}
    for row in case["rows"]:
        if "min" in row:
            lines.setdefault(row["who"], []).append(row)
    drawn = []
    for who, rows in lines.items():
        x, y = [row["vertices"] for row in rows], [1e3 * row["min"] for row in rows]
        peer = rows[0]["peer"]
        (line,) = axes.plot(
            x, y, marker="s" if peer else "o", linestyle="--" if peer else "-", color=colours[who], linewidth=1.6,
            markersize=5, markerfacecolor="white" if peer else colours[who],
        )  # fmt: skip
        drawn.append((line, who))
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    sizes = sorted({(row["vertices"], row["label"]) for row in case["rows"]})
    axes.set_xticks([n for n, _ in sizes], [label for _, label in sizes])
    axes.minorticks_off()
    axes.grid(True, which="major", color="#dddddd", linewidth=0.6)
    axes.set_ylabel("least time, ms")
    axes.set_xlabel("pixels")
    axes.margins(y=0.12)
    _name(axes, [(sorted(zip(*line.get_data(), strict=True)), who) for line, who in drawn], colours)


def _name(axes: Any, lines: list[tuple[list[tuple[float, float]], str]], colours: dict[str, str]) -> None:
    """Names at the right in the order of the lines, inside the panel's height and apart from each other.

    A line that ends early has its name where it would go on to, as far as that is inside.
    """
    low, high = (log10(value) for value in axes.get_ylim())
    gap = (high - low) * 0.075
    right = max((points[-1][0] for points, _ in lines), default=1)
    ends = sorted((log10(points[-1][1] * right / points[-1][0]), who) for points, who in lines)
    places: list[float] = []
    for y, _ in ends:
        places.append(max(y, places[-1] + gap if places else low))
    top = high
    for k in reversed(range(len(places))):
        places[k] = min(places[k], top)
        top = places[k] - gap
    for place, (_, who) in zip(places, ends, strict=True):
        axes.annotate(
            who,
            (1.015, 10**place),
            xycoords=axes.get_yaxis_transform(),
            color=colours[who],
            fontsize=9,
            va="center",
            annotation_clip=False,
        )


def _shares(axes: Any, cases: list[dict[str, Any]], colours: dict[str, str]) -> None:
    """Share of the bound, a line per case and a dot per device; the rows without transfers where there are any."""
    from matplotlib.transforms import blended_transform_factory

    names = []
    best = 100.0
    for case in cases:
        bounded = [row for row in case["rows"] if "bound" in row]
        ours = [row for row in bounded if not row["peer"]]
        if not ours:
            continue
        largest = max(row["vertices"] for row in ours)
        alone = [row for row in ours if row["transfers"] == "out"] or ours
        shown = [row for row in alone if row["vertices"] == largest]
        shown += [row for row in bounded if row["peer"] and row["vertices"] == largest]
        y = len(names)
        kind = shown[0]["bound"]["kind"]
        label = f" {shown[0]['label']}" if len({row["label"] for row in case["rows"]}) > 1 else ""
        names.append(f"{case['name']}{label}\n{kind}")
        for row in shown:
            share = 100 * row["bound"]["share"]
            best = max(best, share)
            axes.plot(
                share, y, marker="s" if row["peer"] else "o", color=colours[row["who"]], markersize=7,
                markerfacecolor="white" if row["peer"] else colours[row["who"]], linestyle="",
            )  # fmt: skip
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xscale("log")
    axes.set_xlim(right=best * 1.5)
    low, high = axes.get_xlim()
    ticks = [t for t in (0.01, 0.1, 1, 3, 10, 30, 100, 300) if low <= t <= high]
    axes.set_xticks(ticks, [f"{t:g} %" for t in ticks])
    axes.minorticks_off()
    axes.axvline(100, color="#444444", linewidth=1)
    above = blended_transform_factory(axes.transData, axes.transAxes)
    axes.text(100, 1.005, "bound", transform=above, ha="center", va="bottom", fontsize=8)
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.set_xlabel("share of the machine's bound, larger is better")


def draw(report: dict[str, Any], path: Path) -> None:
    """Write the picture; the extension of the path tells the format."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.lines import Line2D

    cases = report["cases"]
    growing = [case for case in cases if len({row["label"] for row in case["rows"]}) > 1]
    ours: dict[str, bool] = {}
    for case in cases:
        for row in case["rows"]:
            if "min" in row:
                ours.setdefault(row["who"], not row["peer"])
    order = sorted(ours, key=lambda who: not ours[who])
    devices, peers = ([who for who in order if ours[who] is kind] for kind in (True, False))
    # the peer of most cases in black
    peers.sort(key=lambda who: -sum(any(row["who"] == who for row in case["rows"]) for case in cases))
    colours = {who: OURS[k % len(OURS)] for k, who in enumerate(devices)}
    colours |= {who: PEERS[k % len(PEERS)] for k, who in enumerate(peers)}
    bounded = [case for case in cases if any("bound" in row and not row["peer"] for row in case["rows"])]
    height = max(4.5, 1.8 + 0.42 * len(bounded), 4.0 * len(growing))
    figure = plt.figure(figsize=(13.5 if growing else 8, height), layout="constrained")
    grid = figure.add_gridspec(max(1, len(growing)), 2 if growing else 1)
    for k, case in enumerate(growing):
        axes = figure.add_subplot(grid[k, 0])
        _times(axes, case, colours)
        axes.set_title(case["work"].replace(", by size", ""), fontsize=10, loc="left", wrap=True)
    axes = figure.add_subplot(grid[:, -1])
    _shares(axes, bounded, colours)
    axes.set_title("share of the bound (memory bandwidth or multiply-adds)", fontsize=10, loc="left", pad=18)
    seen = [who for who in order if any(r["who"] == who and "bound" in r for c in bounded for r in c["rows"])]
    handles = [
        Line2D(
            [], [], linestyle="", marker="o" if ours[who] else "s", color=colours[who],
            markerfacecolor=colours[who] if ours[who] else "white", label=who,
        )
        for who in seen
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside lower center", ncols=max(1, len(handles)), frameon=False, fontsize=9)
    about = report["machine"]
    figure.suptitle(
        f"gpureg {about['versions']['gpureg']} and its peers, {about['cpu']}, {about['cores']} cores, "
        f"{about['date'][:10]}",
        fontsize=11,
    )
    figure.savefig(path, dpi=130)
    plt.close(figure)
