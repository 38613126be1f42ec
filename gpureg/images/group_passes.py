"""Make the passes of a plan on groups of similar patches: :func:`after_passes`."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from .. import backends
from ..backends import Backend, Chosen
from ..graphs.grid import GridGraph
from ..progress import progress_bar
from .grouped_patches import LARGEST
from .guides import filled
from .passes import PassNoise, PatchPass
from .prepare import Prepared

# RGB as brightness and two opponent colours, orthonormal, so that white noise of equal channels stays white.
_OPPONENT = np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]])


def after_passes(
    ready: Prepared,
    pilot: npt.NDArray[np.floating],
    inside: npt.NDArray[np.bool_] | None,
    *,
    backend: Chosen,
    dtype: npt.DTypeLike,
    progress: bool = False,
) -> npt.NDArray[np.floating]:
    """Estimate an image from groups of patches, which the result of a filter tells; return it like the result.

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
    Where lam is 0 there are no data, and the filter's result takes their place. Where lam is infinite the data remain.
    """
    noise, lam = ready.plan.noise, np.asarray(ready.plan.lam)
    assert noise is not None
    device = backends.get(backend, dtype)
    grid = GridGraph(pilot.shape[:-1], 1, mask=inside)
    masked = inside is not None and not inside.all()
    data = ready.pixels
    lam = lam.reshape(grid.shape)[..., None] if lam.ndim else lam
    if lam.ndim and (lam == 0).any():
        data = np.where(lam == 0, pilot, data)
    into = _Units(noise, pilot.shape[-1], device)
    f0, guide = into.function(_known(data, inside if masked else None)), into.function(pilot)
    # its square, and sums of many of them, are numbers of float32
    sigma = min(max(noise.level / noise.frame.scale, 1 / LARGEST), LARGEST)
    level = None if ready.profile is None else ready.profile.ravel() ** 2
    variance = sigma**2 if level is None else sigma**2 * level
    with progress_bar(progress, len(ready.plan.passes), "passes") as done:
        for i, each in enumerate(ready.plan.passes):
            done(i)
            if masked:
                guide = _known(guide.reshape(*grid.shape, -1), inside).reshape(guide.shape)
            groups = device.patch_groups(grid, guide[:, : into.compared], each.form(sigma), level=level)
            guide = device.get(grid, device.group_step(groups, f0, guide, variance))
        done(len(ready.plan.passes))
    value = into.back(guide, pilot)
    return np.where(np.isinf(lam), ready.pixels.astype(value.dtype), value) if np.isinf(lam).any() else value


def bytes_of_passes(passes: tuple[PatchPass, ...], grid: GridGraph, channels: int, device: Backend) -> int:
    """Return the bytes of the largest pass on a grid, on the device and in the process."""
    n, size = grid.n_vertices, device.dtype.itemsize
    # data, guide and result in the process; both, sums, counts, the noise and the result on the device
    planes = 3 * channels + (0 if device.device.kind == "gpu" else 4 * channels + 2)
    members = [math.prod(each.form(0.0).counts(grid.shape)) * (each.most + 1) * 4 for each in passes]
    return n * size * planes + max(members)


class _Units:
    """The conversion between an image in the units of a plan, and the function with which passes compute."""

    def __init__(self, noise: PassNoise, channels: int, device: Backend) -> None:
        self._units = np.array(noise.units) if noise.units else None
        self._frame, self._type = noise.frame, device.dtype
        self._turn = _OPPONENT.astype(device.dtype) if channels == 3 else None
        # the third opponent colour adds noise to the distances, and little that the others do not tell
        self.compared = 2 if channels == 3 else channels

    def function(self, image: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
        """Return the function (n, m) of an image (..., m)."""
        values = image.reshape(-1, image.shape[-1])
        f = self._frame.into(values if self._units is None else values / self._units, self._type)
        return f if self._turn is None else _turned(f, self._turn)

    def back(self, f: npt.NDArray[np.floating], like: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
        """Return the image of a function, in the shape and type of another image."""
        g = f if self._turn is None else _turned(f, self._turn.T)
        values = self._frame.back(g, like.dtype).reshape(like.shape)
        return values if self._units is None else (values * self._units).astype(like.dtype)


def _turned(f: npt.NDArray[np.floating], matrix: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Multiply the channels of a function by a matrix; the sums are in the same order for any number of vertices."""
    return np.stack([sum(row[c] * f[:, c] for c in range(f.shape[1])) for row in matrix], axis=1)


def _known(values: npt.NDArray[np.floating], inside: npt.NDArray[np.bool_] | None) -> npt.NDArray[np.floating]:
    """Return values (..., m), those outside a mask replaced by the nearest inside."""
    return values if inside is None else filled(values, inside)
