"""One command for a machine with a GPU: right results first, then times beside the measured bandwidth and the model."""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from gpureg import backends

from .. import machine
from ..model import peer
from . import arrays, checks, report, rows

# Seconds of a measurement at least, and measurements of a row; the share of the time that the checks may take.
SHORTEST, REPEATS, CHECKS = 0.05, 5, 0.35


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def chosen(named: list[str]) -> list[Any]:
    """The devices to run on: those named; or all GPUs; or, without one, the first of each backend but numpy."""
    found = backends.devices()
    if named:
        return [device for device in found if device.id in named]
    gpus = [device for device in found if device.kind == "gpu"]
    first = {device.backend: device for device in reversed(found) if device.backend != "numpy"}
    return gpus or list(first.values())[::-1]


def bandwidth(device: Any, quick: bool) -> dict[str, float]:
    """Copy, triad and multiply-adds that are measured on a device, as :func:`bench.machine.bounds` does."""
    if device.backend == "opencl":
        return machine._opencl_bounds(device, quick, 3)
    if device.kind == "gpu":
        from ..warp_bounds import measure

        return measure(device.handle, quick, 3, machine._best, machine.SHORTEST)
    return {name: value for name, value in machine.host_bounds(quick, 2).items() if name in ("copy", "triad", "rate")}


def timed(call: Callable[[], Any], finish: Callable[[], None], repeats: int) -> list[float]:
    """Seconds of a call, several times; the first two calls build kernels and record launches."""

    def once(count: int) -> float:
        begin = time.perf_counter()
        for _ in range(count):
            call()
        finish()
        return (time.perf_counter() - begin) / count

    once(1)
    count = max(1, round(SHORTEST / once(1)))
    return [once(count) for _ in range(repeats)]


def all_rows(quick: bool) -> Iterator[rows.Row]:
    """The rows; `quick` shows that everything runs."""
    if quick:
        yield from rows.iterated(64, 12, 400, 100)
        yield from rows.one_step(40)
        yield from rows.doors(40, 48)
        return
    yield from rows.iterated(4096, 256, 1_000_000, 100_000)
    yield from rows.one_step(2048)
    yield from rows.doors(1024, 4096)


def measure(device: Any, row: rows.Row, copy: float | None, repeats: int) -> dict[str, Any]:
    """A row of the table; what a device cannot do says so."""
    entry: dict[str, Any] = {
        "name": row.name, "kind": row.kind, "size": row.size, "vertices": row.vertices, "device": device.id,
        "bytes": row.bytes,
    }  # fmt: skip
    try:
        seconds = timed(*row.prepare(device.id), repeats)
    except Exception as error:  # one row that fails must not take the table down
        return entry | {"note": f"{type(error).__name__}: {error}"[:200]}
    entry |= {"seconds": seconds, "min": min(seconds), "median": statistics.median(seconds)}
    if row.bytes and copy and row.kind == "iterated":
        entry["share"] = row.bytes / entry["min"] / copy
    return entry


def run(devices: list[Any], quick: bool, minutes: float) -> dict[str, Any]:
    """Everything that is measured, within so many minutes."""
    end = time.monotonic() + 60 * minutes
    found: dict[str, Any] = {"machine": machine.describe(), "size": "quick" if quick else "full", "rows": []}
    found |= {"bounds": {}, "checks": {}, "peers": []}
    for number, device in enumerate(devices):
        _say(f"{device.id}: bandwidth")
        try:
            found["bounds"][device.id] = bandwidth(device, quick)
        except Exception as error:
            found["bounds"][device.id] = {}
            _say(f"{device.id}: no bounds, {type(error).__name__}: {error}")
        _say(f"{device.id}: every primitive against numpy")
        until = time.monotonic() + CHECKS * (end - time.monotonic()) / (len(devices) - number)
        check = found["checks"][device.id] = checks.every_primitive(device.id, until, quick)
        check["arrays"], wrong = arrays.compared(device.id)
        check["wrong"] += wrong
    repeats = 2 if quick else REPEATS
    for row in all_rows(quick):
        for device in devices:
            if time.monotonic() > end:
                found["rows"].append({"name": row.name, "size": row.size, "device": device.id, "kind": row.kind,
                                      "note": "no time was left"})  # fmt: skip
                continue
            _say(f"{row.name}, {row.size}: {device.id}")
            copy = found["bounds"][device.id].get("copy")
            found["rows"].append(measure(device, row, copy, repeats))
    side = 40 if quick else 1024
    for name, call in rows.opencv_seconds(side):
        if time.monotonic() < end:
            seconds = timed(call, lambda: None, 2)
            found["peers"].append({"name": name, "size": f"{side} x {side}", "vertices": side**2, "min": min(seconds)})
    return found


def main(arguments: list[str] | None = None) -> int:
    """Run it; 1 if a result was wrong."""
    parser = argparse.ArgumentParser(prog="python -m bench.gpu", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="tiny data: does everything run?")
    parser.add_argument("--device", metavar="NAME", action="append", default=[], help="such as opencl:0 (all GPUs)")
    parser.add_argument("--minutes", type=float, default=8.0, help="rows that begin later are left out (default 8)")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write everything measured to this file")
    parser.add_argument("--plot", metavar="FILE", type=Path, help="draw the shares of the bandwidth into this file")
    parser.add_argument("--predicted", action="store_true", help="print the predicted table of an H200 alone")
    parser.add_argument("--from", metavar="FILE", type=Path, dest="source", help="measure nothing: show this JSON file")
    options = parser.parse_args(arguments)
    if options.predicted:
        print(report.predicted())
        return 0
    if options.plot is not None and peer("matplotlib") is None:
        parser.error("--plot needs matplotlib: pip install 'gpureg[bench]'")
    if options.source is not None:
        found = json.loads(options.source.read_text())
    else:
        devices = chosen(options.device)
        if not devices:
            parser.error(f"no such device: {', '.join(device.id for device in backends.devices())} are there")
        found = run(devices, options.quick, options.minutes)
    print(report.text(found))
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=1) + "\n")
    if options.plot is not None:
        report.draw(found, options.plot)
    return int(any(check["wrong"] for check in found["checks"].values()))
