"""``python -m bench.figures DIR [--quick]`` draws the figures into a folder, each with the numbers it shows as JSON."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gpureg.io import write_atomically

from . import figure_1, figure_2, figure_4, figure_5, figure_6, figure_7, figure_8, figure_9, solvers

# Each draws its figure, quickly and smaller or in full, on a backend, and gives the numbers back.
FIGURES: dict[str, Callable[[bool, str], tuple[Any, dict[str, Any]]]] = {
    "figure_1": figure_1.draw,
    "figure_2": figure_2.draw,
    "figure_4": figure_4.draw,
    "figure_5": figure_5.draw,
    "figure_6": figure_6.draw,
    "figure_7": figure_7.draw,
    "figure_8": figure_8.draw,
    "figure_9": figure_9.draw,
    "solvers": solvers.draw,
}


def main(arguments: list[str] | None = None) -> int:
    """Draw what is asked for; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m bench.figures", description=__doc__)
    parser.add_argument("folder", metavar="DIR", type=Path, help="where the pictures go; made where there is none")
    parser.add_argument("--quick", action="store_true", help="smaller pictures, a few seconds each")
    parser.add_argument("--only", action="append", choices=FIGURES, metavar="NAME", help="this figure; repeatable")
    parser.add_argument("--backend", default="auto", help="where to run (default: auto)")
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    for name in options.only or FIGURES:
        figure, numbers = FIGURES[name](options.quick, options.backend)
        text = json.dumps(numbers, indent=1) + "\n"
        write_atomically(options.folder / f"{name}.png", lambda path, drawn=figure: drawn.savefig(path))
        write_atomically(options.folder / f"{name}.json", lambda path, text=text: path.write_text(text, "utf-8"))
        print(options.folder / f"{name}.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
