"""
The filters of OpenCV and scikit-image
======================================

:mod:`gpureg.presets` computes the filters of other libraries with their parameters, so that results can be compared
number by number. :mod:`gpureg.skimage` has three of scikit-image's denoisers with their signatures, so that only the
import changes. Where scikit-image's code differs from its documentation, gpureg computes what the documentation says.
"""

import cv2
import numpy as np
from matplotlib.figure import Figure
from skimage import data, restoration

import gpureg as gr
import gpureg.skimage

camera = data.camera()[100:196, 190:286]
noise = np.random.default_rng(0).normal(0, 20, camera.shape)
eight = np.clip(np.rint(camera + noise), 0, 255).astype(np.uint8)
floats = (eight / 255).astype(np.float32)


def tell(name, theirs, ours):
    """Print the largest and the mean difference."""
    difference = np.abs(np.subtract(theirs, ours, dtype=float))
    print(f"{name:<40}{difference.max():10.2g} at most, {difference.mean():10.2g} on average")


# %%
# The presets, on 8 bits or on floats in 0..1.

print("of 255:")
theirs = cv2.fastNlMeansDenoising(eight, None, 20, 7, 21)
tell("OpenCV, fastNlMeansDenoising", theirs, gr.presets.opencv_nl_means(eight, 20, 7, 21))
tell("OpenCV, bilateralFilter", cv2.bilateralFilter(eight, 9, 50, 3), gr.presets.opencv_bilateral(eight, 9, 50, 3))
print("of 1:")
tell("OpenCV, bilateralFilter", cv2.bilateralFilter(floats, 9, 0.2, 3), gr.presets.opencv_bilateral(floats, 9, 0.2, 3))
theirs = restoration.denoise_nl_means(floats, 5, 4, h=0.1, fast_mode=False)
tell("scikit-image, denoise_nl_means, slow", theirs, gr.presets.skimage_nl_means(floats, 5, 4, h=0.1))

# %%
# scikit-image's signatures. These results are near, not equal. The slow mode differs because scikit-image approximates
# the exponential. Its fast mode omits one row and one column of the patch, its bilateral filter reads a skewed table,
# and its total variation has another discretization.

calls = {
    "nonlocal means, slow": ("denoise_nl_means", {"h": 0.1, "fast_mode": False, "patch_distance": 4}),
    "nonlocal means, fast": ("denoise_nl_means", {"h": 0.06, "sigma": 0.08, "patch_distance": 6}),
    "bilateral": ("denoise_bilateral", {"sigma_color": 0.15, "sigma_spatial": 3}),
    "total variation": ("denoise_tv_chambolle", {"weight": 0.08}),
}
pairs = {}
for name, (function, arguments) in calls.items():
    pairs[name] = [getattr(library, function)(floats, **arguments) for library in (restoration, gpureg.skimage)]
    tell(name, *pairs[name])

# %%
# The pair that differs most.

name = max(pairs, key=lambda key: np.abs(np.subtract(*pairs[key])).mean())
theirs, ours = pairs[name]
figure = Figure(figsize=(14, 4.6), layout="constrained")
panels = {"scikit-image": (theirs, 0, 1), "gpureg.skimage": (ours, 0, 1), "difference": (theirs - ours, -0.1, 0.1)}
for axes, (title, (image, low, high)) in zip(figure.subplots(1, 3), panels.items(), strict=True):
    shown = axes.imshow(image, cmap="gray", vmin=low, vmax=high)
    axes.set(title=f"{name}: {title}", xticks=[], yticks=[])
figure.colorbar(shown, ax=axes)
figure
