"""
What the degree p does
======================

The energy sums the norm of the gradient to the power p. With p = 2 many small differences are cheaper than one large
one; with p = 1 the cost of a step does not depend on how steep it is; for p < 1 one large difference is cheaper than
many small ones, and the picture becomes flat pieces. The fidelity is zero here: the result depends on the picture only
through the start and the number of sweeps.
"""

import numpy as np
from matplotlib.figure import Figure
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from skimage import data

import gpureg as gr

# %%
# A part of the camera picture, on the graph that joins each pixel with its eight neighbours, all weights 1. The
# number of sweeps is the same for each p.

image = data.camera()[60:188, 200:328].astype(np.float32)
grid = gr.GridGraph(image.shape)
results = {p: gr.regularize(image, grid, p=p, lam=0, max_iter=300).value for p in (2, 1, 0.5, 0.1)}

# %%
# Two neighbours whose values differ by less than a tenth of a grey level are joined, and pixels that a chain of such
# neighbours connects are one piece. The values of the picture itself are integers, many of which are equal at the
# start.


def count_pieces(values, gap=0.1):
    """Number of connected parts of the graph of the edges along which `values` change by less than `gap`."""
    graph = grid.to_graph()
    rows, columns, flat = graph.edge_rows(), graph.indices, values.ravel()
    met = np.abs(flat[rows] - flat[columns]) < gap
    links = coo_array((met[met], (rows[met], columns[met])), shape=(flat.size, flat.size))
    return connected_components(links)[0]


pieces = {p: count_pieces(values) for p, values in results.items()}
print(f"the picture: {count_pieces(image)} pieces of {image.size} pixels")
for p, count in pieces.items():
    print(f"p = {p}: {count} pieces")

# %%
# The pictures, and below them one row of each. The grey curve is the same row of the original; the line in the pictures
# shows where it is.

row = 100
figure = Figure(figsize=(14, 5.6), layout="constrained")
top, bottom = figure.subplots(2, 4, height_ratios=(3, 1.4), sharex=True)
for (p, values), above, below in zip(results.items(), top, bottom, strict=True):
    above.imshow(values, cmap="gray", vmin=0, vmax=255)
    above.axhline(row, color="tab:orange", linewidth=0.8)
    above.set(title=f"p = {p}: {pieces[p]} pieces", yticks=[])
    below.plot(image[row], color="0.7", linewidth=1)
    below.plot(values[row], color="tab:blue", linewidth=1.2)
    below.set_ylim(-5, 260)
figure
