"""
Skeletons
=========

The skeleton of a shape has a branch for every corner of its outline that points outwards, and so one for every bit of
noise. :func:`gpureg.simplify_skeleton` regularizes the outline first: most branches that are left then belong to the
shape.
"""

import numpy as np
from skimage import data, measure

import gpureg as gr

# %%
# The outline of scikit-image's horse with noise of 0.7 pixels. p = 2, lam = 0.1 and ten iterations are what the
# function takes by itself.

outline = max(measure.find_contours(~data.horse(), 0.5), key=len)
horse = outline[:-1, ::-1]
noisy = horse + np.random.default_rng(0).normal(0, 0.7, horse.shape)
found = gr.simplify_skeleton(noisy)
for name, skeleton in {"before": found.before, "after": found.after}.items():
    print(f"{name}: {skeleton.n_branches} branches, {skeleton.n_ends} ends")

figure = gr.plot.skeleton({"before": found.before, "after": found.after}, upright=False)
figure

# %%
# With no fidelity at all the number of iterations decides. The area of the shape changes little, while its corners
# go.

shown = {}
for iterations in (10, 100, 1000):
    after = gr.simplify_skeleton(noisy, lam=0, max_iter=iterations).after
    area = gr.metrics.curve_area(after.points) / gr.metrics.curve_area(horse)
    shown[f"{iterations} iterations: {after.n_ends} ends"] = after
    print(f"{iterations} iterations: {after.n_branches} branches, {after.n_ends} ends, area {100 * area:.1f} %")

figure = gr.plot.skeleton(shown, upright=False)
figure
