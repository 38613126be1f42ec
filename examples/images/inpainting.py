"""
Filling in missing pixels
=========================

:func:`gpureg.inpaint_image` computes missing pixels from those around them: the known pixels are pinned, the others
have no data. On nearest neighbours p = 2 gives a smooth fill and p = 1 one with steps. With weights that compare
patches the fill uses pixels from similar places.
"""

import numpy as np
from matplotlib.figure import Figure
from skimage import data

import gpureg as gr

rng = np.random.default_rng(0)


def psnr(image, truth, where):
    """Peak signal-to-noise ratio in dB of the pixels in `where`, of values in 0..255."""
    return 10 * np.log10(255**2 / np.mean((image[where] - truth[where]) ** 2))


# %%
# Tears of random place, direction and width. Their pixels are set to NaN; the values of missing pixels are never used.

y, x = np.indices((160, 160))
torn = np.zeros((160, 160), bool)
for _ in range(12):
    (cy, cx), turn, length = rng.uniform(0, 160, 2), rng.uniform(0, np.pi), rng.uniform(20, 60)
    along = (x - cx) * np.cos(turn) + (y - cy) * np.sin(turn)
    across = (y - cy) * np.cos(turn) - (x - cx) * np.sin(turn)
    torn |= (np.abs(along) < length) & (np.abs(across + 3 * np.sin(along / 6)) < rng.uniform(1.0, 2.5))
print(f"{100 * torn.mean():.0f} percent of the pixels are missing")

# %%
# Coins are flat objects with a border. Where a tear crosses the border, p = 2 leaves a blur and p = 1 one step.

coins = data.coins()[:160, :160].astype(np.float32)
holes = np.where(torn, np.nan, coins)
fills = {f"p = {p}": gr.inpaint_image(holes, missing=torn, p=p) for p in (2, 1)}


def draw(truth, fills):
    """Draw the torn picture, with missing pixels in orange, and the fills."""
    figure = Figure(figsize=(14, 5.2), layout="constrained")
    for axes, (title, image) in zip(figure.subplots(1, 1 + len(fills)), {"torn": truth, **fills}.items(), strict=True):
        axes.imshow(image, cmap="gray", vmin=truth.min(), vmax=truth.max())
        if title == "torn":
            axes.imshow(np.where(torn[..., None], (255, 127, 14, 255), 0).astype(np.uint8))
        else:
            title = f"{title}: {psnr(image, truth, torn):.2f} dB"
        axes.set(title=title, xticks=[], yticks=[])
    return figure


figure = draw(coins, fills)
figure

# %%
# A brick wall repeats itself. Patches of 7 x 7 pixels in a window of 21 x 21 find the joints, which a fill from nearest
# neighbours cannot. The decibels count the missing pixels only.

brick = data.brick()[:160, :160].astype(np.float32)
holes = np.where(torn, np.nan, brick)
fills = {
    "nearest neighbours": gr.inpaint_image(holes, missing=torn),
    "by patches": gr.inpaint_image(holes, missing=torn, weights=gr.weights.patch(3, h=30)),
}

figure = draw(brick, fills)
figure
