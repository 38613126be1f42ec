"""``python -m bench.certified [--quick]``: gaps that the certified solver reaches, as a table.

p from 1 to 6, both norms, a noisy picture on G_0, a bunny's positions, Luxembourg's streets; in float64 to 1e-5 of the
energy, in float32 to 1e-4, on every backend.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

import gpureg as gr
from gpureg import backends

from .model import SEED, data, peer

DEGREES = (1.0, 1.2, 1.5, 2.0, 3.0, 6.0)
TYPES = ((np.float64, 1e-5), (np.float32, 1e-4))


def problems() -> Iterator[tuple[str, Any, Any, tuple[float, ...]]]:
    """Name, graph, noisy data, and lam for each p: about where the noise is taken away."""
    rng = np.random.default_rng(SEED)
    camera = peer("skimage.data").camera()[200:328, 180:308] / 255.0
    noisy = camera + 0.1 * rng.standard_normal(camera.shape)
    yield "camera 128x128, noise 0.1", gr.GridGraph(camera.shape, metric="cityblock"), noisy, (14, 8, 4, 1, 0.3, 0.01)
    bunny, streets, trimesh = (
        data("meshes", "stanford_bunny.ply"),
        data("graphs", "luxembourg_osm.mtx.gz"),
        peer("trimesh"),
    )
    if bunny is not None and trimesh is not None:
        mesh = trimesh.load(bunny, process=False)
        positions = np.asarray(mesh.vertices) / float(mesh.edges_unique_length.mean())
        graph = gr.Graph.from_edges(mesh.edges_unique, n_vertices=len(positions))
        yield (
            "bunny, noise 0.2 edges",
            graph,
            positions + 0.2 * rng.standard_normal(positions.shape),
            (8, 4, 3, 2, 1, 0.5),
        )
    if streets is not None:
        graph = gr.read_graph(streets)
        smooth = gr.regularize(
            rng.standard_normal(graph.n_vertices), graph, p=2, lam=0.02, solver="certified", dtype=np.float64
        ).value
        smooth = smooth / smooth.std()
        noisy = smooth + 0.3 * rng.standard_normal(len(smooth))
        yield "Luxembourg, noise 0.3 of the signal", graph, noisy, (3, 3, 2, 1, 1, 1)


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 if a gap was not reached."""
    parser = argparse.ArgumentParser(prog="python -m bench.certified", description=__doc__)
    parser.add_argument("--devices", nargs="*", default=None, help="devices, such as opencl:0 (default: one a backend)")
    options = parser.parse_args(arguments)
    first = {device.backend: device.id for device in reversed(backends.devices())}
    devices = options.devices or list(first.values())
    missed = 0
    print(
        f"{'data':<36}{'norm':<8}{'p':<5}{'device':<10}{'type':<9}{'iterations':>10}{'gap/energy':>12}{'s':>8}  method"
    )
    for name, graph, f0, lams in problems():
        for norm in ("vertex", "edge"):
            for p, lam in zip(DEGREES, lams, strict=True):
                for device in devices:
                    for dtype, tol in TYPES:
                        solver = gr.Certified(tol=tol)
                        result = gr.regularize(
                            f0, graph, p=p, lam=lam, norm=norm, solver=solver, backend=device, dtype=dtype
                        )
                        reached = result.gap / result.energy[-1]
                        missed += reached > tol
                        kind = np.dtype(dtype).name
                        print(
                            f"{name:<36}{norm:<8}{p:<5g}{device:<10}{kind:<9}{result.iterations:>10}{reached:>12.1e}"
                            f"{result.seconds:>8.2f}  {result.method[:40]}",
                            flush=True,
                        )
    print(f"{missed} not reached")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
