"""
Parameters learned from examples
================================

``gpureg.derivatives`` has the derivatives of any function of a result with respect to the data, the fidelity, the
weight of every edge, p and eps. With them parameters are learned where the truth is known, and used where it is not.
Here three numbers are learned on one part of the camera picture: lam, p, and how fast weights fall with the difference
of two pixels of a smoothed picture.
"""

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize
from skimage import data

import gpureg as gr

# %%
# Two parts of a picture, and noise.

sigma = 0.1
camera = data.camera() / 255
parts = {"learned on": camera[60:108, 200:248], "used on": camera[84:132, 250:298]}
noise = {name: np.random.default_rng(k).normal(0, sigma, (48, 48)) for k, name in enumerate(parts)}
noisy = {name: parts[name] + noise[name] for name in parts}
grid = gr.GridGraph((48, 48), metric="cityblock")
edges, _ = grid.to_graph().to_edges()
u, v = edges.T


def squares(image):
    """Compute the squared difference of the smoothed image over each edge, once per direction, on a scale of 1."""
    smooth = gaussian_filter(image, 1).ravel()
    graph = gr.Graph.from_edges(edges, (smooth[u] - smooth[v]) ** 2, n_vertices=grid.n_vertices)
    return graph.weights / sigma**2


# %%
# The loss and its derivatives with respect to the three numbers. The weights are exp(-a squares), so that the
# derivative with respect to a is a sum over the edges; lam and a are learned by their logarithms. The gradient of the
# loss is given as a function: it is taken at the exact minimiser, and a few sweeps are enough for the result.


def loss(numbers, name):
    """Compute the logarithm of the mean squared error on a part, its gradient, and the picture."""
    lam, a, p = np.exp(numbers[0]), np.exp(numbers[1]), numbers[2]
    apart = squares(noisy[name])
    weights = np.exp(-a * apart)
    result = gr.regularize(noisy[name], grid, p=p, lam=lam, weights=weights, eps=0.01, max_iter=30)
    truth = parts[name]
    found = gr.derivatives(result, lambda value: 2 * (value - truth) / ((value - truth) ** 2).sum())
    by_weights = grid.edges.listed(found.weights, "weights")
    slope = np.array([found.lam * lam, a * (by_weights * -apart * weights).sum(), found.p])
    return np.log(np.mean((found.value - truth) ** 2)), slope, found.value


begin = np.array([np.log(10.0), np.log(0.3), 1.5])
_, slope, _ = loss(begin, "learned on")
for k in range(3):
    step = np.zeros(3)
    step[k] = 1e-4
    change = (loss(begin + step, "learned on")[0] - loss(begin - step, "learned on")[0]) / 2e-4
    print(f"derivative {slope[k]: .6e}, by differences {change: .6e}")

# %%
# Gradient descent by a quasi-Newton method. What is learned on one part also serves on the other.

limits = [(np.log(0.1), np.log(1000)), (np.log(1e-4), np.log(10)), (1.0, 2.0)]
learned = minimize(lambda x: loss(x, "learned on")[:2], begin, jac=True, method="L-BFGS-B", bounds=limits).x
print(f"lam = {np.exp(learned[0]):.2f}, a = {np.exp(learned[1]):.3f}, p = {learned[2]:.2f}")


def decibels(loss):
    """Convert a loss of values in 0..1 to a PSNR."""
    return -10 * loss / np.log(10)


for name in parts:
    before, after = (decibels(loss(x, name)[0]) for x in (begin, learned))
    print(
        f"{name:<11} {decibels(np.log(np.mean(noise[name] ** 2))):.2f} dB, at first {before:.2f}, learned {after:.2f}"
    )

# %%
# The part that was not learned on.

figure = Figure(figsize=(9, 3.2), layout="constrained")
pictures = {"noisy": noisy["used on"], "learned": loss(learned, "used on")[2], "truth": parts["used on"]}
for axes, (title, picture) in zip(figure.subplots(1, 3), pictures.items(), strict=True):
    axes.imshow(picture, cmap="gray", vmin=0, vmax=1)
    axes.set(title=title, xticks=[], yticks=[])
figure
