"""Accuracy of label propagation: ``GPUREG_DATA=... python bench/labels.py [--seeds N] [--only SUBSTRING] ...``.

Each row is a graph and a number of labels a class. For each seed so many vertices of every class are drawn, and the
accuracy is the share of right labels among the other vertices of components with a label: no method can know more. The
columns are p with ``reweighting="none"``, and "wnll" for p = 2 with the default reweighting; all are minimisers with a
duality gap (`--tol`), so that none suffers from being stopped early. "balanced" is the same scores with every class
scaled to the share it has among the known labels (class mass normalization; ``balance=True``). Labels drawn in equal
numbers have the shares of the classes only where the classes are equal.

The graphs, in the folder GPUREG_DATA/graphs:

- cora: citations, made undirected, weight 1; cora-words: the same with weights exp(-|x - y|^2) of the words of the two
  papers, x and y their binary vectors divided by their lengths. Seven classes of 180 to 818.
- minnesota: roads, weight 1. There are no labels: the class is the quadrant, cut at the medians of longitude and
  latitude, 518 to 803 vertices each. minnesota-distance: the same with weights 1/distance, longitude times cos 46
  degrees and the distance at least its first percentile (some vertices lie on one point). minnesota-halves: these
  weights and two classes, west and east of the median.
- digits: the 10 nearest neighbours of 1797 images of 8 x 8 pixels, weight 1, ten classes of about 180; moons100: those
  of 2000 points in 100 dimensions, two classes of 1000 (in the folder GPUREG_DATA/points).
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io, sparse
from scipy.sparse import csgraph

import gpureg as gr

Matrix = Any


def _undirected(matrix: Matrix) -> Matrix:
    A = sparse.csr_array(matrix).astype(float)
    A = sparse.csr_array(A.maximum(A.T))
    A.setdiag(0)
    A.eliminate_zeros()
    A.data[:] = 1
    return A


def cora(folder: Path) -> tuple[Matrix, Matrix, np.ndarray]:
    """Citations and their weights from words, as matrices, and the classes."""
    z = np.load(folder / "graphs" / "cora.npz", allow_pickle=True)
    adjacency, words = (
        sparse.csr_array((z[f"{k}_data"], z[f"{k}_indices"], z[f"{k}_indptr"]), shape=z[f"{k}_shape"])
        for k in ("adj", "attr")
    )
    A = _undirected(adjacency)
    x = words.toarray().astype(float)
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)
    rows, columns = A.nonzero()
    values = np.exp(-((x[rows] - x[columns]) ** 2).sum(axis=1))
    return A, sparse.csr_array((values, (rows, columns)), shape=A.shape), np.asarray(z["labels"])


def minnesota(folder: Path) -> tuple[Matrix, Matrix, np.ndarray]:
    """Roads with weight 1 and 1/distance, as matrices, and the quadrants: bit 0 east, bit 1 north."""
    A = _undirected(io.mmread(folder / "graphs" / "minnesota_road.mtx"))
    xy = np.genfromtxt(folder / "graphs" / "minnesota_xy.csv", delimiter=",")
    xy = xy[np.isfinite(xy).all(axis=1)]  # without a header, if there is one
    rows, columns = A.nonzero()
    distance = np.linalg.norm((xy[rows] - xy[columns]) * [np.cos(np.radians(46)), 1], axis=1)
    distance = np.maximum(distance, np.percentile(distance, 1)) / np.median(distance)
    quadrant = (xy > np.median(xy, axis=0)) @ [1, 2]
    return A, sparse.csr_array((1 / distance, (rows, columns)), shape=A.shape), quadrant


def neighbours(points: np.ndarray) -> Matrix:
    """The 10 nearest neighbours of points, weight 1, as a matrix."""
    return _undirected(gr.knn_graph(points, 10).to_scipy())


def settings(folder: Path) -> dict[str, tuple[Matrix, np.ndarray]]:
    """Name of a graph with its classes -> weight matrix, class of each vertex."""
    citations, words, topic = cora(folder)
    roads, near, quadrant = minnesota(folder)
    digits = np.loadtxt(folder / "points" / "digits.csv.gz", delimiter=",")
    moons = np.load(folder / "points" / "two_moons_100d.npz")
    return {
        "cora": (citations, topic),
        "cora-words": (words, topic),
        "digits": (neighbours(digits[:, :-1]), digits[:, -1].astype(int)),
        "moons100": (neighbours(moons["features"]), moons["labels"].astype(int)),
        "minnesota": (roads, quadrant),
        "minnesota-distance": (near, quadrant),
        "minnesota-halves": (near, quadrant % 2),
    }


def draw(classes: np.ndarray, a_class: int, seed: int) -> np.ndarray:
    """Labels of `a_class` random vertices of every class, -1 elsewhere."""
    rng = np.random.default_rng(seed)
    labels = np.full(len(classes), -1)
    for c in np.unique(classes):
        chosen = rng.choice(np.flatnonzero(classes == c), a_class, replace=False)
        labels[chosen] = c
    return labels


def judged(W: Matrix, labels: np.ndarray) -> np.ndarray:
    """Vertices the accuracy is of: unknown, in a component with a label."""
    count, component = csgraph.connected_components(W, directed=False)
    told = np.zeros(count, bool)
    told[component[labels >= 0]] = True
    return told[component] & (labels < 0)


def accuracies(scores: np.ndarray, labels: np.ndarray, of: np.ndarray, classes: np.ndarray) -> tuple[float, float]:
    """Percent right by the largest score, and by the largest balanced score."""
    share = np.bincount(labels[labels >= 0]) / (labels >= 0).sum()
    balanced = scores[of] * share / scores[of].mean(axis=0)
    return tuple(100 * float((s.argmax(axis=1) == classes[of]).mean()) for s in (scores[of], balanced))


def measure(
    W: Matrix, classes: np.ndarray, a_class: int, methods: list[dict[str, Any]], seeds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Accuracies (seeds, methods, 2), and seconds per call, (methods,)."""
    graph = gr.Graph.from_scipy(W)
    found, seconds = [], np.zeros(len(methods))
    for seed in range(seeds):
        labels = draw(classes, a_class, seed)
        of = judged(W, labels)
        row = []
        for k, method in enumerate(methods):
            begin = time.perf_counter()
            _, scores = gr.propagate_labels(labels, graph, return_scores=True, **method)
            seconds[k] += (time.perf_counter() - begin) / seeds
            row.append(accuracies(scores, labels, of, classes))
        found.append(row)
    return np.array(found), seconds


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Accuracy of label propagation by p, on graphs of several kinds.")
    parser.add_argument("--quick", action="store_true", help="three seeds, p = 2 alone: does everything run?")
    parser.add_argument("--seeds", metavar="N", type=int, help="draws of the labels (default 20, with --quick 3)")
    parser.add_argument("--only", metavar="SUBSTRING", default="", help="only graphs whose name contains it")
    parser.add_argument("--labels", metavar="N", type=int, nargs="+", default=[1, 5, 20], help="labels a class")
    parser.add_argument("--p", metavar="P", type=float, nargs="*", default=[1, 1.5, 3, 6, np.inf], help="besides 2")
    parser.add_argument("--norm", default="edge", help="vertex or edge (p = 2 is the same)")
    parser.add_argument("--tol", type=float, help="as in propagate_labels")
    parser.add_argument("--backend", default="auto")
    options = parser.parse_args()
    folder = os.environ.get("GPUREG_DATA")
    if not folder:
        parser.error("GPUREG_DATA must name the folder of test data, which has graphs/cora.npz")
    seeds, ps = options.seeds or (3 if options.quick else 20), [] if options.quick else options.p
    shared = {"norm": options.norm, "tol": options.tol, "backend": options.backend}
    names = ["2", "wnll", *(f"{p:g}" for p in ps)]
    methods = [shared | {"reweighting": "none"}, shared, *(shared | {"p": p} for p in ps)]
    print(f"| graph | labels a class | scores | {' | '.join(names)} | wnll - best other | s a call |")
    print("|---|---:|---|" + "---:|" * (len(names) + 2), flush=True)
    for name, (W, classes) in settings(Path(folder)).items():
        if options.only not in name:
            continue
        for a_class in options.labels:
            found, seconds = measure(W, classes, a_class, methods, seeds)
            for rule, which in enumerate(("largest", "balanced")):
                mean = found[:, :, rule].mean(axis=0)
                others = np.delete(np.arange(len(names)), 1)
                best = int(others[mean[others].argmax()])
                gain = found[:, 1, rule] - found[:, best, rule]
                error = gain.std(ddof=1) / np.sqrt(len(gain)) if len(gain) > 1 else np.nan
                cells = " | ".join(f"{value:.1f}" for value in mean)
                speed = " ".join(f"{s:.2f}" for s in seconds)
                print(
                    f"| {name} | {a_class} | {which} | {cells} | {gain.mean():+.1f} +- {error:.1f} ({names[best]}) "
                    f"| {speed} |",
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    sys.exit(main())
