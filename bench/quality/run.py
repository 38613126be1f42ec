"""The command: what is asked for, the files, and the text."""

from __future__ import annotations

import argparse
import functools
import json
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from gpureg.files.pictures import write_atomically

from .. import machine
from . import __doc__ as about_this
from . import cost, real, report
from .measure import Rows, Run
from .methods import PEERS
from .scenes import SCENES, SEEDS, SIGMAS

# How the names of cases of real noise begin for --only.
REAL = "real: "


def _arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m bench.quality", description=about_this, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    several: dict[str, Any] = {"action": "append", "metavar": "SUBSTRING"}
    parser.add_argument(
        "--only", **several, help='images with it in their name or group, or "real"; once or several times'
    )
    parser.add_argument("--sigma", type=float, action="append", help="once or several times; default 10, 20 and 40")
    parser.add_argument("--seeds", type=int, default=SEEDS, metavar="N", help=f"draws of noise; default {SEEDS}")
    parser.add_argument("--filters", **several, help='peers with it in their name, "none" for no peer; default all')
    parser.add_argument("--peers", type=Path, metavar="FILE", help="keeps the peers' results: read, completed, written")
    parser.add_argument("--time-again", action="store_true", help="call peers of --peers once more, for their seconds")
    parser.add_argument("--json", type=Path, metavar="FILE", help="where the whole report goes")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draws PSNR against seconds")
    parser.add_argument("--from", type=Path, metavar="FILE", dest="earlier", help="shows a report of --json again")
    return parser


def _chosen(parser: argparse.ArgumentParser, only: Sequence[str]) -> tuple[list[str], list[str]]:
    """The scenes and the cases of real noise that are asked for and there."""
    names = [name for name, s in SCENES.items() if any(part in name or part in s.group for part in only)]
    cases = [case for case in real.CASES if any((REAL + case).startswith(part) for part in only)]
    if not names and not cases:
        parser.error(
            f"no image has {' or '.join(map(repr, only))} in its name or group; there are {', '.join(SCENES)}, real"
        )
    absent = {name: SCENES[name].missing for name in names if SCENES[name].missing}
    if of_data := [name for name in absent if isinstance(SCENES[name].source, str)]:
        parser.error(f"there is no picture {', '.join(of_data)}: {absent[of_data[0]]}")
    for name, why in absent.items():
        print(f"{name}: left out, {why}", file=sys.stderr)
    return [name for name in names if name not in absent], cases


def _write(path: Path, what: Any) -> None:
    write_atomically(path, lambda temporary: temporary.write_text(json.dumps(what, indent=1), "utf-8"))


def _measured(parser: argparse.ArgumentParser, wanted: argparse.Namespace) -> dict[str, Any]:
    """Measure what is asked for."""
    names, cases = _chosen(parser, wanted.only or [""])
    kept: Path | None = wanted.peers
    rows: Rows = json.loads(kept.read_text("utf-8")) if kept is not None and kept.exists() else {}
    about = machine.describe()
    for package in ("bm3d", "bm4d"):
        try:
            about["versions"][package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            about["versions"][package] = "not installed"
    peers = [who for who in PEERS if any(part in who for part in wanted.filters or [""])]
    save = functools.partial(_write, kept, rows) if kept is not None else lambda: None
    run = Run(about["date"], wanted.seeds, peers, rows, save, wanted.time_again)
    found: dict[str, Any] = {"machine": about, "seeds": wanted.seeds, "rows": [], "real": []}
    for name in names:
        for sigma in wanted.sigma or SIGMAS:
            found["rows"].append(run.measure(name, sigma))
            if wanted.json is not None:
                _write(wanted.json, found)
    found["real"] = real.measure(cases, wanted.seeds, peers)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is asked for, or read it, and print the tables."""
    parser = _arguments()
    wanted = parser.parse_args(arguments)
    found = json.loads(wanted.earlier.read_text("utf-8")) if wanted.earlier else _measured(parser, wanted)
    if wanted.json is not None:
        _write(wanted.json, found)
    about = found["machine"]
    print(f"- {about['date']}, {about['cpu']}, {about['cores']} cores, {about['system']}")
    print(f"- {', '.join(f'{name} {version}' for name, version in about['versions'].items())}")
    print(f"- ours on {next(iter(about['devices'].values()), 'numpy')}; seeds: {found['seeds']}\n")
    if found["rows"]:
        print(report.markdown(found["rows"], about["date"]))
        print(f"\n{cost.table(found['rows'], about['date'])}")
        if wanted.plot is not None:
            cost.draw(found["rows"], about["date"], about, wanted.plot)
    if found["real"]:
        print(f"\n{real.markdown(found['real'])}")
    return 0
