"""Time gpureg and its peers side by side: ``python -m bench [--quick] [--only SUBSTRING] [--json FILE] ...``."""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
import time
from pathlib import Path
from typing import Any

from gpureg import backends

from . import machine, table
from .cases import CASES, NAMES
from .model import Bar, Case, Entry, Setup, peer

# A measurement lasts at least this long: short work is repeated inside it.
SHORTEST = 0.05
# Seconds after which a row stops repeating, once it has FEWEST measurements.
PATIENCE, FEWEST = 40.0, 3
# A row whose smaller size says that one call would take more seconds than this is left out; later on the device that
# "auto" prefers, which the bars are about.
TOO_LONG, TOO_LONG_BEST = 10.0, 30.0


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _timed(entry: Entry, calls: int) -> float:
    assert entry.call is not None
    begin = time.perf_counter()
    for _ in range(calls):
        entry.call()
    entry.finish()
    return (time.perf_counter() - begin) / calls


class Run:
    """Measures cases, and remembers the smaller sizes of each.

    Parameters
    ----------
    setup : Setup
    repeats : int
    bounds : dict
        Of :func:`bench.machine.bounds`.
    """

    def __init__(self, setup: Setup, repeats: int, bounds: dict[str, dict[str, float]]) -> None:
        self.setup, self.repeats, self.bounds = setup, repeats, bounds
        # Rows of the sizes before, by case, row and transfers; the smallest size first.
        self.before: dict[tuple[str, str, str], list[dict[str, Any]]] = {}

    def measure(self, case: Case) -> list[dict[str, Any]]:
        """Check, warm up and time a case's entries, in turns, so that a slow minute of the machine hits them all."""
        rows: list[dict[str, Any]] = []
        going: list[tuple[Entry, dict[str, Any], int]] = []
        for entry in case.entries:
            row: dict[str, Any] = {
                "case": case.name,
                "label": case.label,
                "vertices": case.vertices,
                "who": entry.who,
                "transfers": entry.transfers,
                "peer": entry.is_peer,
                "note": entry.note,
                "over": {},
                "bars": [],
            }
            rows.append(row)
            if entry.call is None:
                continue
            seconds = self._expected(row)
            if seconds > (TOO_LONG_BEST if entry.who == self.setup.devices[0] else TOO_LONG):
                row["note"] = f"left out: by its smaller sizes, one call would take {seconds:.0f} s"
                continue
            _say(f"  {entry.who}{'' if entry.is_peer else f', transfers {entry.transfers}'}: check and warm-up")
            try:
                good, said = (True, "") if entry.check is None else entry.check()
                row["check"], row["note"] = good, "; ".join(part for part in (entry.note, said) if part)
                if not good:
                    continue
                if entry.check is None:  # a check calls it too
                    _timed(entry, 1)
                # long work is not done once more to find that one call is enough
                calls = 1 if seconds > 1 else max(1, math.ceil(SHORTEST / _timed(entry, 1)))
            except Exception as error:  # one device that fails must not take the table down
                row.update(check=False, note=f"{type(error).__name__}: {error}")
                continue
            row.update(calls=calls, seconds=[], bytes=entry.bytes, operations=entry.operations)
            going.append((entry, row, calls))
        for turn in range(self.repeats):
            for entry, row, calls in going:
                if turn < FEWEST or sum(row["seconds"]) * calls < PATIENCE:
                    row["seconds"].append(_timed(entry, calls) * entry.times)
        for _, row, _ in going:
            row["min"], row["median"] = min(row["seconds"]), statistics.median(row["seconds"])
            self._bound(row)
            self.before.setdefault((row["case"], row["who"], row["transfers"]), []).append(row)
        for row in rows:
            if row["peer"] or "min" not in row:
                continue
            row["over"] = {
                other["who"]: row["min"] / other["min"] for other in rows if other["peer"] and "min" in other
            }
            row["bars"] = [self._judged(bar, row) for bar in case.bars if self._concerns(bar, row)]
        return rows

    def _smaller(self, row: dict[str, Any]) -> list[dict[str, Any]]:
        """The same row at the sizes before, and itself if it has a time."""
        return self.before.get((row["case"], row["who"], row["transfers"]), [])

    def _expected(self, row: dict[str, Any]) -> float:
        """Seconds of one call, by the last size before; 0 where there is none."""
        before = self._smaller(row)
        # What was left out at one size has no time at the next: the last that was measured tells.
        return before[-1]["min"] * row["vertices"] / before[-1]["vertices"] if before else 0.0

    def _bound(self, row: dict[str, Any]) -> None:
        """What the machine's bandwidth and rate allow at best, and how near the row comes."""
        device = self.bounds.get("host" if row["peer"] else row["who"], {})
        seconds = {}
        if row["bytes"] is not None and "memory" in device:
            seconds["memory"] = row["bytes"] / device["memory"]
        if row["operations"] is not None and "best_rate" in device:
            seconds["arithmetic"] = row["operations"] / device["best_rate"]
        if seconds:
            kind = max(seconds, key=lambda name: seconds[name])
            row["bound"] = {"kind": kind, "seconds": seconds[kind], "share": seconds[kind] / row["min"], "all": seconds}

    def _concerns(self, bar: Bar, row: dict[str, Any]) -> bool:
        if row["transfers"] != bar.transfers:
            return False
        if bar.growth and self._smaller(row)[:1] in ([], [row]):
            return False  # the smallest size itself
        start = "" if bar.on == "best" else bar.on
        able = [device for device in self.setup.devices if device.startswith(start)]
        return bool(able) and row["who"] == able[0]

    def _judged(self, bar: Bar, row: dict[str, Any]) -> dict[str, Any]:
        ratio = None
        if "min" not in row:
            pass
        elif bar.growth:
            first = self._smaller(row)[0]
            ratio = (row["min"] / row["vertices"]) / (first["min"] / first["vertices"])
        elif bar.over_bytes is not None:
            memory = self.bounds.get(row["who"], {}).get("memory")
            ratio = None if memory is None else row["min"] * memory / bar.over_bytes
        else:
            ratio = row["over"].get(bar.over)
        met = None if ratio is None or self.setup.size != "full" else ratio <= bar.at_most
        return {"over": bar.over, "at_most": bar.at_most, "ratio": ratio, "met": met}


