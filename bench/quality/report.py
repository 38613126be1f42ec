"""The tables: PSNR of each row, means over groups, the tuned filters one by one, seconds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .measure import reached, taken
from .methods import DEFAULT, OURS, PEERS, REFERENCES, SINGLE
from .scenes import README
from .tuned import FILTERS, JUDGED

Row = dict[str, Any]
BEST = "best of scikit-image"
REFERENCE = "BM3D, BM4D"
NAMES = {"grey": "grey, README", "colour": "colour, README"}


def best_filter(row: Row) -> tuple[float, str] | None:
    """PSNR of the best filter of scikit-image in a row, and its name."""
    found = [(value, who) for who in JUDGED if (value := reached(row, who)) is not None]
    return max(found, default=None)


def value(row: Row, column: str) -> float | None:
    """PSNR in a column: a method, the reference of the row, or the best filter of scikit-image."""
    if column == BEST:
        return (best_filter(row) or (None,))[0]
    if column == REFERENCE:
        return next((found for who in REFERENCES if (found := reached(row, who)) is not None), None)
    return reached(row, column)


def gain(row: Row, column: str) -> float | None:
    """What our default has more than a column, in dB."""
    ours, theirs = value(row, DEFAULT), value(row, column)
    return None if ours is None or theirs is None else ours - theirs


COMPARED = (REFERENCE, SINGLE, BEST)
COLUMNS = ("noisy", BEST, REFERENCE, *OURS)


def line(*cells: str) -> str:
    """A line of a table."""
    return f"| {' | '.join(cells)} |"


def head(words: Sequence[str], numbers: Sequence[str]) -> list[str]:
    """The first two lines of a table: columns of words, and columns of numbers."""
    return [line(*words, *numbers), "|" + "---|" * len(words) + "---:|" * len(numbers)]


def number(found: float | None, form: str = ".2f") -> str:
    """A cell; a dash where there is no number."""
    return "-" if found is None else f"{found:{form}}"


def by_row(rows: Sequence[Row]) -> list[str]:
    """PSNR of each scene and sigma, and what the default has more."""
    lines = head(["scene", "sigma"], [*COLUMNS, *(f"{DEFAULT} - {column}" for column in COMPARED)])
    for row in rows:
        best = best_filter(row)
        cells = [number(value(row, column)) for column in COLUMNS]
        cells[COLUMNS.index(BEST)] = f"{best[0]:.2f} {best[1]}" if best else "-"
        gains = [number(gain(row, column), "+.2f") for column in COMPARED]
        lines.append(line(row["scene"], f"{row['sigma']:g}", *cells, *gains))
    return lines


def groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows of each group that there is, and of all pictures of the README."""
    found = {}
    there = list(dict.fromkeys(row["group"] for row in rows))
    for group in there:
        found[NAMES.get(group, group)] = [row for row in rows if row["group"] == group]
        if group == README[-1] and README[0] in there:
            found["all, README"] = [row for row in rows if row["group"] in README]
    return found


def mean(rows: Sequence[Row], of: Callable[[Row], float | None]) -> float | None:
    """The mean of a number; None where a row has it not, as means over different rows say nothing."""
    found = [of(row) for row in rows]
    known = [x for x in found if x is not None]
    return float(np.mean(known)) if known and len(known) == len(found) else None


def by_group(rows: Sequence[Row]) -> list[str]:
    """Mean PSNR over each group, by sigma and over all, and the mean and the worst of what the default has more."""
    lines = head(["group", "sigma", "rows"], [*COLUMNS, *(f"{DEFAULT} - {column}: mean, worst" for column in COMPARED)])
    for name, members in groups(rows).items():
        sigmas = sorted({row["sigma"] for row in members})
        for sigma in [*sigmas, *([None] if len(sigmas) > 1 else [])]:
            chosen = [row for row in members if sigma is None or row["sigma"] == sigma]
            cells = [number(mean(chosen, lambda row, column=column: value(row, column))) for column in COLUMNS]  # type: ignore[misc]
            for column in COMPARED:
                gains = [(found, row) for row in chosen if (found := gain(row, column)) is not None]
                if len(gains) < len(chosen):
                    cells.append("-")
                    continue
                worst, where = min(gains, key=lambda pair: pair[0])
                place = f"{where['scene']} {where['sigma']:g}"
                cells.append(f"{np.mean([found for found, _ in gains]):+.2f}, {worst:+.2f} {place}")
            lines.append(line(name, "all" if sigma is None else f"{sigma:g}", str(len(chosen)), *cells))
    return lines


def by_filter(rows: Sequence[Row]) -> list[str]:
    """PSNR of scikit-image's filters, each in its column."""
    shown = [row for row in rows if any(who in row["methods"] for who in FILTERS)]
    if not shown:
        return []
    lines = head(["scene", "sigma"], list(FILTERS))
    for row in shown:
        cells = [number(value(row, who)) for who in FILTERS]
        lines.append(line(row["scene"], f"{row['sigma']:g}", *cells))
    return lines


def by_time(rows: Sequence[Row], run: str) -> list[str]:
    """Seconds of each method; a star where they are of an earlier run than this one."""
    columns = [who for who in (*OURS, *PEERS) if any(who in row["methods"] for row in rows)]
    lines = head(["scene", "sigma"], columns)
    for row in rows:
        cells = []
        for who in columns:
            found = taken(row, who)
            cells.append(f"{found[0]:.3g}{'' if found[1] == run else '*'}" if found else "-")
        lines.append(line(row["scene"], f"{row['sigma']:g}", *cells))
    return lines


def markdown(rows: Sequence[Row], run: str) -> str:
    """The tables of a report with headings."""
    parts = [("PSNR in dB", by_row(rows)), ("Means", by_group(rows))]
    parts += [("scikit-image's filters", by_filter(rows)), ("Seconds (* of an earlier run)", by_time(rows, run))]
    return "\n\n".join("\n".join([f"### {title}", "", *lines]) for title, lines in parts if lines)
