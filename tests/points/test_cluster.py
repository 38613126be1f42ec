"""Clusters of points: pieces by p < 1, joined by their mean weights."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

import gpureg as gr
from gpureg.points.cluster import _joins, edge_weights
from gpureg.regularization import pieces

RNG = np.random.default_rng(3)
CENTRES = np.array([[0, 0], [9, 0], [0, 9], [9, 9]])
TRUTH = np.repeat(np.arange(4), (150, 100, 200, 50))
BLOBS = CENTRES[TRUTH] + RNG.normal(size=(500, 2))


def rand_index(a, b) -> float:
    """Hubert and Arabie's adjusted Rand index, by its definition on the table of pairs."""
    table = np.zeros((a.max() + 1, b.max() + 1))
    np.add.at(table, (a, b), 1)
    pairs = lambda x: (x * (x - 1) / 2).sum()  # noqa: E731
    both, one, two, all_ = pairs(table), pairs(table.sum(1)), pairs(table.sum(0)), pairs(np.array([len(a)]))
    expected = one * two / all_
    return float((both - expected) / ((one + two) / 2 - expected))


def test_rand_index():
    assert rand_index(TRUTH, (TRUTH + 1) % 4) == 1
    assert abs(rand_index(TRUTH, RNG.permutation(TRUTH))) < 0.02
    # scikit-learn's example: adjusted_rand_score([0, 0, 1, 1], [0, 0, 1, 2])
    assert rand_index(np.array([0, 0, 1, 1]), np.array([0, 0, 1, 2])) == pytest.approx(0.5714285714285714)


def test_blobs(device):
    """Apart by four deviations and more: found, and counted, on every device; the numbers go by first points."""
    labels = gr.cluster_points(BLOBS, backend=device)
    assert labels.dtype == np.int32 and labels.shape == (500,)
    assert rand_index(labels, TRUTH) == 1
    assert np.array_equal(labels, TRUTH)
    assert np.array_equal(gr.cluster_points(BLOBS, 4, backend=device), labels)
    assert np.array_equal(gr.cluster_points(BLOBS, backend=device), labels)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_as_many_clusters_as_are_asked_for(device, n):
    found = gr.cluster_points(BLOBS, n, backend=device)
    assert found.max() + 1 == n
    if n > 4:  # finer: each blob is a union
        assert all(len(np.unique(TRUTH[found == c])) == 1 for c in range(n))
    else:  # coarser: each is whole
        assert all(len(np.unique(found[TRUTH == c])) == 1 for c in range(4))


def test_it_moves_with_the_points():
    order = RNG.permutation(500)
    turn = np.array([[np.cos(1), -np.sin(1)], [np.sin(1), np.cos(1)]])
    rings = np.concatenate(
        [r * np.stack([np.cos(t), np.sin(t)], 1) for r, t in ((1, RNG.random(200) * 7), (3, RNG.random(300) * 7))]
    )
    found = gr.cluster_points(rings + RNG.normal(0, 0.05, rings.shape), 2)
    assert rand_index(found, np.repeat([0, 1], (200, 300))) == 1
    moved = 1e3 * BLOBS[order] @ turn + [5, 6]
    assert rand_index(gr.cluster_points(moved), TRUTH[order]) == 1


@pytest.mark.parametrize("cloud", [RNG.normal(size=(400, 2)), RNG.random((400, 3)), RNG.normal(size=(300, 20))])
def test_one_cluster_is_one(cloud):
    assert gr.cluster_points(cloud).max() == 0


def test_small_ones_are_joined():
    """Of what is far away a few are no cluster, unless the size allows it."""
    few = np.concatenate([BLOBS, [[500, 500], [501, 500]]])
    assert gr.cluster_points(few).max() + 1 == 4
    assert gr.cluster_points(few, min_size=1).max() + 1 >= 4
    far = np.concatenate([BLOBS, RNG.normal(500, 1, size=(30, 2))])
    assert gr.cluster_points(far).max() + 1 == 5
    # one number less than there are parts without an edge between: the nearest two are one
    apart = np.concatenate([RNG.normal(c, 0.1, (60, 1)) for c in (0, 10, 100)])
    two = gr.cluster_points(apart, 2)
    assert np.array_equal(np.bincount(two), [120, 60])