def main() -> int:
    """Run the cases; 1 if a check failed, else 0."""
    parser = argparse.ArgumentParser(prog="python -m bench", description="Time gpureg and its peers side by side.")
    parser.add_argument("--quick", action="store_true", help="small sizes and two repeats: does everything run?")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write everything measured to this file")
    parser.add_argument("--plot", metavar="FILE", type=Path, help="draw the picture into this file (PNG, SVG, PDF)")
    parser.add_argument("--only", metavar="SUBSTRING", default="", help="only cases or devices whose name contains it")
    parser.add_argument("--repeat", metavar="N", type=int, help="measurements per row (default 7, with --quick 2)")
    parser.add_argument("--markdown", action="store_true", help="print the table as README.md holds it")
    parser.add_argument("--from", metavar="FILE", type=Path, dest="source", help="measure nothing: show this JSON file")
    options = parser.parse_args()
    repeats = (2 if options.quick else 7) if options.repeat is None else options.repeat
    if repeats < 1:
        parser.error(f"--repeat must be >= 1, got {repeats}")
    for name in ("json", "plot"):
        path = getattr(options, name)
        if path is not None and not path.resolve().parent.is_dir():
            parser.error(f"--{name}: the folder of {path} does not exist")
    if options.plot is not None and peer("matplotlib") is None:
        parser.error("--plot needs matplotlib: pip install 'gpureg[bench]'")

    if options.source is not None:
        try:
            report = json.loads(options.source.read_text())
        except (OSError, ValueError) as error:
            parser.error(f"--from {options.source}: {error}")
    else:
        report = _measured(parser, options, repeats)
    print(table.markdown(report) if options.markdown else table.plain(report))
    if options.json is not None:
        options.json.write_text(json.dumps(report, indent=1) + "\n")
    if options.plot is not None:
        from .plot import draw

        draw(report, options.plot)
    return 1 if any(row.get("check") is False for case in report["cases"] for row in case["rows"]) else 0


def _measured(parser: argparse.ArgumentParser, options: argparse.Namespace, repeats: int) -> dict[str, Any]:
    devices = [device.id for device in backends.devices()]
    wanted = [name for name in NAMES if options.only in name]
    if not wanted:
        wanted, devices = list(NAMES), [device for device in devices if options.only in device]
    if not devices:
        parser.error(f"--only {options.only}: no case ({', '.join(NAMES)}) and no device has it in its name")
    size = "quick" if options.quick else "full"
    about = machine.describe()
    _say("bounds of the machine")
    bounds = machine.bounds(options.quick, repeats)
    report: dict[str, Any] = {"machine": about, "size": size, "bounds": bounds, "cases": []}
    setup = Setup(size, devices)
    run = Run(setup, repeats, bounds)
    for names, function in CASES.items():
        if not set(names) & set(wanted):
            continue
        for case in function(setup):
            if case.name not in wanted:
                continue
            _say(f"{case.name} {case.label}: {case.work}")
            rows = run.measure(case)
            same = [known for known in report["cases"] if known["name"] == case.name]
            if same:
                same[0]["rows"] += rows
            else:
                report["cases"].append({"name": case.name, "work": case.work, "notes": case.notes, "rows": rows})
    return report
