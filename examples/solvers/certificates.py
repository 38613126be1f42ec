"""
How far from the minimum
========================

For p >= 1 and a fidelity above zero the energy has one minimiser. ``solver="certified"`` iterates until a dual problem
proves that the minimiser is near: the result has a gap, which is an upper bound on its energy above the minimum, and a
bound on the distance to the minimiser. With the lower bound of the energy the results of other solvers can be judged
too.
"""

import numpy as np
from matplotlib.figure import Figure
from skimage import data

import gpureg as gr

# %%
# Total variation on a part of the camera picture with noise. eps is the same in all runs, so that they minimise the
# same energy.

camera = data.camera()[60:140, 190:270] / 255
noisy = camera + np.random.default_rng(0).normal(0, 0.1, camera.shape)
grid = gr.GridGraph(noisy.shape, metric="cityblock")
problem = {"p": 1, "lam": 12, "eps": 1e-3, "dtype": np.float64}
exact = gr.regularize(noisy, grid, solver=gr.Certified(tol=1e-8), **problem)
print(exact.stop)
print(f"energy {exact.energy[-1]:.6f}, no function is below {exact.lower_bound:.6f}, gap {exact.gap:.1e}")
print(f"root mean square distance from the minimiser at most {exact.error_bound / np.sqrt(noisy.size):.1e}")

# %%
# The energy by iterations of the paper's process, plain and accelerated, of explicit Euler steps, and of the
# certified solver with its own method for p = 1. An iteration is not the same work in each.

runs = {
    "Jacobi": gr.regularize(noisy, grid, max_iter=300, **problem),
    "Jacobi, accelerated": gr.regularize(noisy, grid, solver=gr.Jacobi(accelerate=True), max_iter=300, **problem),
    "Euler": gr.regularize(noisy, grid, solver="euler", max_iter=300, **problem),
    "certified": gr.regularize(noisy, grid, solver=gr.Certified(tol=1e-6, method="dual"), max_iter=300, **problem),
}
for name, result in runs.items():
    above = result.energy[-1] - exact.lower_bound
    error = np.sqrt(np.mean((result.value - exact.value) ** 2))
    print(f"{name:<20} {result.iterations:4} iterations: {above:.1e} above the bound, {error:.1e} from the minimiser")

figure = gr.plot.energy(runs, minimum=exact.lower_bound)
figure

# %%
# A callback gets the energy and the gap at each check. The gap is never less than the energy above the minimum.

seen = []
result = gr.regularize(noisy, grid, solver=gr.Certified(tol=1e-6, method="dual"), callback=seen.append, **problem)
checks = [check for check in seen if check.gap is not None]
steps = [check.iteration for check in checks]

figure = Figure(figsize=(7, 4), layout="constrained")
axes = figure.subplots()
axes.semilogy(steps, [check.gap for check in checks], label="gap, known to the run")
axes.semilogy(steps, [check.energy - exact.lower_bound for check in checks], label="energy above the minimum")
axes.set(xlabel="iterations", ylabel="energy")
axes.legend()
figure
