"""
A function on roads
===================

A quantity, for example the rent, is measured with errors at the crossings of a network of roads. The graph is that of
the roads and not of the plane: two crossings on opposite sides of the river can be near to each other, but far apart by
road. The weight of an edge is the inverse of its length.
"""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay

import gpureg as gr

# %%
# Random crossings, joined with their neighbours in the Delaunay triangulation. Long roads are left out, and a quarter
# of the others, and all that cross the river except three bridges. Only the largest connected part remains.

rng = np.random.default_rng(0)
places = rng.uniform(0, 10, (1200, 2))
corners = Delaunay(places).simplices
roads = np.unique(np.sort(corners[:, [0, 1, 1, 2, 0, 2]].reshape(-1, 2), axis=1), axis=0)
north = places[:, 1] > 5 + 1.2 * np.sin(0.8 * places[:, 0])
middle = places[roads].mean(axis=1)
crosses = north[roads[:, 0]] != north[roads[:, 1]]
bridges = [np.argmin(np.where(crosses, np.abs(middle[:, 0] - x), np.inf)) for x in (2, 5, 8)]
length = np.linalg.norm(np.diff(places[roads], axis=1)[:, 0], axis=1)
kept = (length < 0.45) & ~crosses & (rng.uniform(size=len(roads)) < 0.75)
kept[bridges] = True
whole = gr.Graph.from_edges(roads[kept], 1 / length[kept], n_vertices=len(places)).to_scipy()
part = connected_components(whole)[1]
inside = np.flatnonzero(part == np.bincount(part).argmax())
graph = gr.Graph.from_scipy(whole[inside][:, inside], positions=places[inside])
print(f"{graph.n_vertices} crossings, {graph.n_edges // 2} roads")

# %%
# A function that changes slowly along the roads, and jumps at the river. The fidelity follows from the size of the
# errors, by the discrepancy principle, for p = 2 and for p = 1.

x, y = graph.positions.T
truth = np.where(north[inside], 60 + 6 * np.sin(0.7 * x) + 3 * y, 20 + 4 * np.sin(x + y))
seen = truth + rng.normal(0, 8, len(truth))
shown = {"true": truth, "measured": seen}
for p in (2, 1):
    found = gr.tuning.discrepancy(seen, graph, sigma=8, p=p, max_iter=2000, tol=1e-5)
    shown[f"p = {p}"] = found.result.value
    print(f"p = {p}: lam = {found.lam:.3g}")
errors = {name: np.sqrt(np.mean((values - truth) ** 2)) for name, values in shown.items()}

# %%
# Each road has the colour of the mean of its two ends. With p = 2 values leak over the bridges, and the jump becomes a
# slope; with p = 1 the jump remains.

figure = Figure(figsize=(14, 4.2), layout="constrained")
one_way = graph.edge_rows() < graph.indices
ends = np.stack([graph.edge_rows(), graph.indices], axis=1)[one_way]
for axes, (name, values) in zip(figure.subplots(1, 4), shown.items(), strict=True):
    lines = LineCollection(graph.positions[ends], array=values[ends].mean(axis=1), cmap="viridis", linewidths=2)
    lines.set_clim(truth.min(), truth.max())
    axes.add_collection(lines)
    title = name if name == "true" else f"{name}: error {errors[name]:.2f}"
    axes.set(title=title, aspect="equal", xlim=(0, 10), ylim=(0, 10), xticks=[], yticks=[])
figure.colorbar(lines, ax=axes)
figure
