"""
A picture as regions
====================

:func:`gpureg.simplify_image` divides a picture into zones around its extrema, gives each zone one value, and
regularizes these values on the graph of neighbouring zones. For p < 1 neighbours come to the same value and are joined.
Repeated with a smaller and smaller fidelity, this gives a hierarchy: each region is a union of regions of the level
before.
"""

import numpy as np
from matplotlib.figure import Figure
from skimage import data

import gpureg as gr

# %%
# The fine partition: ``max_iter=0`` leaves the values of the regions as they are, the means of their pixels.

coins = data.coins()[:200]
fine = gr.simplify_image(coins, max_iter=0)
print(fine)
print(f"{fine.percent:.1f} percent of the pixels, seen through a Gaussian of {fine.smooth} pixels")

# %%
# By default the regions are regularized with p = 2. The figure shows a part of the picture, its partition in random
# colours, the regions with their means, and with their regularized values.

part = gr.simplify_image(coins[20:120, 90:190])
figure = part.plot()
figure

# %%
# With these weights the energy on the regions equals that of the painted picture on its pixels, except for a constant.
# Neighbours are joined if they differ by at most ``merge_tol`` grey levels. It is small because joins form chains, and
# a slow change of light is a chain of small steps.


def psnr(image):
    """Peak signal-to-noise ratio in dB against the picture."""
    return 10 * np.log10(255**2 / np.mean(np.subtract(image, coins, dtype=float) ** 2))


settings = {"p": 0.5, "weights": "border", "norm": "edge", "by_size": True, "max_iter": 100}
levels = fine.hierarchy(lam=[3, 1, 0.3, 0.1, 0.05], merge_tol=0.3, **settings)
for level in levels:
    print(f"{level.n_regions:6} regions {psnr(level.fine):6.2f} dB")

# %%
# Four of the levels, painted with the means of their regions and in random colours.

figure = Figure(figsize=(14, 4.2), layout="constrained")
for column, level in zip(figure.subplots(2, 4).T, levels[1:], strict=True):
    column[0].set_title(f"{level.n_regions} regions")
    column[0].imshow(level.fine, cmap="gray", vmin=0, vmax=255)
    column[1].imshow(level.random_colours())
    for axes in column:
        axes.set(xticks=[], yticks=[])
figure