def test_outliers_do_not_count():
    """Pairs far away from three blobs are none of the three that are asked for; a min_size of 1 lets them be."""
    rng = np.random.default_rng(8)
    blobs = np.concatenate([RNG.normal(c, 1, (500, 2)) for c in ([0, 0], [20, 0], [0, 20])])
    pairs = np.concatenate([RNG.normal(c, 0.1, (2, 2)) for c in ([300, 300], [-300, 0], [0, -400])])
    truth = np.repeat(np.arange(3), 500)
    points = np.concatenate([blobs, pairs])
    found = gr.cluster_points(points, 3)
    assert found.max() + 1 == 3 and rand_index(found[:1500], truth) == 1
    # each pair goes where its nearest point is
    nearest = [int(truth[np.argmin(((blobs - x) ** 2).sum(axis=1))]) for x in pairs]
    assert found[1500:].tolist() == nearest
    assert gr.cluster_points(points, 3, min_size=500).max() + 1 == 3
    assert np.bincount(gr.cluster_points(points, 6, min_size=1)).min() == 2
    # more than there are blobs: halves of them, of at least 1 percent each
    halves = {n: np.bincount(gr.cluster_points(points, n)) for n in (4, 5, 8)}
    assert {n: sizes for n, sizes in halves.items() if len(sizes) != n or sizes.min() < 15} == {}
    # what no edge joins may be joined all the same
    assert gr.cluster_points(points, 1, min_size=600).max() == 0
    groups = np.concatenate([rng.normal(c, 0.01, (4, 2)) for c in 100 * rng.random((25, 2))])
    assert np.bincount(gr.cluster_points(groups, 3, k=3, min_size=20)).min() >= 20
    # as many as cannot be of that size: the size gives way
    assert gr.cluster_points(points, 150).max() + 1 == 150


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((1, 2)),
        np.zeros((2, 2)),
        np.zeros((30, 3)),
        np.arange(50.0)[:, None],
        np.concatenate([BLOBS[:150], BLOBS[:150]]),
        1e-30 * BLOBS,
        1e30 * BLOBS,
    ],
    ids=["one", "two", "all the same", "a line", "twice", "tiny", "huge"],
)
def test_degenerate_clouds(points):
    labels = gr.cluster_points(points)
    assert labels.shape == (len(points),) and labels.min() == 0
    assert labels.max() == (3 if len(points) == 500 else 0)


def test_weights():
    """A function, or numbers: the same; larger weights between two clusters join these first."""
    graph = gr.knn_graph(BLOBS, 10)
    given = gr.weights.gaussian(BLOBS, 3.0)
    values = edge_weights(given, graph, BLOBS)
    u, v = graph.edge_rows(), graph.indices
    assert np.allclose(values, np.exp(-((BLOBS[u] - BLOBS[v]) ** 2).sum(axis=1) / 9))
    assert np.array_equal(gr.cluster_points(BLOBS, 4, weights=given), gr.cluster_points(BLOBS, 4, weights=values))
    assert np.array_equal(edge_weights(gr.weights.constant(), graph, BLOBS), np.ones(graph.n_edges))


def test_joins_by_mean_weight():
    """On a small graph, against the greedy rule as a literal loop over all pairs of clusters."""
    W = np.triu(RNG.random((12, 12)) * (RNG.random((12, 12)) < 0.4), 1)
    a, b = np.nonzero(W)
    graph = gr.Graph.from_edges(np.stack([a, b], 1), W[a, b], n_vertices=12)
    sizes = RNG.integers(1, 5, 12).astype(float)
    joins = _joins(pieces.Pieces(np.arange(12, dtype=np.int32), np.zeros((12, 1)), sizes, graph))
    W = W + W.T
    clusters = [[i] for i in range(12)]
    means, pairs = [], []
    for _ in joins:
        mean, i, j = max(
            (W[np.ix_(A, B)].sum() / (sizes[A].sum() * sizes[B].sum()), i, j)
            for i, A in enumerate(clusters)
            for j, B in enumerate(clusters)
            if i < j
        )
        means.append(mean)
        pairs.append({min(clusters[i]), min(clusters[j])})
        clusters[i] += clusters.pop(j)
    assert [join.mean for join in joins] == pytest.approx(means, rel=1e-12)
    assert [{join.a, join.b} for join in joins] == pairs
    rest = [W[np.ix_(A, B)].sum() for i, A in enumerate(clusters) for B in clusters[:i]]
    assert not any(rest)


