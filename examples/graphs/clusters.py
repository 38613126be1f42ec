"""
Clusters of any shape
=====================

For p < 1 the coordinates of points are drawn together along the edges of their graph until neighbours meet.
:func:`gpureg.cluster_points` takes those that met as pieces and joins the pieces that hang together most. Rings are
found as well as blobs; points that belong to nothing go to the cluster of the nearest point.
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
# With no number given, joining stops at the widest gap between the joins. The table counts, for each cluster, how
# many points of each kind are in it; the last column holds the outliers.

labels = gr.cluster_points(points)
for k in range(labels.max() + 1):
    print(f"cluster {k}:", np.array([np.sum(truth[labels == k] == kind) for kind in (0, 1, 2, 3, -1)]))

# %%
# A number can be asked for; with three the two rings are one.

figure = gr.plot.points({"none given": points, "3 clusters": points}, values=[labels, gr.cluster_points(points, 3)])
figure

# %%
# What p does to the coordinates themselves, in units of the median edge: with p = 2 points move to the mean of their
# neighbours and no two meet; with p = 0.1 they gather at few places. The number of places counts those more than a
# hundredth of an edge apart.

graph = gr.knn_graph(points, 10)
edge = np.median(np.linalg.norm(points[graph.edge_rows()] - points[graph.indices], axis=1))
moved = {}
for p in (2, 1, 0.1):
    result = gr.regularize(points / edge, graph, p=p, lam=0.1, eps=0.01, max_iter=200)
    places = len(np.unique(np.rint(100 * result.value), axis=0))
    moved[f"p = {p}: {places} places"] = edge * result.value
figure = gr.plot.points({"given": points, **moved}, values=[labels] * 4)
figure
