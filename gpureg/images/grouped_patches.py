"""The groups that :func:`gpureg.patch_groups` finds, and the step whose fidelity is a matrix for each of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, frozen
from ..backends import Backend
from ..backends.groups import GroupForm, Groups
from ..checks import integer
from ..doors import door
from ..frame import Frame
from ..model.problem import as_function
from .guides import filled, guide_values
from .options import map_of
from .raster import Raster

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Squares of numbers up to this size and down to its reciprocal, and sums of many of them, are numbers of float32.
LARGEST = 2.0**40


@dataclass(frozen=True, eq=False, repr=False)
class PatchGroups:
    """The groups of similar patches of an image, as :func:`gpureg.patch_groups` finds them.

    Attributes
    ----------
    shape : tuple of int
        Shape of the image without its channels.
    form : GroupForm
        Radii of a patch, `patch`, and of the window, `window`, and the step between references, `step`, along each
        axis in pixels.
    references : (n_references,) int array
        The pixels that groups belong to, as row-major numbers; the groups of those outside the mask are empty.
    indptr : (n_references + 1,) int array
    indices : (n_members,) int array
        The members of group i are the pixels ``indices[indptr[i]:indptr[i + 1]]``, in increasing order.
    """

    shape: tuple[int, ...]
    form: GroupForm
    references: IntArray
    indptr: IntArray
    indices: IntArray
    _groups: Groups
    _device: Backend
    _compared: FloatArray
    _channel_axis: int | None

    @classmethod
    def of(cls, groups: Groups, device: Backend, compared: FloatArray, channel_axis: int | None) -> PatchGroups:
        """Make the groups that a device found.

        Parameters
        ----------
        groups : Groups
        device : Backend
        compared : (n, q) array
            The values that the patches compare, in the units of the data.
        channel_axis : int or None
            The axis of the channels in the image.
        """
        graph, form = groups.graph, groups.form
        members, sizes = device.get_groups(groups)
        references = form.references(graph.shape)
        jumps = form.offsets() @ graph.strides
        rows, places = np.nonzero(np.arange(form.most) < sizes[:, None])
        indices = references[rows] + jumps[members[rows, places]]
        indptr = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
        arrays = (frozen(references), frozen(indptr), frozen(indices))
        return cls(graph.shape, form, *arrays, groups, device, compared, channel_axis)

    def __repr__(self) -> str:
        return f"PatchGroups(shape={self.shape}, {len(self.references)} groups, {len(self.indices)} members)"

    def __copy__(self) -> PatchGroups:
        """Return the groups themselves, which do not change."""
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> PatchGroups:
        """Return the groups themselves, which do not change."""
        return self

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Raise a TypeError: the groups are in the memory of a device."""
        raise TypeError(
            "PatchGroups cannot be pickled, because a device holds them: keep to_scipy(), or call gpureg.patch_groups "
            "again"
        )

    def to_scipy(self) -> csr_array:
        """Return the members as a matrix of ones, (n_references, n_pixels)."""
        from scipy import sparse

        shape = len(self.references), self._groups.graph.n_vertices
        return sparse.csr_array((np.ones(len(self.indices)), self.indices, self.indptr), shape=shape)

    @door(name="PatchGroups.fidelity")
    def fidelity(self, group: int, sigma: float | npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Compute the fidelity of a group: the ratio of the signal's covariance to the noise's.

        Parameters
        ----------
        group : int
            Number of the group, 0..n_references - 1.
        sigma : float or array
            Standard deviation of the noise, as in :meth:`step`.

        Returns
        -------
        (q, M, M) float64 array
            For each channel that the patches compare the matrix Lam = C S^-1, for the M cells of a patch in row-major
            order: C is the covariance of the patches in the group, S the noise's, diagonal. With it, the new values of
            a patch a of the noisy image are (Lam + I)^-1 (Lam a + m), where m is the mean of the group's patches there.

        Raises
        ------
        TypeError, ValueError
            No such group, or one without members; a sigma as in :meth:`step`.

        Examples
        --------
        >>> import numpy as np, gpureg as gr
        >>> steps = np.tile([0.0, 0.0, 1.0, 1.0], (8, 2))
        >>> groups = gr.patch_groups(steps, patch_radius=0, radius=3, k=49, most=49, backend="numpy")
        >>> lam = groups.fidelity(0, sigma=0.5)  # 16 patches, half of them 0 and half of them 1
        >>> lam.shape, bool(np.isclose(lam[0, 0, 0], 16 / 15 * 0.25 / 0.5**2))
        ((1, 1, 1), True)
        """
        group = integer("group", group, low=0, high=len(self.references) - 1)
        noise = self._noise(sigma)
        members = self.indices[self.indptr[group] : self.indptr[group + 1]]
        if not len(members):
            raise ValueError(f"group {group} has no members: its pixel {self.references[group]} is outside the mask")
        cells = self._cells(members)
        unit = float(noise.max())
        shares = np.broadcast_to(noise / unit, self._groups.graph.n_vertices)[cells]
        patches = self._compared.astype(np.float64)[cells]
        deviations = np.moveaxis(patches - patches.mean(axis=0), -1, 0) / unit
        covariance = deviations.swapaxes(1, 2) @ deviations / max(len(members) - 1, 1)
        lam: npt.NDArray[np.float64] = covariance / np.mean(shares**2, axis=0)
        return lam

    @door(name="PatchGroups.step")
    def step(
        self, image: npt.ArrayLike, sigma: float | npt.ArrayLike, *, guide: npt.ArrayLike | None = None
    ) -> npt.NDArray[Any]:
        """Denoise an image by one step whose fidelity is the matrix of each group.

        Parameters
        ----------
        image : array
            The noisy image, of the shape that the groups were made for; the number of channels may be another one.
        sigma : float or array
            Standard deviation > 0 of the noise: a number, or one per pixel; axes of length 1 are repeated.
        guide : array, optional
            The image whose patches give the covariances, in the axes and channels of `image`; None means the image that
            the patches compare.

        Returns
        -------
        array
            In the shape and dtype of `image`; integers are rounded and clipped. Pixels outside the mask are unchanged,
            and those that no patch of a member covers are those of the guide.

        Raises
        ------
        TypeError, ValueError
            An image or a guide of another shape, or with values that are not real and finite; a sigma that is not > 0.

        Notes
        -----
        A group whose signal is too large beside the noise to be told from rounding errors, with trace C > 2e6 min S in
        float32 (1e15 in float64), takes the patches of the guide.
        """
        graph, device = self._groups.graph, self._device
        raster = Raster.of(image, self._channel_axis, graph.mask, axes_known=True)
        if raster.shape != self.shape:
            raise ValueError(f"image must have the {self.shape} pixels of the groups, got {raster.shape}")
        noise = self._noise(sigma)
        noisy = as_function(graph, pixels_filled(raster), "image")
        pilot = self._compared
        if guide is not None:
            pilot = as_function(graph, guide_values(guide, graph, self._channel_axis), "guide")
        if pilot.shape != noisy.shape:
            raise ValueError(
                f"the image has {noisy.shape[1]} channel(s) and {'the guide' if guide is not None else 'the groups'} "
                f"{pilot.shape[1]}: give a guide that has those of the image"
            )
        frame = Frame.of(noisy)
        variance = np.clip(noise / frame.scale, 1 / LARGEST, LARGEST) ** 2
        given = float(variance[0]) if len(variance) == 1 else variance
        f0, compared = (frame.into(values, device.dtype) for values in (noisy, pilot))
        found = device.get(graph, device.group_step(self._groups, f0, compared, given))
        return raster.like(frame.back(found, noisy.dtype).reshape(*self.shape, -1))

    def _noise(self, sigma: float | npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Check the noise; return it as one number, (1,), or one per pixel, (n,)."""
        mask = self._groups.graph.mask
        array = np.asarray(sigma)
        if array.ndim == len(self.shape) and all(a in (1, b) for a, b in zip(array.shape, self.shape, strict=True)):
            array = np.broadcast_to(array, self.shape)
        checked = map_of("sigma", sigma if array.ndim == 0 else array, self.shape, above=0)
        noise = on_pixels("sigma", checked, mask)
        if not (noise > 0).all():
            raise ValueError(f"sigma must be > 0 wherever a pixel takes part, got {noise.min()}")
        return noise

    def _cells(self, members: IntArray) -> IntArray:
        """Return the pixels of the patches of some members, (N, M), reflected at the border."""
        at = np.stack(np.unravel_index(members, self.shape), axis=1)
        steps = np.indices([2 * r + 1 for r in self.form.patch]).reshape(len(self.shape), -1).T - self.form.patch
        cells = []
        for axis, size in enumerate(self.shape):
            period = max(2 * (size - 1), 1)
            place = np.abs(at[:, None, axis] + steps[None, :, axis]) % period
            cells.append(np.minimum(place, period - place) if size > 1 else np.zeros_like(place))
        return np.ravel_multi_index(tuple(cells), self.shape)


def pixels_filled(raster: Raster) -> FloatArray:
    """Return the pixels of an image, (..., m); outside the mask those of the nearest inside."""
    values = raster.pixels()
    return values if raster.inside is None or raster.whole else filled(values, raster.inside)


def on_pixels(
    name: str, value: float | npt.NDArray[Any], inside: npt.NDArray[np.bool_] | None
) -> npt.NDArray[np.float64]:
    """Return a number, (1,), or a map, (n,), in which the pixels outside the mask have values of the nearest inside."""
    table = np.asarray(value, np.float64)
    if table.ndim == 0:
        return table.reshape(1)
    if inside is not None and not inside.all():
        table = filled(table, inside) if inside.any() else np.ones_like(table)
    if not np.isfinite(table).all():
        raise ValueError(f"{name} must be finite wherever a pixel takes part")
    return table.ravel()