def test_pieces_are_contracted():
    """Weights between pieces are sums; values are means; sizes add; numbers go by first vertices."""
    path = gr.Graph.from_edges([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]], [1, 2, 3, 4, 5])
    start = pieces.whole(np.array([[1.0], [2.0], [4.0], [8.0]]), path)
    found = start.joined(np.array([1, 0, 1, 0]))
    assert found.labels.tolist() == [0, 1, 0, 1]
    assert found.sizes.tolist() == [2, 2]
    assert found.values.ravel().tolist() == [2.5, 5]
    assert found.graph.to_scipy().toarray().tolist() == [[0, 10], [10, 0]]
    assert pieces.met(np.array([[0.0], [0.1], [0.3], [0.35]]), path, 0.11).tolist() == [0, 0, 1, 1]


@pytest.mark.parametrize(
    ("settings", "error", "words"),
    [
        ({"n_clusters": 0}, ValueError, "n_clusters must lie in 1..500"),
        ({"n_clusters": 501}, ValueError, "n_clusters must lie in 1..500"),
        ({"n_clusters": 2.0}, TypeError, "n_clusters must be an integer"),
        ({"n_clusters": 499}, ValueError, "a larger lam leaves more"),
        ({"n_clusters": 5, "min_size": 120}, ValueError, "no 5 clusters of 120 points"),
        ({"n_clusters": 2, "min_size": 0}, ValueError, "min_size must lie in"),
        ({"min_size": 0}, ValueError, "min_size must lie in"),
        ({"lam": 0}, ValueError, "lam must be finite and > 0"),
        ({"lam": "auto"}, TypeError, "lam must be a number"),
        ({"p": -1}, ValueError, "p must"),
        ({"k": 0}, ValueError, "k must be >= 1"),
        ({"weights": "gaussian"}, TypeError, "weights must be an object"),
        ({"weights": np.ones(3)}, ValueError, "one per stored directed edge"),
    ],
)
def test_wrong_input(settings, error, words):
    with pytest.raises(error, match=words):
        gr.cluster_points(BLOBS, **settings)


def test_points_that_are_none():
    with pytest.raises(ValueError, match="finite"):
        gr.cluster_points(np.full((4, 2), np.nan))
    with pytest.raises(TypeError, match="points must be"):
        gr.cluster_points("points.csv")


# Adjusted Rand index, number given and not; measured 0.720, 0.720; 1, 1; 1, 1; 0.882, 0.882. scikit-learn's
# SpectralClustering (10 neighbours): 0.719, 0.743, 0.612, 0.512; HDBSCAN of 15: 0.512, 1, 0.490, 0.
BARS = {"labirynth": (6, 0.71, 0.71), "circles": (4, 0.99, 0.99), "mk4": (3, 0.99, 0.99), "two_moons": (2, 0.86, 0.86)}


@pytest.mark.parametrize("name", BARS)
def test_known_clusters(data_folder, name):
    n, given, found = BARS[name]
    if name == "two_moons":
        with np.load(data_folder / "points" / "two_moons_100d.npz") as file:
            points, truth = file["features"].astype(float), file["labels"].astype(int)
    else:
        with gzip.open(data_folder / "points" / f"wut_{name}.csv.gz", "rt") as lines:
            table = np.loadtxt(lines, delimiter=",", skiprows=1)
        points, truth = table[:, :-1], table[:, -1].astype(int)
    assert rand_index(gr.cluster_points(points, n), truth - truth.min()) > given
    assert rand_index(gr.cluster_points(points), truth - truth.min()) > found


# without the rule these moons are four
@pytest.mark.parametrize(("draw", "seed", "count"), [("rings", 1, 3), ("moons", 2, 2), ("blob", 1, 1)])
def test_components_count_as_a_gap(draw, seed, count):
    """Clusters without an edge between them are apart; the random gaps within a thin ring are none."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, 900)
    if draw == "rings":
        x = np.repeat([1.0, 2, 3], 300)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    elif draw == "moons":
        half = angle / 2
        upper = np.stack([np.cos(half), np.sin(half)], 1)
        x = np.where((np.arange(900) % 2)[:, None] > 0, upper, [1, 0.4] - upper)
    else:
        x = rng.normal(size=(900, 2))
    x = x + rng.normal(0, 0.04, x.shape)
    assert gr.cluster_points(x, backend="numpy").max() + 1 == count
