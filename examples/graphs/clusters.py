"""
Clusters of any shape
=====================

For p < 1 regularization moves points together along the edges of their graph, until neighbours are at the same
position. :func:`gpureg.cluster_points` takes these groups as pieces and joins the pieces with the strongest
connections. It finds rings as well as blobs; outliers go to the cluster of the nearest point.
"""

import numpy as np

import gpureg as gr

# %%
# Two rings, two blobs, and 60 outliers.

rng = np.random.default_rng(0)
turn = rng.uniform(0, 2 * np.pi, 600)
radius = np.repeat([1.0, 2.2], [200, 400]) + rng.normal(0, 0.07, 600)
points = np.concatenate(
    [
        radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1),
        rng.normal((4.5, 1.2), 0.35, (300, 2)),
        rng.normal((4.6, -1.2), (0.6, 0.2), (300, 2)),
        rng.uniform(-3, (6.5, 3), (60, 2)),
    ]
)
truth = np.repeat([0, 1, 2, 3, -1], [200, 400, 300, 300, 60])

# %%
# Without a number of clusters, joining stops at the widest gap between the joins. The table counts, for each cluster,
# how many points of each kind are in it; the last column is for the outliers.

labels = gr.cluster_points(points)
for k in range(labels.max() + 1):
    print(f"cluster {k}:", np.array([np.sum(truth[labels == k] == kind) for kind in (0, 1, 2, 3, -1)]))

# %%
# The number of clusters can be given; with three, the two rings are one cluster.

figure = gr.plot.points({"none given": points, "3 clusters": points}, values=[labels, gr.cluster_points(points, 3)])
figure

# %%
# The effect of p on the coordinates, in units of the median edge: with p = 2 points move to the mean of their
# neighbours and no two reach the same position; with p = 0.1 they gather at few places. Places closer than a hundredth
# of an edge count as one.

graph = gr.knn_graph(points, 10)
edge = np.median(np.linalg.norm(points[graph.edge_rows()] - points[graph.indices], axis=1))
moved = {}
for p in (2, 1, 0.1):
    result = gr.regularize(points / edge, graph, p=p, lam=0.1, eps=0.01, max_iter=200)
    places = len(np.unique(np.rint(100 * result.value), axis=0))
    moved[f"p = {p}: {places} places"] = edge * result.value
figure = gr.plot.points({"given": points, **moved}, values=[labels] * 4)
figure
