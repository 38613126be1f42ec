"""
Frequencies on a graph
======================

The eigenvectors of the random walk on a graph are its waves, from slow to fast. :mod:`gpureg.spectral` projects a
function on the slowest ones, or lets it diffuse; both are filters whose effect on each frequency is known beforehand.
:func:`gpureg.regularize` with p = 2 is such a filter too. With p = 1 it is not: its effect depends on the function.
"""

import numpy as np

import gpureg as gr

# %%
# Points on a ring of varying width, joined with their eight nearest, and the first waves on that graph.

rng = np.random.default_rng(0)
angle = rng.uniform(0, 2 * np.pi, 1500)
radius = 3 + rng.uniform(-1, 1, 1500) * (0.7 + 0.4 * np.cos(angle))
points = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
graph = gr.knn_graph(points, 8)
pairs = gr.spectral.eigenpairs(graph, 60)

waves = (1, 2, 5, 12)
figure = gr.plot.points(
    {f"wave {i}, frequency {1 - pairs.values[i]:.4f}": points for i in waves},
    values=[pairs.vectors[:, i] for i in waves],
)
figure

# %%
# A smooth function and one with a jump, each with noise, filtered in four ways. The strength of each filter is the best
# of several for that function, by the true function, which is known here.

truths = {"smooth": np.sin(3 * angle), "jump": np.where(np.abs(angle - np.pi) < 1.2, 1.0, -0.5)}
filters = {
    "projection": lambda f, k: gr.spectral.spectral_filter(f, graph, k, pairs=pairs),
    "diffusion": lambda f, t: gr.spectral.diffuse(f, graph, t),
    "p = 2": lambda f, lam: gr.regularize(f, graph, lam=lam, max_iter=1000, tol=1e-6).value,
    "p = 1": lambda f, lam: gr.regularize(f, graph, p=1, lam=lam, max_iter=1000, tol=1e-6).value,
}
strengths = {
    "projection": (4, 8, 12, 20, 40, 60),
    "diffusion": (2, 5, 10, 20, 50),
    "p = 2": (0.2, 0.5, 1, 2, 5, 10),
    "p = 1": (1, 2, 4, 8, 16),
}
best = {}
for name, truth in truths.items():
    noisy = truth + rng.normal(0, 0.4, truth.shape)
    for kind, run in filters.items():
        outcomes = {s: run(noisy, s) for s in strengths[kind]}
        errors = {s: np.sqrt(np.mean((f - truth) ** 2)) for s, f in outcomes.items()}
        strength = min(errors, key=errors.get)
        best[name, kind] = outcomes[strength]
        print(f"{name:<7} {kind:<11} error {errors[strength]:.3f} at {strength}")
    best[name, "noisy"] = noisy

# %%
# The function with a jump. The projection oscillates on both sides of the jump, as partial sums of Fourier series do;
# with diffusion and p = 2 the jump becomes a slope.

shown = {kind: best["jump", kind] for kind in ("noisy", "projection", "p = 2", "p = 1")}
figure = gr.plot.points(dict.fromkeys(shown, points), values=list(shown.values()))
figure
