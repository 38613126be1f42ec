"""
Denoising without parameters
============================

:func:`gpureg.denoise_image` estimates the noise of a picture, and chooses the weights, the window and the strength of
the filter accordingly; two passes on groups of similar patches follow. The plan of a call can be read before anything
is computed. This works for grey pictures and for pictures in colour.
"""

import numpy as np
from skimage import data

import gpureg as gr

rng = np.random.default_rng(0)


def psnr(image, truth):
    """Peak signal-to-noise ratio in dB, of values in 0..255."""
    return 10 * np.log10(255**2 / np.mean(np.subtract(image, truth, dtype=float) ** 2))


# %%
# Noise of standard deviation 20 on a part of scikit-image's camera picture, which has values in 0..255. The picture is
# the only argument.

camera = data.camera()[60:316, 120:376].astype(np.float32)
noisy = camera + rng.normal(0, 20, camera.shape).astype(np.float32)
clean = gr.denoise_image(noisy)
print(f"noisy {psnr(noisy, camera):.2f} dB, denoised {psnr(clean, camera):.2f} dB")

# %%
# The difference on the right is what was removed. Where it shows edges, the filter has removed a part of them too.

figure = gr.plot.compare(noisy, clean, reference=camera, data_range=(0, 255))
figure

# %%
# What was chosen, and by which rule. Every parameter can be given: ``p=1`` is total variation on the nearest
# neighbours.

print(gr.plan_denoising(noisy).explain())
print()
print(gr.plan_denoising(noisy, p=1).explain())
flat = gr.denoise_image(noisy, p=1)
print(f"\np = 1: {psnr(flat, camera):.2f} dB")

# %%
# For a picture in colour ``channel_axis`` is the axis of the channels, which are compared and averaged together.
# Integers come back as integers.

astronaut = data.astronaut()[20:220, 110:330]
noisy = np.clip(np.rint(astronaut + rng.normal(0, 25, astronaut.shape)), 0, 255).astype(np.uint8)
clean = gr.denoise_image(noisy, channel_axis=-1)
print(clean.dtype, f"noisy {psnr(noisy, astronaut):.2f} dB, denoised {psnr(clean, astronaut):.2f} dB")

figure = gr.plot.compare(noisy, clean, reference=astronaut, channel_axis=-1)
figure
