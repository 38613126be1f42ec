"""Make the passes of a plan on groups of similar patches: :func:`after_filter`, :func:`after_passes`."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from .. import backends
from ..backends import Array, Backend, Chosen
from ..graphs.grid import GridGraph
from ..progress import progress_bar
from .grouped_patches import LARGEST
from .guides import filled
from .passes import PatchPass, many, patches_of, windows_of
from .plan import DenoisePlan
from .prepare import Prepared

# RGB as brightness and two opponent colours, orthonormal, so that white noise of equal channels stays white.
_OPPONENT = np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]])


def suits_passes(plan: DenoisePlan) -> bool:
    """Return whether the passes of a plan compute in the units of its filter, so that its result can stay as it is."""
    noise = plan.noise
    return not plan.passes or noise is None or (noise.frame == plan.frame and not noise.units)


def method_of(plan: DenoisePlan, filter_: str) -> str:
    """Describe the filter of a plan, and its passes."""
    passes = plan.passes
    return f"{filter_} Then {many(passes)} on groups of similar patches: {patches_of(passes)}, {windows_of(passes)}."


def after_filter(
    device: Backend,
    grid: GridGraph,
    data: Array,
    pilot: Array,
    plan: DenoisePlan,
    *,
    profile: npt.NDArray[np.float64] | None,
    progress: bool = False,
) -> Array:
    """Estimate device data from groups of patches, which the result of a filter tells; return a device function.

    Parameters
    ----------
    device : Backend
    grid : GridGraph
        That of the functions, with the mask of the image, outside of which the data are those of the nearest cell
        inside.
    data, pilot : Array
        The data and the filter's result, in the units of the frame of the plan's noise.
    plan : DenoisePlan
    profile : array or None
        Noise of each pixel as a multiple of that of the image.
    progress : bool
        Show a bar.

    Notes
    -----
    Where lam is 0 there are no data, and the filter's result takes their place.
    """
    noise, lam = plan.noise, np.asarray(plan.lam, np.float64)
    assert noise is not None
    inside = None if grid.mask is None or grid.mask.all() else grid.mask
    if lam.ndim and (lam == 0).any():
        data = _known(device, grid, _chosen(device, grid, data, pilot, lam.ravel() == 0), inside)
    coloured = device.channels(data) == 3
    guide = pilot
    if coloured:
        data, guide = (device.mix(grid, f, _OPPONENT) for f in (data, guide))
    # its square, and sums of many of them, are numbers of float32
    sigma = min(max(noise.level / noise.frame.scale, 1 / LARGEST), LARGEST)
    level = None if profile is None else profile.ravel() ** 2
    variance = sigma**2 if level is None else device.put(grid, (sigma**2 * level)[:, None])
    levels = None if level is None else device.put(grid, level[:, None])
    with progress_bar(progress, len(plan.passes), "passes") as done:
        for i, each in enumerate(plan.passes):
            done(i)
            guide = _known(device, grid, guide, inside)
            # the third opponent colour adds noise to the distances, and little that the others do not tell
            compared = device.mix(grid, guide, np.eye(2, 3)) if coloured else guide
            groups = device.patch_groups(grid, compared, each.form(sigma), level=levels)
            guide = device.group_step(groups, data, guide, variance)
        done(len(plan.passes))
    return device.mix(grid, guide, _OPPONENT.T) if coloured else guide


def after_passes(
    ready: Prepared,
    pilot: npt.NDArray[np.floating],
    inside: npt.NDArray[np.bool_] | None,
    *,
    backend: Chosen,
    dtype: npt.DTypeLike,
    progress: bool = False,
) -> npt.NDArray[np.floating]:
    """Estimate an image as :func:`after_filter`, from a result on the host; return it like the result.

    Parameters
    ----------
    ready : Prepared
        The image and its plan, with the map of its noise.
    pilot : (..., m) array
        The result of the plan's filter, in the units of ``ready.pixels``.
    inside : bool array or None
        True where a pixel takes part.
    backend, dtype, progress
        As in :func:`gpureg.regularize`; the type to compute in.

    Notes
    -----
    Where lam is infinite the data remain.
    """
    noise, lam = ready.plan.noise, np.asarray(ready.plan.lam)
    assert noise is not None
    device = backends.get(backend, dtype)
    grid = GridGraph(pilot.shape[:-1], 1, mask=inside)
    lam = lam.reshape(grid.shape)[..., None] if lam.ndim else lam
    data = ready.pixels if inside is None or inside.all() else filled(ready.pixels, inside)
    f0, guide = (device.put_cells(grid, x, frame=noise.frame, units=noise.units) for x in (data, pilot))
    value = np.empty_like(pilot)
    found = after_filter(device, grid, f0, guide, ready.plan, profile=ready.profile, progress=progress)
    device.get_cells(grid, found, value, frame=noise.frame, units=noise.units)
    return np.where(np.isinf(lam), ready.pixels.astype(value.dtype), value) if np.isinf(lam).any() else value


def bytes_of_passes(passes: tuple[PatchPass, ...], grid: GridGraph, channels: int, device: Backend) -> int:
    """Return the bytes of the largest pass on a grid, on the device and in the process."""
    n, size = grid.n_vertices, device.dtype.itemsize
    # data, guide and result in the process; both, sums, counts, the noise and the result on the device
    planes = 3 * channels + (0 if device.device.kind == "gpu" else 4 * channels + 2)
    members = [math.prod(each.form(0.0).counts(grid.shape)) * (each.most + 1) * 4 for each in passes]
    return n * size * planes + max(members)


def _chosen(device: Backend, grid: GridGraph, f: Array, other: Array, where: npt.NDArray[np.bool_]) -> Array:
    """Return a device function that is `other` at some vertices, (n,), and `f` at the others, without rounding."""
    parts = []
    for x, left_out in ((f, where), (other, ~where)):
        # a quotient by infinity is 0
        over = device.put(grid, np.where(left_out, np.inf, 1.0)[:, None])
        parts.append(device.combine(grid, 0.0, x, 1.0, x, over=over))
    return device.combine(grid, 1.0, parts[0], 1.0, parts[1])


def _known(device: Backend, grid: GridGraph, f: Array, inside: npt.NDArray[np.bool_] | None) -> Array:
    """Return a device function, its values outside a mask replaced by the nearest inside; the host looks for them."""
    if inside is None:
        return f
    values = device.get(grid, f).reshape(*grid.shape, -1)
    return device.put(grid, filled(values, inside).reshape(grid.n_vertices, -1))
