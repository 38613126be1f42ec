"""The table as text, and the picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .counts import COUNTS, H200, table


def predicted() -> str:
    """The predicted table alone."""
    return "\n".join(table())


def _time(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1e3 * seconds:.3g}"


def _row(row: dict[str, Any]) -> str:
    count = COUNTS.get(row["name"])
    model = count.seconds(row["vertices"]) if count is not None and "vertices" in row else None
    least = row.get("min")
    per_million = None if least is None or row["kind"] == "iterated" else 1e6 * least / row["vertices"]
    share = f"{100 * row['share']:.0f} %" if "share" in row else "-"
    cells = [row["name"], row["size"], row["device"], _time(least), _time(per_million), share, _time(model)]
    return "| " + " | ".join([*cells, row.get("note", "")]) + " |"


def text(found: dict[str, Any]) -> str:
    """Everything that was found, as Markdown."""
    about = found["machine"]
    lines = [f"gpureg {about['versions']['gpureg']}, {about['date']}, {about['cpu']}, {about['cores']} cores", ""]
    for device, bounds in found["bounds"].items():
        measured = ", ".join(f"{name} {1e-9 * value:.4g} G/s" for name, value in bounds.items())
        lines += [f"{device}: {about['devices'].get(device, '')}", f"    {measured or 'no bounds'}"]
        check = found["checks"][device]
        compared = f"{check['comparisons']} comparisons of {check['primitives']} primitives"
        lines.append(f"    {compared}, {len(check['wrong'])} wrong")
        if check.get("arrays"):
            lines.append(f"    arrays on the device: {', '.join(check['arrays'])}")
        lines += [f"    WRONG: {sentence}" for sentence in check["wrong"]]
        if check["not compared"]:
            lines.append(f"    not compared: {', '.join(check['not compared'])}")
    lines += [
        "",
        f"| | size | device | ms | ms per megapixel | of the copy bandwidth | {H200.name}, predicted, ms | |",
        "|---|---|---|---:|---:|---:|---:|---|",
    ]
    lines += [_row(row) for row in found["rows"]]
    for peer in found["peers"]:
        per_million = _time(1e6 * peer["min"] / peer["vertices"])
        lines.append(f"| {peer['name']} | {peer['size']} | CPU | {_time(peer['min'])} | {per_million} | - | - | |")
    return "\n".join(lines)


def draw(found: dict[str, Any], path: Path) -> None:
    """Shares of the copy bandwidth, and measured times beside the predicted ones."""
    from matplotlib.figure import Figure

    shares = [row for row in found["rows"] if "share" in row]
    times = [row for row in found["rows"] if "min" in row and row["name"] in COUNTS]
    figure = Figure(figsize=(12, 2 + 0.28 * max(len(shares), len(times), 1)), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.barh([f"{row['name']}\n{row['device']}" for row in shares], [100 * row["share"] for row in shares])
    left.axvline(100, color="black", linewidth=0.8)
    left.set_xlabel("percent of the copy bandwidth")
    names = [f"{row['name']}, {row['size']}\n{row['device']}" for row in times]
    right.scatter([1e3 * row["min"] for row in times], names, label="measured")
    model = [1e3 * COUNTS[row["name"]].seconds(row["vertices"]) for row in times]
    right.scatter(model, names, marker="|", s=120, label=f"predicted for an {H200.name}")
    right.set_xscale("log")
    right.set_xlabel("ms")
    right.legend()
    for axes in (left, right):
        axes.invert_yaxis()
        axes.tick_params(axis="y", labelsize=7)
    figure.savefig(path)
