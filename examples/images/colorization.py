"""
Colour from scribbles
=====================

Given are a grey picture and some coloured lines. The chrominance is known on the lines only. It is regularized on a
graph whose weights come from the luminance, so that colour spreads where the grey value is constant and stops where it
jumps. In terms of the model, lam is infinite on the lines and zero elsewhere.
"""

import numpy as np
from matplotlib.figure import Figure
from skimage import color, data, draw

import gpureg as gr

# %%
# The picture at half its size; only its luminance is used.

original = data.astronaut()[:300, 90:390].reshape(150, 2, 150, 2, 3).mean(axis=(1, 3)) / 255
luminance = color.rgb2gray(original)

# %%
# Lines from (row, column) to (row, column), one colour after the other: hair, skin, the suit, the wall, grey objects.

lines = {
    (140, 115, 60): [(15, 62, 30, 95), (30, 97, 50, 100), (33, 38, 50, 36), (24, 45, 20, 50), (36, 60, 34, 85)],
    (225, 185, 160): [(48, 70, 66, 62), (58, 50, 64, 55), (60, 80, 66, 82), (88, 58, 90, 82), (45, 55, 45, 85)],
    (230, 110, 65): [(125, 4, 145, 25), (130, 112, 145, 125), (146, 30, 146, 50), (141, 105, 147, 100)],
    (200, 190, 185): [(20, 8, 60, 20), (4, 40, 4, 130), (60, 115, 110, 125), (80, 8, 80, 12), (75, 30, 65, 30)],
    (95, 95, 100): [
        *((82, 35, 110, 60), (110, 60, 120, 85), (128, 50, 130, 80), (92, 99, 118, 104), (78, 30, 95, 18)),
        *((105, 18, 130, 32), (135, 60, 137, 85), (105, 72, 105, 85), (40, 146, 80, 146), (108, 140, 108, 147)),
    ],
}
scribbles = np.repeat(luminance[..., None], 3, axis=2)
lam = np.zeros(luminance.shape)
for rgb, ends in lines.items():
    for r0, c0, r1, c1 in ends:
        for row in (0, 1):
            place = draw.line(r0 + row, c0, r1 + row, c1)
            scribbles[place], lam[place] = np.divide(rgb, 255), np.inf
print(f"colour is known at {100 * np.mean(lam > 0):.1f} percent of the pixels")

# %%
# Two channels of chrominance on the grid of nearest neighbours. ``weights.guided`` takes the weights from the
# luminance, not from the function that is regularized. With constant weights, for comparison, colours cross all
# borders. ``solver="certified"`` finds the minimiser; its energy is at most the duality gap above the minimum.

chroma = np.where(lam[..., None] > 0, color.rgb2yuv(scribbles)[..., 1:], 0)
weights = gr.weights.guided(gr.weights.bilateral(np.inf, 0.05), luminance.ravel())
minimiser = {"lam": lam, "solver": "certified", "tol": 1e-6}
found = {
    "constant weights": gr.regularize(chroma, gr.GridGraph(lam.shape), **minimiser),
    "from the luminance": gr.regularize(chroma, gr.GridGraph(lam.shape), weights=weights, **minimiser),
}

panels = {"given": scribbles}
for title, result in found.items():
    yuv = np.concatenate([luminance[..., None], result.value], axis=-1)
    panels[title] = np.clip(color.yuv2rgb(yuv), 0, 1)
    error = np.sqrt(np.mean((panels[title] - original) ** 2))
    print(f"{title}: root mean square error {error:.4f}, gap {result.gap / result.energy[-1]:.0e} of the energy")
panels["the original"] = original

figure = Figure(figsize=(14, 4), layout="constrained")
for axes, (title, image) in zip(figure.subplots(1, 4), panels.items(), strict=True):
    axes.imshow(image)
    axes.set(title=title, xticks=[], yticks=[])
figure
