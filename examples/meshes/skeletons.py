"""
Skeletons
=========

The skeleton of a shape has a branch for every corner of its outline that points outwards, and so many branches come
from noise. :func:`gpureg.simplify_skeleton` regularizes the outline first, so that most of the remaining branches
belong to the shape.
"""

import numpy as np
from skimage import data, measure

import gpureg as gr

# %%
# The outline of scikit-image's horse with noise of 0.7 pixels. The defaults are p = 2, lam = 0.1 and ten iterations.

outline = max(measure.find_contours(~data.horse(), 0.5), key=len)
horse = outline[:-1, ::-1]
noisy = horse + np.random.default_rng(0).normal(0, 0.7, horse.shape)
found = gr.simplify_skeleton(noisy)
for name, skeleton in {"before": found.before, "after": found.after}.items():
    print(f"{name}: {skeleton.n_branches} branches, {skeleton.n_ends} ends")

figure = gr.plot.skeleton({"before": found.before, "after": found.after}, upright=False)
figure

# %%
# Without fidelity the number of iterations decides. The corners of the shape disappear, while its area changes little.

shown = {}
for iterations in (10, 100, 1000):
    after = gr.simplify_skeleton(noisy, lam=0, max_iter=iterations).after
    area = gr.metrics.curve_area(after.points) / gr.metrics.curve_area(horse)
    shown[f"{iterations} iterations: {after.n_ends} ends"] = after
    print(f"{iterations} iterations: {after.n_branches} branches, {after.n_ends} ends, area {100 * area:.1f} %")

figure = gr.plot.skeleton(shown, upright=False)
figure
