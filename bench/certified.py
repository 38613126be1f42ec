"""``python -m bench.certified [--quick] [--json FILE]``: gaps that the certified solver reaches, as a table.

p from 1 to 6, both norms, a noisy picture on G_0, a bunny's positions, Luxembourg's streets; in float64 to 1e-5 of the
energy, in float32 to 1e-4, on every backend.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import gpureg as gr
from gpureg import backends

from . import machine
from .model import SEED, Image, data, peer

DEGREES = (1.0, 1.2, 1.5, 2.0, 3.0, 6.0)
TYPES = ((np.float64, 1e-5), (np.float32, 1e-4))


@dataclass(frozen=True)
class Problem:
    """Data without noise, the noise, and by norm the fidelities of DEGREES at which as much as the noise is taken away.

    They are those of the discrepancy principle, :func:`gpureg.tuning.discrepancy`, to two digits.
    """

    name: str
    graph: Any
    clean: Image
    sigma: float
    lams: dict[str, tuple[float, ...]]

    def noisy(self) -> Image:
        """The data."""
        noise = np.random.default_rng(SEED).standard_normal(self.clean.shape)
        noisy: Image = self.clean + self.sigma * noise
        return noisy


def problems(quick: bool) -> Iterator[Problem]:
    """Those whose data are there; with `quick` the picture alone, smaller."""
    skimage = peer("skimage.data")
    if skimage is not None:
        side = 32 if quick else 128
        camera = skimage.camera()[200 : 200 + side, 180 : 180 + side] / 255.0
        grid = gr.GridGraph(camera.shape, metric="cityblock")
        lams = {"vertex": (13, 7.7, 3.5, 1.1, 0.11, 1.5e-4), "edge": (10, 5.2, 2.1, 0.55, 0.038, 1.3e-5)}
        yield Problem(f"camera {side}x{side}", grid, camera, 0.1, lams)
    bunny, streets, trimesh = (
        data("meshes", "stanford_bunny.ply"),
        data("graphs", "luxembourg_osm.mtx.gz"),
        peer("trimesh"),
    )
    if bunny is not None and trimesh is not None and not quick:
        mesh = trimesh.load(bunny, process=False)
        positions = np.asarray(mesh.vertices) / float(mesh.edges_unique_length.mean())
        graph = gr.Graph.from_edges(mesh.edges_unique, n_vertices=len(positions))
        lams = {"vertex": (1.5, 1.7, 2.2, 3.4, 8.4, 140), "edge": (1.5, 1.5, 1.6, 1.7, 2, 3.2)}
        yield Problem("bunny, in edge lengths", graph, positions, 0.2, lams)
    if streets is not None and not quick:
        graph = gr.read_graph(streets)
        noise = np.random.default_rng(SEED).standard_normal(graph.n_vertices)
        smooth = gr.regularize(noise, graph, p=2, lam=0.02, solver="certified", dtype=np.float64).value
        lams = {"vertex": (2.4, 1.7, 1, 0.44, 0.1, 1.3e-3), "edge": (1.3, 0.93, 0.54, 0.23, 0.037, 1.8e-4)}
        yield Problem("Luxembourg", graph, smooth / smooth.std(), 0.3, lams)


def solved(problem: Problem, norm: str, p: float, lam: float, device: str, dtype: Any, tol: float) -> dict[str, Any]:
    """One run: what it reached, and after how long."""
    noisy = problem.noisy()
    result = gr.regularize(
        noisy,
        problem.graph,
        p=p,
        lam=lam,
        norm=norm,
        solver=gr.Certified(tol=tol),
        backend=device,
        dtype=dtype,
    )
    assert result.gap is not None
    return {
        "data": problem.name,
        "sigma": problem.sigma,
        "norm": norm,
        "p": p,
        "lam": lam,
        "device": device,
        "type": np.dtype(dtype).name,
        "tol": tol,
        "iterations": result.iterations,
        "gap": result.gap / float(result.energy[-1]),
        "seconds": result.seconds,
        "moved": float(np.sqrt(np.mean((result.value - noisy) ** 2))) / problem.sigma,
        "error": float(np.sqrt(np.mean((result.value - problem.clean) ** 2))) / problem.sigma,
        "method": result.method,
    }


COLUMNS = (
    ("data", "<24", ""),
    ("sigma", ">6", "g"),
    ("norm", ">8", ""),
    ("p", ">5", "g"),
    ("lam", ">6", "g"),
    ("device", ">10", ""),
    ("type", ">9", ""),
    ("iterations", ">11", "d"),
    ("gap", ">9", ".1e"),
    ("seconds", ">9", ".2f"),
    ("moved", ">7", ".2f"),
    ("error", ">7", ".2f"),
)


def _line(row: dict[str, Any]) -> str:
    cells = [f"{format(row[name], kind):{width}}" for name, width, kind in COLUMNS]
    return f"{''.join(cells)}  {row['method']}"


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 if a gap was not reached."""
    parser = argparse.ArgumentParser(prog="python -m bench.certified", description=__doc__)
    parser.add_argument("--devices", nargs="*", default=None, help="devices, such as opencl:0 (default: one a backend)")
    parser.add_argument("--quick", action="store_true", help="a small picture alone: does everything run?")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write everything measured to this file")
    options = parser.parse_args(arguments)
    if options.json is not None and not options.json.resolve().parent.is_dir():
        parser.error(f"--json: the folder of {options.json} does not exist")
    first = {device.backend: device.id for device in reversed(backends.devices())}
    devices = options.devices or list(first.values())
    rows = []
    print("gap: of the energy; moved, error: root mean squares of f - f0 and of f - clean data, in sigmas of the noise")
    print("".join(f"{name:{width}}" for name, width, _ in COLUMNS) + "  method")
    for problem in problems(options.quick):
        for norm in ("vertex", "edge"):
            for p, lam in zip(DEGREES, problem.lams[norm], strict=True):
                for device in devices:
                    for dtype, tol in TYPES:
                        rows.append(solved(problem, norm, p, lam, device, dtype, tol))
                        print(_line(rows[-1]), flush=True)
    missed = sum(row["gap"] > row["tol"] for row in rows)
    print(f"{missed} of {len(rows)} not reached")
    if options.json is not None:
        report = {"machine": machine.describe(), "rows": rows}
        options.json.write_text(json.dumps(report, indent=1) + "\n", "utf-8")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
