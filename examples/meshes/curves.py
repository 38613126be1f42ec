"""
Outlines
========

The graph of an outline is a ring, and its coordinates are a function on it. :func:`gpureg.denoise_curve` estimates the
noise and removes it; :func:`gpureg.simplify_curve` leaves the vertices that make its shape.
"""

import numpy as np
from skimage import data, measure

import gpureg as gr

# %%
# Every third vertex of the outline of scikit-image's horse, and the same with noise of one pixel. The noise is
# estimated, and the fidelity follows from it.

outline = max(measure.find_contours(~data.horse(), 0.5), key=len)
horse = outline[:-1:3, ::-1]
noisy = horse + np.random.default_rng(0).normal(0, 1.0, horse.shape)
curves = {"noisy": noisy, "p = 2": gr.denoise_curve(noisy), "p = 1": gr.denoise_curve(noisy, p=1)}
for name, curve in curves.items():
    error = np.sqrt(np.mean((curve - horse) ** 2))
    length = gr.metrics.curve_length(curve) / gr.metrics.curve_length(horse)
    print(f"{name}: error {error:.2f} pixels, length {100 * length:.0f} %")

# %%
# The head. For curves p = 1 is not better: the sum of the lengths between neighbours is least if vertices gather at few
# places with straight lines between them.


def near_head(curve):
    """The part of a curve from the neck to the throat, by the positions of the vertices in the outline."""
    return curve[(horse[:, 0] > 270) & (horse[:, 1] < 120)]


figure = gr.plot.curves({name: near_head(curve) for name, curve in curves.items()}, closed=False, upright=False)
figure

# %%
# Fewer vertices: those that stand least above the line between their neighbours go first. The paper's process for p < 1
# works on the directions of the segments, or on the positions, which thins the curve evenly. The curve is denoised
# first: noise has corners too.

clean = curves["p = 2"]
simple = {"heights": gr.simplify_curve(clean), "heights, 80": gr.simplify_curve(clean, n_vertices=80)}
simple["positions, 80"] = gr.simplify_curve(clean, filter="positions", n_vertices=80, max_iter=500)
for name, curve in simple.items():
    print(f"{name}: {len(curve)} of {len(clean)}, {gr.metrics.curve_hausdorff(curve, horse):.1f} pixels away at most")

figure = gr.plot.curves(simple, upright=False)
figure
