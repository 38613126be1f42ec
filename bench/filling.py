"""``python -m bench.filling [--quick] [--json FILE]``: minimisers with a certificate, their seconds beside peers'.

Labels on a graph of nearest neighbours and a hole in a picture, where lam is 0 at most vertices; small lam with
weights; total variation. Markdown on stdout. Peers have one thread if OMP_NUM_THREADS and OPENBLAS_NUM_THREADS are 1.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import gpureg as gr

from . import machine
from .model import SEED, Image, Setup, data, peer
from .solvers import KAPPA, chambolle_steps

T = TypeVar("T")
PYAMG, CHAMBOLLE = "pyamg's best", "scikit-image Chambolle"
# steps of conjugate gradients that a peer may take
_STEPS = 2000


@dataclass
class Work:
    """Something to minimise to a gap, and a bar: seconds, or a ratio to a peer's seconds.

    Parameters
    ----------
    name : str
    graph : Graph or GridGraph
    f0 : array
    lam : float or array
    share : float
        Gap that is asked for, of the energy.
    at_most : float
    p : float
    dtype : type
    peer : callable or None
        From the least energy and the energy that is near enough, the seconds of a peer, and what it did; or why not.
    who : str
        The peer.
    """

    name: str
    graph: Any
    f0: Image
    lam: Any
    share: float
    at_most: float
    p: float = 2.0
    dtype: Any = np.float64
    peer: Callable[[Work, int], tuple[float | None, str]] | None = None
    who: str = ""

    def solve(self, share: float | None = None, dtype: Any = None, device: str = "auto") -> gr.Result:
        """The minimiser. A stored graph is made anew, so that nothing kept with an earlier one is of use."""
        graph = self.graph
        if isinstance(graph, gr.Graph):
            graph = gr.Graph(graph.indptr, graph.indices, graph.weights)
        solver = gr.Certified(tol=share or self.share)
        return gr.regularize(
            self.f0, graph, p=self.p, lam=self.lam, solver=solver, dtype=dtype or self.dtype, backend=device
        )


def least(call: Callable[[], T], repeats: int) -> tuple[float, T]:
    """Least seconds of some runs, and what the last one gave."""
    best = np.inf
    for _ in range(repeats):
        begin = time.perf_counter()
        found = call()
        best = min(best, time.perf_counter() - begin)
    return best, found


def _laplacian(graph: Any) -> Any:
    """The matrix of the energy of p = 2 without lam, 2 (D - W)."""
    from scipy import sparse

    W = graph.to_scipy().astype(np.float64)
    return (2 * (sparse.diags_array(np.asarray(W.sum(axis=1)).ravel()) - W)).tocsr()


def multigrid(work: Work, repeats: int) -> tuple[float | None, str]:
    """Seconds of conjugate gradients by pyamg: the better of its two kinds, setup included, on the free vertices.

    It knows of no gap: of tolerances 1e-2, 1e-3, ... of the residual it gets the first after which the energy is
    within the share of its minimum.
    """
    pyamg = peer("pyamg")
    if pyamg is None:
        return None, "pyamg is not installed"
    from scipy import sparse

    f0 = work.f0.reshape(work.graph.n_vertices, -1).astype(np.float64)
    lam = np.broadcast_to(np.asarray(work.lam, np.float64), len(f0))
    free, fixed = np.flatnonzero(np.isfinite(lam)), np.flatnonzero(np.isinf(lam))
    L = _laplacian(work.graph)
    A = sparse.csr_matrix(L[free][:, free] + sparse.diags_array(lam[free]))
    b = lam[free, None] * f0[free] - L[free][:, fixed] @ f0[fixed]
    exact = work.solve(1e-3 * work.share, np.float64)
    energy = float(exact.energy[-1])
    minimiser = exact.value.reshape(f0.shape)[free]

    def solved(levels: Any, tol: float) -> Image:
        columns = [levels.solve(b[:, c], tol=tol, accel="cg", maxiter=_STEPS) for c in range(b.shape[1])]
        return np.stack(columns, axis=1)

    found: list[tuple[float, str]] = []
    for kind, build in (("RS", pyamg.ruge_stuben_solver), ("SA", pyamg.smoothed_aggregation_solver)):
        levels = build(A)
        for tol in 10.0 ** -np.arange(2, 13):
            off = solved(levels, tol) - minimiser
            excess = float((off * (A @ off)).sum()) / 2
            if excess <= work.share * energy:
                seconds, _ = least(lambda build=build, tol=tol: solved(build(A), tol), repeats)
                found.append((seconds, f"{kind}, residual {tol:.0e}, excess {excess / energy:.1e}"))
                break
    return min(found) if found else (None, "pyamg came not so near")


def chambolle(work: Work, repeats: int) -> tuple[float | None, str]:
    """Seconds of Chambolle's projection until the excess of its functional is the share."""
    restoration = peer("skimage.restoration")
    if restoration is None:
        return None, "scikit-image is not installed"
    run, weight = restoration.denoise_tv_chambolle, KAPPA / work.lam
    steps = chambolle_steps(run, work.f0, weight, work.share, 5000 if work.f0.size > 100_000 else 500)
    seconds, _ = least(lambda: run(work.f0, weight=weight, eps=0, max_num_iter=steps), repeats)
    return seconds, f"{steps} iterations"


