"""Group the patches of an image by similarity: :func:`patch_groups`."""

from __future__ import annotations

import math
from typing import Unpack, cast

import numpy as np
import numpy.typing as npt

from .. import backends
from ..backends import Backend
from ..backends.groups import GroupForm
from ..checks import integer, number
from ..doors import door
from ..frame import Frame
from ..graphs.grid import GridGraph
from ..model.memory import budget, readable
from ..model.problem import as_function
from .grouped_patches import LARGEST, PatchGroups, on_pixels, pixels_filled
from .guides import guide_values
from .options import ON_PIXELS, OnPixels, check_run, map_of
from .raster import Raster


@door(options=ON_PIXELS)
def patch_groups(
    image: npt.ArrayLike,
    *,
    patch_radius: int = 3,
    radius: float = 19,
    step: int = 4,
    k: int = 40,
    most: int = 80,
    flat: float | npt.ArrayLike = 0.0,
    **options: Unpack[OnPixels],
) -> PatchGroups:
    """Group the patches of an image by similarity: for every step-th pixel, the most similar patches of its window.

    Parameters
    ----------
    image : array
        Two or more axes, not counting the channels; for :meth:`PatchGroups.step` an image without much noise, such as
        the result of :func:`gpureg.denoise_image` with quality="fast" (by default it takes such steps itself).
    patch_radius : int, default 3
        Patches are squares with a side of 2 patch_radius + 1 pixels; cubes in a volume, where 1 is a good value.
    radius : float, default 19
        Radius of the square window, in the units of `spacing`.
    step : int, default 4
        Every step-th pixel along an axis has a group, and the last one.
    k : int, default 40
        Number of patches that a group has at least, its own included; all patches of a window that has fewer.
    most : int, default 80
        Number of patches that a group has at most, at least `k`. Of more, as many are taken at equal distances in
        row-major order.
    flat : float or array, default 0
        Patches whose mean squared difference from the group's own is at most this are members too, also more than
        `k`, in the image's units squared: a number, or one per pixel. (0.15 sigma)^2 is good for noise sigma.
    guide : array, optional
        The image that the patches compare instead of `image`: of its shape, or with other channels.
    mask : bool array, optional
        True where a pixel takes part: the others have no group and are no members, and may be NaN.
    spacing : tuple of float, optional
        Size of a pixel along each axis; None means 1. Patches and `step` count pixels.
    channel_axis : int, optional
        Axis of the channels, which are compared together.
    backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`. There are no iterations: a callback is never called.

    Returns
    -------
    PatchGroups
        The members of each group, and the step that estimates their patches.

    Raises
    ------
    TypeError, ValueError
        An argument out of its range, or values that are not real and finite.
    BackendUnavailable
        A backend or device that is not available; OpenCL has at most three axes and 65536 pixels of a window.
    MemoryError
        Groups that need more than `memory`.

    Warns
    -----
    UserWarning
        As :func:`gpureg.denoise_image`.

    Notes
    -----
    The group of u are the pixels v of the window with d(u, v) <= max(d_k, flat), where d is the mean squared difference
    of the patches, over their cells and channels, and d_k the k-th smallest. Patches that cross the border are filled
    by reflection. Section 3a of the page on mathematics derives the step.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> clean = np.kron([[0.2, 0.8], [0.8, 0.2]], np.ones((16, 16)))
    >>> noisy = clean + np.random.default_rng(7).normal(0, 0.1, clean.shape)
    >>> pilot = gr.denoise_nl_means(noisy, h=0.5, sigma=0.1, backend="numpy")
    >>> groups = gr.patch_groups(pilot, patch_radius=2, radius=9, flat=0.015**2, backend="numpy")
    >>> groups.to_scipy().shape
    (81, 1024)
    >>> better = groups.step(noisy, sigma=0.1)
    >>> bool(np.std(better - clean) < np.std(pilot - clean) < np.std(noisy - clean) / 3)
    True
    """
    asked = cast("OnPixels", ON_PIXELS | options)
    raster = Raster.of(image, asked["channel_axis"], asked["mask"])
    check_run(asked)
    patch_radius = integer("patch_radius", patch_radius, low=0)
    step, k = integer("step", step, low=1), integer("k", k, low=1)
    if integer("most", most) < k:
        raise ValueError(f"most must be at least k = {k}, got {most}")
    number("radius", radius, above=0)
    window = GridGraph(raster.shape, radius, spacing=asked["spacing"])
    limit = on_pixels("flat", map_of("flat", flat, raster.shape, low=0), raster.inside)
    if not (limit >= 0).all():
        raise ValueError(f"flat must be >= 0 wherever a pixel takes part, got {limit.min()}")
    graph = GridGraph(raster.shape, mask=raster.inside)
    if asked["guide"] is None:
        compared = as_function(graph, pixels_filled(raster), "image")
    else:
        compared = as_function(graph, guide_values(asked["guide"], graph, asked["channel_axis"]), "guide")
    frame = Frame.of(compared)
    # the root first: squares of small units are not numbers
    limit = np.minimum(np.sqrt(limit) / frame.scale, LARGEST) ** 2
    highest = float(limit.max())
    # beyond an axis of one pixel there are only copies of it
    radii = tuple(patch_radius if size > 1 else 0 for size in raster.shape)
    reach = tuple(np.abs(window.offsets).max(axis=0, initial=0).tolist())
    form = GroupForm(radii, reach, (step,) * raster.ndim, k, most, highest)
    device = backends.get(asked["backend"], raster.computed_type(asked["dtype"]))
    _check_memory(device, graph, compared.shape[1], form, asked["memory"])
    level = limit / highest if limit.size > 1 and highest > 0 else None
    found = device.patch_groups(graph, frame.into(compared, device.dtype), form, level=level)
    return PatchGroups.of(found, device, compared, asked["channel_axis"])


def _check_memory(device: Backend, graph: GridGraph, channels: int, form: GroupForm, memory: int | None) -> None:
    """Raise a MemoryError if the groups, the functions of a step and their sums do not fit."""
    members = np.dtype(np.int32).itemsize * math.prod(form.counts(graph.shape)) * (form.most + 1)
    need = members + device.function_bytes(graph, 4 * channels + 2)
    allowed = budget(device, memory).total
    if need > allowed:
        raise MemoryError(
            f"the groups need {readable(need)} and may use {readable(allowed)}: give a larger memory or a part of the "
            "image"
        )
