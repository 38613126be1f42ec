"""
Interpolation between scattered values
======================================

A value is known at a few of many points. :func:`gpureg.interpolate` pins these and fills in the others on a graph of
neighbours; p decides how a value spreads. Near 1 the function is piecewise constant, at p = 2 it has a spike at each
known value and is flat elsewhere, and the larger p, the smaller the largest slope, down to the absolutely minimal
Lipschitz extension of p = infinity.
"""

import math

import numpy as np
from matplotlib.figure import Figure

import gpureg as gr

rng = np.random.default_rng(1)
points = rng.uniform(0, 1, (1500, 2)) * (2, 1)
truth = np.hypot(points[:, 0] - 1, points[:, 1] - 0.5)
known = rng.choice(len(points), 25, replace=False)
values = np.full(len(points), np.nan)
values[known] = truth[known]
graph = gr.knn_graph(points, 10)
near = gr.weights.inverse_distance()

# %%
# Each result has a bound: ``gap`` on the energy above its minimum. For p = infinity the energy is the largest slope,
# and no function with these values has one smaller by more than the gap.

figure = Figure(figsize=(11, 5.6), layout="constrained")
for axes, p in zip(figure.subplots(2, 2).ravel(), (1.5, 2, 3, math.inf), strict=True):
    result = gr.interpolate(values, graph, p=p, weights=near)
    error = np.abs(result.value - truth).mean()
    print(f"p = {p}: mean error {error:.3f}, gap {result.gap / result.energy[-1]:.0e} of the energy. {result.stop}")
    shown = axes.scatter(*points.T, c=result.value, s=9, vmin=truth.min(), vmax=truth.max())
    axes.plot(*points[known].T, "kx", markersize=6)
    axes.set(title=f"p = {p}", aspect="equal", xticks=[], yticks=[])
figure.colorbar(shown, ax=figure.axes)
figure