def _moons(n: int) -> Image:
    """Points of two half circles, with noise."""
    rng = np.random.default_rng(SEED)
    t = np.pi * rng.random(n)
    upper = np.arange(n) % 2 == 0
    x = np.where(upper, np.cos(t), 1 - np.cos(t))
    y = np.where(upper, np.sin(t), 0.5 - np.sin(t))
    moons: Image = np.stack([x, y], axis=1) + 0.1 * rng.standard_normal((n, 2))
    return moons


def labels(quick: bool) -> Iterator[Work]:
    """Twenty labels on a graph of nearest neighbours: lam is infinite at them, 0 elsewhere; a channel per label."""
    n, count = (400, 4) if quick else (20_000, 20)
    graph = gr.knn_graph(_moons(n), 10)
    chosen = np.random.default_rng(SEED).choice(n, count, replace=False)
    lam, f0 = np.zeros(n), np.zeros((n, count))
    lam[chosen] = np.inf
    f0[chosen, np.arange(count)] = 1
    for p, at_most in ((2.0, 1.0), (1.5, 3.0), (3.0, 2.0)):
        beside = multigrid if p == 2 else None
        who = PYAMG if p == 2 else ""
        yield Work(f"labels, {n} vertices, {count} labels", graph, f0, lam, 1e-4, at_most, p, peer=beside, who=who)


