"""Time gpureg and its peers side by side: ``python bench/run.py [--quick] [--json FILE] [--only SUBSTRING] ...``.

README.md, beside this file, says how to read the table.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import os
import platform
import statistics
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from cases import CASES, Case, Entry, Setup, peer

import gpureg as gr
from gpureg import backends

# A measurement lasts at least this long: short work is repeated inside it.
SHORTEST = 0.05
# Seconds after which a row stops repeating, once it has FEWEST measurements.
PATIENCE, FEWEST = 40.0, 3


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def bandwidth(quick: bool, repeats: int) -> dict[str, float]:
    """Bytes per second of copy and sum (a = b + c) in float32, with one thread and with one per core.

    The sum moves what a STREAM triad moves, three arrays, and stands for it: numpy has no fused a = b + s c. A ufunc of
    numpy runs on one thread and lets others run meanwhile, so a small pool shares the arrays out.
    """
    n = 1 << 24 if quick else 1 << 26
    a, b, c = (np.full(n, value, np.float32) for value in (0, 1, 2))

    def copy(begin: int, end: int) -> None:
        np.copyto(a[begin:end], b[begin:end])

    def triad(begin: int, end: int) -> None:
        np.add(b[begin:end], c[begin:end], out=a[begin:end])

    best = {"array_bytes": float(a.nbytes)}
    for name, work, arrays in (("copy", copy, 2), ("triad", triad, 3)):
        for threads in sorted({1, cores()}):
            edges = [n * k // threads for k in range(threads + 1)]
            with ThreadPoolExecutor(threads) as pool:
                seconds = []
                for _ in range(repeats + 1):  # the first is the warm-up
                    begin = time.perf_counter()
                    list(pool.map(work, edges[:-1], edges[1:]))
                    seconds.append(time.perf_counter() - begin)
            best[f"{name}_{threads}"] = arrays * a.nbytes / min(seconds[1:])
    best["triad"] = max(best[f"triad_{threads}"] for threads in {1, cores()})
    return best


def machine() -> dict[str, Any]:
    """What the numbers were measured on and with."""
    versions = {"gpureg": gr.__version__, "python": platform.python_version()}
    for module, package in (("numpy", "numpy"), ("scipy", "scipy"), ("pyopencl", "pyopencl"), ("warp", "warp-lang")):
        try:
            versions[module] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[module] = "not installed"
    for module, package in (("opencv", "cv2"), ("scikit-image", "skimage")):
        found = peer(package)
        versions[module] = "not installed" if found is None else found.__version__
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "cpu": _cpu(),
        "cores": cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "load_before": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "versions": versions,
        "devices": {
            device.id: f"{device.name}, {device.driver}, vectors of {device.vector_width}"
            for device in backends.devices()
        },
        "absent": backends.absent(),
    }


def _timed(entry: Entry, calls: int) -> float:
    assert entry.call is not None
    begin = time.perf_counter()
    for _ in range(calls):
        entry.call()
    entry.finish()
    return (time.perf_counter() - begin) / calls


def measure(case: Case, repeats: int) -> list[dict[str, Any]]:
    """Check, warm up and time the entries of a case, in turns, so that a slow minute of the machine hits them all."""
    rows: list[dict[str, Any]] = []
    going: list[tuple[Entry, dict[str, Any], int]] = []
    for entry in case.entries:
        row: dict[str, Any] = {"case": case.name, "who": entry.who, "peer": entry.is_peer, "note": entry.note}
        rows.append(row)
        if entry.call is None:
            continue
        _say(f"  {entry.who}: check and warm-up")
        try:
            good, said = (True, "") if entry.check is None else entry.check()
            row["check"], row["note"] = good, "; ".join(part for part in (entry.note, said) if part)
            if not good:
                continue
            if entry.check is None:  # a check calls it too
                _timed(entry, 1)
            calls = max(1, math.ceil(SHORTEST / _timed(entry, 1)))
        except Exception as error:  # one device that fails must not take the table down
            row.update(check=False, note=f"{type(error).__name__}: {error}")
            continue
        row.update(calls=calls, seconds=[], bytes=entry.bytes)
        going.append((entry, row, calls))
    for turn in range(repeats):
        for entry, row, calls in going:
            if turn < FEWEST or sum(row["seconds"]) * calls < PATIENCE:
                row["seconds"].append(_timed(entry, calls))
    for _, row, _ in going:
        row["min"], row["median"] = min(row["seconds"]), statistics.median(row["seconds"])
    for row in rows:
        row["over"] = {
            other["who"]: row["min"] / other["min"]
            for other in rows
            if other["peer"] and not row["peer"] and "min" in other and "min" in row
        }
    return rows


HEADERS = ("who", "min ms", "median ms", "repeats", "min over the peer's", "GB/s", "of triad", "agreement and notes")


def _cells(row: dict[str, Any], triad: float) -> tuple[str, ...]:
    if "min" not in row:
        failed = "CHECK FAILED, not timed: " if row.get("check") is False else ""
        return (row["who"], "-", "-", "-", "-", "-", "-", failed + row["note"])
    rate = row["bytes"] / row["min"] if row["bytes"] else None
    return (
        row["who"],
        f"{1e3 * row['min']:.2f}",
        f"{1e3 * row['median']:.2f}",
        str(len(row["seconds"])),
        ", ".join(f"{ratio:.2f} {who}" for who, ratio in row["over"].items()) or "-",
        "-" if rate is None else f"{rate / 1e9:.1f}",
        "-" if rate is None else f"{100 * rate / triad:.0f} %",
        row["note"] or "-",
    )


def _heading(report: dict[str, Any]) -> list[str]:
    about, memory = report["machine"], report["bandwidth"]
    rates = ", ".join(
        f"{work} on {threads} {memory[f'{work}_{threads}'] / 1e9:.1f}"
        for work in ("copy", "triad")
        for threads in sorted({1, about["cores"]})
    )
    lines = [
        f"{about['date']}, {about['cpu']}, {about['cores']} cores, {about['system']}"
        + (f", load {about['load_before']:.2f} before the run" if about["load_before"] is not None else ""),
        ", ".join(f"{name} {version}" for name, version in about["versions"].items()),
        *(f"{name}: {text}" for name, text in about["devices"].items()),
        *(f"{name}: absent, {why}" for name, why in about["absent"].items()),
        f"memory, GB/s by numpy in float32, arrays of {memory['array_bytes'] / 1e6:.0f} MB (copy a = b counts 2, "
        f"triad a = b + c counts 3; 'on k' = k threads): {rates}; shares are of triad {memory['triad'] / 1e9:.1f}",
    ]
    return lines


def plain(report: dict[str, Any]) -> str:
    """The report as text for a terminal."""
    lines = _heading(report)
    for case in report["cases"]:
        cells = [HEADERS, *(_cells(row, report["bandwidth"]["triad"]) for row in case["rows"])]
        widths = [max(len(line[k]) for line in cells) for k in range(len(HEADERS) - 1)] + [0]
        lines += ["", f"{case['name']}: {case['work']}"]
        for line in cells:
            pairs = enumerate(zip(line, widths, strict=True))
            lines.append(
                "  ".join(f"{text:>{w}}" if 0 < k < 4 or k in (5, 6) else f"{text:<{w}}" for k, (text, w) in pairs)
            )
        lines += [f"- {note}" for note in case["notes"]]
    return "\n".join(lines)


def markdown(report: dict[str, Any]) -> str:
    """The report as Markdown, for README.md."""
    lines = [f"- {line}" for line in _heading(report)]
    for case in report["cases"]:
        lines += ["", f"**{case['name']}**: {case['work']}", ""]
        lines += ["| " + " | ".join(HEADERS) + " |", "|---|" + "---:|" * 3 + "---|---:|---:|---|"]
        lines += [f"| {' | '.join(_cells(row, report['bandwidth']['triad']))} |" for row in case["rows"]]
        lines += ["", *(f"- {note}" for note in case["notes"])]
    return "\n".join(lines)


def main() -> int:
    """Run the cases; 1 if a check failed, else 0."""
    parser = argparse.ArgumentParser(description="Time gpureg and its peers side by side.")
    parser.add_argument("--quick", action="store_true", help="small sizes and two repeats: does everything run?")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write everything measured to this file")
    parser.add_argument("--only", metavar="SUBSTRING", default="", help="only cases or devices whose name contains it")
    parser.add_argument("--repeat", metavar="N", type=int, help="measurements per row (default 7, with --quick 2)")
    parser.add_argument("--markdown", action="store_true", help="print the table as README.md holds it")
    options = parser.parse_args()
    repeats = options.repeat or (2 if options.quick else 7)
    if repeats < 1:
        parser.error(f"--repeat must be >= 1, got {repeats}")
    if options.json is not None and not options.json.resolve().parent.is_dir():
        parser.error(f"--json: the folder of {options.json} does not exist")

    devices = [device.id for device in backends.devices()]
    names = " ".join(CASES).split()
    wanted = [name for name in names if options.only in name]
    if not wanted:
        wanted, devices = names, [device for device in devices if options.only in device]
    if not devices:
        parser.error(f"--only {options.only}: no case ({', '.join(names)}) and no device has it in its name")

    about = machine()
    _say("memory bandwidth")
    report: dict[str, Any] = {
        "machine": about,
        "quick": options.quick,
        "bandwidth": bandwidth(options.quick, repeats),
        "cases": [],
    }
    for key, cases in CASES.items():
        if not set(key.split()) & set(wanted):
            continue
        for case in cases(Setup(options.quick, devices)):
            if case.name not in wanted:
                continue
            _say(f"{case.name}: {case.work}")
            rows = measure(case, repeats)
            report["cases"].append({"name": case.name, "work": case.work, "notes": case.notes, "rows": rows})
    print(markdown(report) if options.markdown else plain(report))
    if options.json is not None:
        options.json.write_text(json.dumps(report, indent=1) + "\n")
    failed = [row for case in report["cases"] for row in case["rows"] if row.get("check") is False]
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
