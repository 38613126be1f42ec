"""How far above the minimum each solver is after how long: p = 1, 1.5, 2, 3.

``python -m bench.courses DIR [--quick]`` draws ``solvers.png`` into a folder, with the numbers as JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from skimage import data

import gpureg as gr
from gpureg.files.pictures import write_files

# p and the fidelity at which the noise of sigma 0.1 is taken away
DEGREES = ((1.0, 14.0), (1.5, 4.0), (2.0, 0.01), (3.0, 0.01))
SIDES = {True: 96, False: 256}
MOST = {True: 200, False: 6000}
# seconds after which a solver is told to stop
LIMIT = {True: 0.5, False: 6.0}
# of the range; Jacobi and Newton need it for p < 2, and all solvers get it, so that all have the same energy
EPS = 1e-3

SOLVERS: dict[str, tuple[Any, str]] = {
    "Jacobi (the paper)": (gr.Jacobi(), "tab:gray"),
    "Jacobi, accelerated": (gr.Jacobi(accelerate=True), "tab:olive"),
    "Euler": (gr.Euler(), "tab:brown"),
    "certified, dual": (gr.Certified(tol=1e-9, method="dual"), "tab:blue"),
    "certified, linear": (gr.Certified(tol=1e-12, method="linear"), "tab:green"),
    "certified, newton": (gr.Certified(tol=1e-12, method="newton"), "tab:red"),
}


def noisy(side: int) -> Any:
    """A part of camera with values in [0, 1], noise of sigma 0.1 on it."""
    clean = data.camera()[60 : 60 + side, 120 : 120 + side] / 255.0
    return clean + 0.1 * np.random.default_rng(0).standard_normal(clean.shape)


def course(f0: Any, p: float, lam: float, solver: Any, quick: bool, backend: str) -> dict[str, Any] | None:
    """Seconds, energies and gaps at each check; None where the solver is not made for this p."""
    if isinstance(solver, gr.Certified) and (solver.method == "linear") != (p == 2) and solver.method != "newton":
        return None
    # the 8-neighbour graph: at p = 2 cosines do not solve its system in one step
    graph = gr.GridGraph(f0.shape)
    eps = None if p == 2 else EPS
    settings = {"p": p, "lam": lam, "eps": eps, "backend": backend, "dtype": np.float64, "max_iter": MOST[quick]}
    # kernels are compiled, and binaries loaded, before the time is taken
    gr.regularize(f0, graph, solver=solver, **{**settings, "max_iter": 12})
    seen: dict[str, Any] = {"seconds": [], "energy": [], "gap": []}
    begin = time.perf_counter()

    def note(check: gr.Check) -> bool:
        seen["seconds"].append(time.perf_counter() - begin)
        seen["energy"].append(check.energy)
        seen["gap"].append(check.gap)
        return seen["seconds"][-1] > LIMIT[quick]

    gr.regularize(f0, graph, solver=solver, callback=note, **settings)
    return seen


def draw(quick: bool, backend: str) -> tuple[Any, dict[str, Any]]:
    """The figure and its numbers."""
    from matplotlib.figure import Figure

    f0, numbers = noisy(SIDES[quick]), {}
    figure = Figure(figsize=(10, 7.5), dpi=100, layout="constrained")
    for axes, (p, lam) in zip(figure.subplots(2, 2).flat, DEGREES, strict=True):
        found = {name: course(f0, p, lam, solver, quick, backend) for name, (solver, _) in SOLVERS.items()}
        courses = {name: seen for name, seen in found.items() if seen is not None}
        least = min(min(seen["energy"]) for seen in courses.values())
        for name, seen in courses.items():
            colour = SOLVERS[name][1]
            excess = np.maximum((np.array(seen["energy"]) - least) / least, 1e-14)
            axes.loglog(seen["seconds"], excess, color=colour, label=name)
            if seen["gap"][0] is not None:
                gap = np.array(seen["gap"], float) / np.array(seen["energy"])
                axes.loglog(seen["seconds"], gap, "--", color=colour, linewidth=1)
        axes.set(
            ylim=(1e-11, 10), title=f"p = {p:g}, λ = {lam:g}", xlabel="seconds", ylabel="above the minimum, relative"
        )
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="lower left")
        numbers[f"p = {p:g}"] = {"lam": lam, "least": least, "courses": courses}
    figure.suptitle(
        f"Energy above the minimum (lines) and certified gap (dashed); {SIDES[quick]} x {SIDES[quick]}, 8 neighbours, "
        f"float64, {backend}",
        fontsize=11,
    )
    return figure, numbers


def main(arguments: list[str] | None = None) -> int:
    """Draw; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m bench.courses", description=__doc__)
    parser.add_argument("folder", metavar="DIR", type=Path, help="where the picture goes; made where there is none")
    parser.add_argument("--quick", action="store_true", help="a smaller picture, half a second for each solver")
    parser.add_argument("--backend", default="auto", help="where to run (default: auto)")
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    figure, numbers = draw(options.quick, options.backend)
    path = options.folder / "solvers.png"
    text = json.dumps(numbers, indent=1) + "\n"
    write_files({path: figure.savefig, path.with_suffix(".json"): lambda there: there.write_text(text, "utf-8")})
    print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