def hole(setup: Setup, quick: bool) -> Iterator[Work]:
    """A picture without its middle."""
    side = 32 if quick else 512
    clean, name = setup.picture(side)
    lam = np.full(clean.shape, np.inf)
    middle = slice(side // 4, side // 4 + side // 2)
    lam[middle, middle] = 0
    grid = gr.GridGraph(clean.shape, metric="cityblock")
    f0 = np.where(lam > 0, clean / 255, 0)
    yield Work(f"{name} {side}x{side}, hole {side // 2}x{side // 2}", grid, f0, lam, 1e-3, 4.0, 1.0, np.float32)


def weighted(setup: Setup, quick: bool) -> Iterator[Work]:
    """Small lam at p = 2 with weights that differ by orders of magnitude, and a road network."""
    for side in (32,) if quick else (512, 1024):
        clean, name = setup.picture(side)
        noisy = clean / 255.0 + 0.05 * np.random.default_rng(SEED).standard_normal(clean.shape)
        plain = gr.GridGraph(clean.shape, metric="cityblock").to_graph()
        step = noisy.ravel()[plain.edge_rows()] - noisy.ravel()[plain.indices]
        graph = gr.Graph(plain.indptr, plain.indices, np.exp(-((step / 0.1) ** 2)))
        about = f"{name} {side}x{side}, bilateral weights"
        yield Work(about, graph, noisy.ravel(), 1e-3, 1e-8, 0.7, peer=multigrid, who=PYAMG)
    bunny, streets = data("meshes", "stanford_bunny.ply"), data("graphs", "luxembourg_osm.mtx.gz")
    trimesh = peer("trimesh")
    if bunny is not None and trimesh is not None and not quick:
        mesh = trimesh.load(bunny, process=False)
        x = np.asarray(mesh.vertices) / float(mesh.edges_unique_length.mean())
        edges = mesh.edges_unique
        graph = gr.Graph.from_edges(edges, 1 / ((x[edges[:, 0]] - x[edges[:, 1]]) ** 2).sum(axis=1), n_vertices=len(x))
        z = x[:, 2] + 0.2 * np.random.default_rng(SEED).standard_normal(len(x))
        yield Work("bunny, weights 1/d^2", graph, z, 1e-3, 1e-8, 0.7, peer=multigrid, who=PYAMG)
    if streets is not None and not quick:
        graph = gr.read_graph(streets)
        noise = np.random.default_rng(SEED).standard_normal(graph.n_vertices)
        yield Work("Luxembourg, noise", graph, noise, 1e-3, 1e-8, 0.7, peer=multigrid, who=PYAMG)


def total_variation(setup: Setup, quick: bool) -> Iterator[Work]:
    """Total variation of a noisy picture beside Chambolle's projection."""
    side = 32 if quick else 512
    _, noisy, name = setup.noisy(side)
    grid = gr.GridGraph(noisy.shape, metric="cityblock")
    work = f"{name} {side}x{side}, noisy"
    yield Work(work, grid, noisy / 255, 28.0, 1e-4, 0.1, 1.0, np.float32, chambolle, CHAMBOLLE)


TABLES: dict[str, Callable[[Setup, bool], Iterator[Work]]] = {
    "labels": lambda _, quick: labels(quick),
    "hole": hole,
    "weighted": weighted,
    "total variation": total_variation,
}
HEAD = ("work", "p", "gap", "method", "iterations", "seconds", "peer", "its seconds", "ratio", "bar")


def measured(work: Work, repeats: int, device: str) -> dict[str, Any]:
    """A row: our seconds and the peer's, in one run."""
    work.solve(device=device)  # kernels are built
    seconds, result = least(lambda: work.solve(device=device), repeats)
    assert result.gap is not None
    theirs, said = work.peer(work, repeats) if work.peer is not None else (None, "")
    against = seconds if work.peer is None else None if theirs is None else seconds / theirs
    return {
        "work": work.name,
        "p": work.p,
        "share": work.share,
        "gap": result.gap / float(result.energy[-1]),
        "method": result.method,
        "iterations": result.iterations,
        "seconds": seconds,
        "who": work.who,
        "peer": theirs,
        "note": said,
        "ratio": None if work.peer is None else against,
        "at most": work.at_most,
        "met": None if against is None else against <= work.at_most,
    }


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """A row of the table, as text."""
    verdict = {True: "met", False: "MISSED", None: "not judged"}[row["met"]]
    unit = " s" if not row["who"] else ""
    return (
        row["work"],
        f"{row['p']:g}",
        f"{row['gap']:.1e}" + ("" if row["gap"] <= row["share"] else f" NOT {row['share']:.0e}"),
        row["method"],
        str(row["iterations"]),
        f"{row['seconds']:.2f}",
        f"{row['who']}: {row['note']}" if row["who"] else "-",
        "-" if row["peer"] is None else f"{row['peer']:.2f}",
        "-" if row["ratio"] is None else f"{row['ratio']:.2f}",
        f"{row['at most']:g}{unit}, {verdict}",
    )


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 if a gap was not reached."""
    parser = argparse.ArgumentParser(prog="python -m bench.filling", description=__doc__)
    parser.add_argument("--only", default="", choices=["", *TABLES], metavar="TABLE", help=", ".join(TABLES))
    parser.add_argument("--device", default="auto", help="such as opencl:0")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="small sizes: does everything run?")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write everything measured to this file")
    options = parser.parse_args(arguments)
    if options.json is not None and not options.json.resolve().parent.is_dir():
        parser.error(f"--json: the folder of {options.json} does not exist")
    about, rows = machine.describe(), []
    print(f"{about['date']}, {about['cpu']}, {about['cores']} cores, load {about['load_before']} before the run\n")
    print(f"| {' | '.join(HEAD)} |\n|{'|'.join('---' for _ in HEAD)}|")
    setup = Setup("quick" if options.quick else "full", [])
    for name, table in TABLES.items():
        if options.only in ("", name):
            for work in table(setup, options.quick):
                with warnings.catch_warnings():
                    # what was not reached is in the table
                    warnings.simplefilter("ignore", RuntimeWarning)
                    rows.append(measured(work, 1 if options.quick else options.repeat, options.device))
                print(f"| {' | '.join(cells(rows[-1]))} |", flush=True)
    missed = sum(not row["gap"] <= row["share"] for row in rows)
    print(f"\n{missed} of {len(rows)} gaps not reached")
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": about, "rows": rows}, indent=1) + "\n", "utf-8")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
