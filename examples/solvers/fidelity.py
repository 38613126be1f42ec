"""
Choosing the fidelity
=====================

If lam is too large the noise stays, if it is too small details are lost. Where the clean picture is known, the best lam
can be found with it. This page compares it with what :mod:`gpureg.tuning` finds without the clean picture: by the
discrepancy principle, which removes as much as there is noise, and by minimising Stein's estimate of the error (SURE).
"""

import numpy as np
from matplotlib.figure import Figure
from skimage import data

import gpureg as gr

# %%
# Many values of lam in one call: each run starts from the result of the run before. The certified solver makes sure
# that the results differ in lam only.

sigma = 20.0
camera = data.camera()[60:188, 180:308].astype(float)
noisy = camera + np.random.default_rng(0).normal(0, sigma, camera.shape)
grid = gr.GridGraph(noisy.shape, metric="cityblock")
problem = {"p": 1, "solver": gr.Certified(tol=1e-4)}
path = gr.regularization_path(noisy, grid, lam=np.geomspace(0.5, 0.02, 12), **problem)


def psnr(image):
    """Peak signal-to-noise ratio in dB, of values in 0..255."""
    return 10 * np.log10(255**2 / np.mean((image - camera) ** 2))


# %%
# SURE for the same values: the mean squared error, estimated from the noisy picture, the denoiser and sigma alone.


def denoiser(lam):
    """Return the function of a picture whose error is estimated."""
    return lambda image: gr.regularize(image, grid, lam=lam, **problem).value


errors = [np.mean((result.value - camera) ** 2) for result in path]
estimates = [gr.tuning.sure(denoiser(lam), noisy, sigma) for lam in path.values]
for lam, error, estimate in zip(path.values, errors, estimates, strict=True):
    print(f"lam = {lam:.4f}: mean squared error {error:6.2f}, SURE {estimate:6.2f}")

# %%
# The choices. ``denoise_image`` has its own rule, and searches with ``lam="sure"`` or ``lam="discrepancy"``; it
# estimates sigma too.

found = gr.tuning.discrepancy(noisy, grid, sigma, p=1, solver=gr.Certified(tol=1e-5))
choices = {"discrepancy": found.lam}
for name, lam in {"rule": None, "sure": "sure"}.items():
    choices[name] = float(gr.plan_denoising(noisy, p=1, lam=lam).lam)
for name, lam in choices.items():
    print(f"{name:<12} lam = {lam:.4f}: {psnr(denoiser(lam)(noisy)):.2f} dB")
print(f"{'best listed':<12} lam = {path.values[np.argmin(errors)]:.4f}: {max(psnr(r.value) for r in path):.2f} dB")

figure = Figure(figsize=(8, 4.4), layout="constrained")
axes = figure.subplots()
axes.semilogx(path.values, [psnr(result.value) for result in path], "ko-", label="PSNR, by the truth")
axes.semilogx(path.values, 10 * np.log10(255**2 / np.array(estimates)), "k:", label="PSNR, by SURE")
for (name, lam), colour in zip(choices.items(), ("tab:blue", "tab:orange", "tab:green"), strict=True):
    axes.axvline(lam, color=colour, label=name)
axes.set(xlabel="lam", ylabel="dB")
ticks = (0.02, 0.05, 0.1, 0.2, 0.5)
axes.set_xticks(ticks, [str(tick) for tick in ticks])
axes.set_xticks([], minor=True)
axes.legend()
figure
