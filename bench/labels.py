"""Accuracy of label propagation by p: ``GPUREG_DATA=... python bench/labels.py [--seeds N] [--only SUBSTRING] ...``.

Each row is a graph with weights, a number of labels a class and a norm. For each seed so many vertices of every class
are drawn, and the accuracy is the share of right labels among the other vertices of components with a label: no method
can know more. The column p = 2 is not an iteration: it is scipy's direct solution of the linear system, so that it
cannot suffer from being stopped early. "balanced" is the same scores with every class scaled to the share it has among
the known labels (class mass normalization; ``balance=True``), for p = 2 too.

The graphs, in the folder GPUREG_DATA/graphs:

- cora: citations, made undirected, weight 1; cora-words: the same with weights exp(-|x - y|^2) of the words of the two
  papers, x and y their binary vectors divided by their lengths. Seven classes of 180 to 818.
- minnesota: roads, weight 1. There are no labels: the class is the quadrant, cut at the medians of longitude and
  latitude, 518 to 803 vertices each. minnesota-distance: the same with weights 1/distance, longitude times cos 46
  degrees and the distance at least its first percentile (some vertices lie on one point). minnesota-halves: these
  weights and two classes, west and east of the median. (With 1/distance^2 weights differ by 4e5, and 5000 sweeps leave
  errors of 0.05.)
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
from scipy.sparse import csgraph, linalg

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


def settings(folder: Path) -> dict[str, tuple[Matrix, np.ndarray]]:
    """Name of a graph with its classes -> weight matrix, class of each vertex."""
    citations, words, topic = cora(folder)
    roads, near, quadrant = minnesota(folder)
    return {
        "cora": (citations, topic),
        "cora-words": (words, topic),
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


def exact(W: Matrix, labels: np.ndarray) -> np.ndarray:
    """Scores of p = 2 by a direct solution (n, classes)."""
    known, unknown = np.flatnonzero(labels >= 0), np.flatnonzero(judged(W, labels))
    scores = np.zeros((len(labels), labels.max() + 1))
    scores[known, labels[known]] = 1
    L = sparse.csr_array(sparse.diags_array(np.asarray(W.sum(axis=1)).ravel()) - W)[unknown]
    solve = linalg.splu(sparse.csc_matrix(L[:, unknown])).solve
    scores[unknown] = solve(-np.asarray(L[:, known] @ scores[known]))
    return scores


def accuracies(scores: np.ndarray, labels: np.ndarray, of: np.ndarray, classes: np.ndarray) -> tuple[float, float]:
    """Percent right by the largest score, and by the largest balanced score."""
    share = np.bincount(labels[labels >= 0]) / (labels >= 0).sum()
    balanced = scores[of] * share / scores[of].mean(axis=0)
    return tuple(100 * float((s.argmax(axis=1) == classes[of]).mean()) for s in (scores[of], balanced))


def measure(
    W: Matrix, classes: np.ndarray, a_class: int, ps: list[float], seeds: int, norm: str, **call: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Accuracies (seeds, 1 + len(ps), 2), first that of p = 2, and seconds per call, (len(ps),)."""
    graph = gr.Graph.from_scipy(W)
    found, seconds = [], np.zeros(len(ps))
    for seed in range(seeds):
        labels = draw(classes, a_class, seed)
        of = judged(W, labels)
        row = [accuracies(exact(W, labels), labels, of, classes)]
        for k, p in enumerate(ps):
            begin = time.perf_counter()
            _, scores = gr.propagate_labels(labels, graph, p=p, norm=norm, return_scores=True, **call)
            seconds[k] += (time.perf_counter() - begin) / seeds
            row.append(accuracies(scores, labels, of, classes))
        found.append(row)
    return np.array(found), seconds


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Accuracy of label propagation by p, on Cora and the Minnesota roads.")
    parser.add_argument("--quick", action="store_true", help="three seeds, p = 3 alone: does everything run?")
    parser.add_argument("--seeds", metavar="N", type=int, help="draws of the labels (default 20, with --quick 3)")
    parser.add_argument("--only", metavar="SUBSTRING", default="", help="only graphs whose name contains it")
    parser.add_argument("--labels", metavar="N", type=int, nargs="+", default=[5, 20], help="labels a class")
    parser.add_argument("--p", metavar="P", type=float, nargs="+", default=[2.5, 3, 4, 6, 10], help="degrees beside 2")
    parser.add_argument("--norm", nargs="+", default=["vertex", "edge"], help="vertex, edge")
    parser.add_argument("--tol", type=float, default=1e-5, help="as in propagate_labels, whose default is finer")
    parser.add_argument("--backend", default="auto")
    options = parser.parse_args()
    folder = os.environ.get("GPUREG_DATA")
    if not folder:
        parser.error("GPUREG_DATA must name the folder of test data, which has graphs/cora.npz")
    seeds, ps = options.seeds or (3 if options.quick else 20), [3.0] if options.quick else options.p
    columns = " | ".join(f"p={p:g}" for p in ps)
    print(f"| graph | labels a class | norm | scores | p=2 | {columns} | best - p=2 | s a call |")
    print("|---|---:|---|---|" + "---:|" * (len(ps) + 3), flush=True)
    for name, (W, classes) in settings(Path(folder)).items():
        if options.only not in name:
            continue
        for a_class in options.labels:
            for norm in options.norm:
                found, seconds = measure(W, classes, a_class, ps, seeds, norm, backend=options.backend, tol=options.tol)
                for rule, which in enumerate(("largest", "balanced")):
                    mean = found[:, :, rule].mean(axis=0)
                    best = 1 + int(mean[1:].argmax())
                    gain = found[:, best, rule] - found[:, 0, rule]
                    error = gain.std(ddof=1) / np.sqrt(len(gain)) if len(gain) > 1 else np.nan
                    cells = " | ".join(f"{value:.2f}" for value in mean)
                    speed = " ".join(f"{s:.1f}" for s in seconds)
                    print(
                        f"| {name} | {a_class} | {norm} | {which} | {cells} "
                        f"| {gain.mean():+.2f} +- {error:.2f} (p={ps[best - 1]:g}) | {speed} |",
                        flush=True,
                    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
