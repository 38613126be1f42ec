"""The report as text: for a terminal, and as Markdown for README.md."""

from __future__ import annotations

from typing import Any

Row = dict[str, Any]

RIGHT = {"min ms", "median ms", "repeats", "ns/vertex", "ratio", "at most"}


def heading(report: dict[str, Any]) -> list[str]:
    """Machine, versions, devices and what was measured of their speed."""
    about, bounds = report["machine"], report["bounds"]
    host = bounds["host"]
    lines = [
        f"{about['date']}, {about['cpu']}, {about['cores']} cores, {about['system']}"
        + (f", load {about['load_before']:.2f} before the run" if about["load_before"] is not None else ""),
        ", ".join(f"{name} {version}" for name, version in about["versions"].items()),
    ]
    for name, text in about["devices"].items():
        own = bounds.get(name, {})
        speeds = [f"{work} {own[work] / 1e9:.1f} GB/s" for work in ("copy", "triad") if work in own]
        if "rate" in own:
            speeds.append(f"multiply-adds {own['rate'] / 1e9:.0f} Gop/s")
        lines.append(f"{name}: {text}" + (f"; {', '.join(speeds)}" if speeds else ""))
    lines += [f"{name}: absent, {why}" for name, why in about["absent"].items()]
    rates = ", ".join(
        f"{work} on {threads} thread(s) {host[f'{work}_{threads}'] / 1e9:.1f} GB/s"
        for work in ("copy", "triad")
        for threads in sorted({1, about["cores"]})
    )
    lines.append(
        f"host, by numpy in float32, arrays of {host['array_bytes'] / 1e6:.0f} MB: {rates}, "
        f"matmul {host['rate'] / 1e9:.0f} Gop/s"
    )
    lines.append(
        f"bounds of a CPU device, the best of those: {host['memory'] / 1e9:.1f} GB/s, "
        f"{host['best_rate'] / 1e9:.0f} Gop/s"
    )
    return lines


def _verdict(bar: dict[str, Any]) -> str:
    return {True: "met", False: "MISSED", None: "not judged"}[bar["met"]]


def bars(report: dict[str, Any]) -> list[tuple[str, ...]]:
    """Every bar in one table, its header first."""
    lines: list[tuple[str, ...]] = [("case", "row", "over", "ratio", "at most", "bar")]
    for case in report["cases"]:
        several = len({row["label"] for row in case["rows"]}) > 1
        for row in case["rows"]:
            for bar in row["bars"]:
                size = f" {row['label']}" if several else ""
                lines.append(
                    (
                        case["name"] + size,
                        f"{row['who']}, transfers {row['transfers']}",
                        bar["over"],
                        "-" if bar["ratio"] is None else f"{bar['ratio']:.2f}",
                        f"{bar['at_most']:g}",
                        _verdict(bar),
                    )
                )
    return lines


def rows(case: dict[str, Any]) -> list[tuple[str, ...]]:
    """The cells of a case, the header first; a case of several sizes has a column for them, and time per vertex."""
    several = len({row["label"] for row in case["rows"]}) > 1
    header = ["who", "transfers", "min ms", "median ms", "repeats", "min over the peer's", "of its bound", "notes"]
    if several:
        header[1:1] = ["size"]
        header[5:5] = ["ns/vertex"]
    return [tuple(header), *(_cells(row, several) for row in case["rows"])]


def _milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.3f}" if seconds < 1e-3 else f"{1e3 * seconds:.2f}"


def _cells(row: Row, several: bool) -> tuple[str, ...]:
    first = [row["who"], row["label"], row["transfers"]] if several else [row["who"], row["transfers"]]
    if "min" not in row:
        failed = "CHECK FAILED, not timed: " if row.get("check") is False else ""
        return (*first, *["-"] * (6 if several else 5), failed + row["note"])
    ratios = [f"{ratio:.2f} {who}" for who, ratio in row["over"].items()]
    for bar in row["bars"]:
        verdict = "" if bar["met"] is None else f" ({_verdict(bar)}, bar {bar['at_most']:g})"
        if bar["over"] in row["over"]:
            k = list(row["over"]).index(bar["over"])
            ratios[k] += verdict
        elif bar["ratio"] is not None:
            ratios.append(f"{bar['ratio']:.2f} {bar['over']}{verdict}")
    bound = row.get("bound")
    return (
        *first,
        _milliseconds(row["min"]),
        _milliseconds(row["median"]),
        str(len(row["seconds"])),
        *([f"{1e9 * row['min'] / row['vertices']:.2f}"] if several else []),
        ", ".join(ratios) or "-",
        "-" if bound is None else f"{100 * bound['share']:.0f} % {bound['kind']}",
        row["note"] or "-",
    )


def _text(cells: list[tuple[str, ...]]) -> list[str]:
    header = cells[0]
    widths = [max(len(line[k]) for line in cells) for k in range(len(header) - 1)] + [0]
    return [
        "  ".join(
            f"{text:>{width}}" if name in RIGHT else f"{text:<{width}}"
            for name, text, width in zip(header, line, widths, strict=True)
        ).rstrip()
        for line in cells
    ]


def _markdown(cells: list[tuple[str, ...]]) -> list[str]:
    header = cells[0]
    rule = "|".join("---:" if name in RIGHT else "---" for name in header)
    return [f"| {' | '.join(header)} |", f"|{rule}|", *(f"| {' | '.join(line)} |" for line in cells[1:])]


def plain(report: dict[str, Any]) -> str:
    """The report as text for a terminal."""
    lines = heading(report)
    judged = bars(report)
    if len(judged) > 1:
        lines += ["", "bars", *_text(judged)]
    for case in report["cases"]:
        lines += ["", f"{case['name']}: {case['work']}", *_text(rows(case))]
        lines += [f"- {note}" for note in case["notes"]]
    return "\n".join(lines)


def markdown(report: dict[str, Any]) -> str:
    """The report as Markdown, for README.md."""
    lines = [f"- {line}" for line in heading(report)]
    judged = bars(report)
    if len(judged) > 1:
        lines += ["", "**bars**", "", *_markdown(judged)]
    for case in report["cases"]:
        lines += ["", f"**{case['name']}**: {case['work']}", "", *_markdown(rows(case))]
        lines += ["", *(f"- {note}" for note in case["notes"])] if case["notes"] else []
    return "\n".join(lines)
