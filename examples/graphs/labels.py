"""
Labels from a few known ones
============================

A few points have a label. :func:`gpureg.propagate_labels` pins them and regularizes one function per class on a graph
of neighbours; a point gets the class whose function is largest there. Which p is best depends on what separates the
classes: a gap between them, or the distance to the labels.
"""

import numpy as np
from matplotlib.figure import Figure

import gpureg as gr

rng = np.random.default_rng(0)
ways = {
    "p = 1.5": {"p": 1.5},
    "p = 2, plain": {"reweighting": "none"},
    "p = 2, the default": {},
    "p = 4": {"p": 4},
}


def experiment(points, truth, known, draws=3):
    """Labels drawn at random, `known` of each class; the accuracies, and the scores of the last draw."""
    graph = gr.knn_graph(points, 10)
    right = {name: [] for name in ways}
    for _ in range(draws):
        labels = np.full(len(points), -1)
        for k, count in enumerate(known):
            labels[rng.choice(np.flatnonzero(truth == k), count, replace=False)] = k
        scores = {}
        for name, how in ways.items():
            found, score = gr.propagate_labels(labels, graph, return_scores=True, **how)
            right[name].append(100 * np.mean(found == truth))
            scores[name] = score[:, 1]
    for name, shares in right.items():
        print(f"{name:<18} {np.mean(shares):5.1f} percent right on average, {min(shares):5.1f} at worst")
    figure = Figure(figsize=(14, 7), layout="constrained")
    for axes, name in zip(figure.subplots(2, 2).flat, ways, strict=True):
        shown = axes.scatter(*points.T, c=scores[name], s=8, cmap="coolwarm", vmin=0, vmax=1)
        axes.plot(*points[labels >= 0].T, "kx", markersize=9, markeredgewidth=2.5)
        axes.set(title=f"{name}: {right[name][-1]:.1f} % right", aspect="equal", xticks=[], yticks=[])
    figure.colorbar(shown, ax=axes)
    return figure


# %%
# Two half circles with a gap between them, and one label each, at the crosses. The colour is the score of the second
# class, from 0 to 1; a point with 1/2 or more belongs to it. With a small p the score changes where few edges cross,
# that is in the gap. With a large p it changes slowly everywhere, so also along a half circle.

angle = rng.uniform(0, np.pi, 240)
moon = np.arange(240) % 2
points = np.stack([np.cos(angle), np.sin(angle)], axis=1)
points[moon == 1] = (1, 0.5) - points[moon == 1]
points += rng.normal(0, 0.1, points.shape)

figure = experiment(points, moon, known=(1, 1))
figure

# %%
# The halves of a rectangle that is filled evenly, with one label in the left half and five in the right. There is no
# gap. At p = 2 a function has a spike at a single label and quickly falls to the value of most labels, unless edges at
# labelled points count more; at p = 1.5 almost all points go to the class with five labels. At p = 4 the distance
# decides.

points = rng.uniform(0, 1, (500, 2)) * (2, 1)
figure = experiment(points, (points[:, 0] > 1).astype(int), known=(1, 5))
figure
