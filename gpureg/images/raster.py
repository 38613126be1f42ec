"""Conversion between an image and a function on the cells of a grid: :class:`Raster`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import all_finite, held_type, into_integers, unmasked
from ..checks import integer
from ..doors import warn
from ..frame import Frame

# The last axis looks like channels if the two axes before it are at least this many times as long.
FAR = 8
# Integers up to this are exact in float64.
_EXACT = 1 << 53


@dataclass(frozen=True, eq=False)
class Raster:
    """A checked image, as a function on the cells of a grid.

    Attributes
    ----------
    values : array
        The given image: the axes of the grid, and an axis of channels if there is one.
    inside : bool array or None
        True where a cell takes part, in the shape of the grid; None for everywhere.
    channel_axis : int or None
        The axis of the channels in `values`; None for a grey image.
    """

    values: npt.NDArray[Any]
    inside: npt.NDArray[np.bool_] | None = None
    channel_axis: int | None = None

    @classmethod
    def of(
        cls,
        image: npt.ArrayLike | Raster,
        channel_axis: int | None = None,
        mask: npt.ArrayLike | None = None,
        *,
        axes_known: bool = False,
    ) -> Raster:
        """Check an image, its axis of channels and its mask; a raster is returned unchanged.

        Parameters
        ----------
        image : array or Raster
            Two or more axes, not counting the channels; integers or real numbers, finite wherever the mask is True.
        channel_axis : int, optional
            The axis of the channels; None for a grey image.
        mask : bool array, optional
            True where a cell takes part, in the shape of the image without its channels.
        axes_known : bool, default False
            Whether the axis of channels is already known: then there is no warning.

        Raises
        ------
        TypeError, ValueError
            Values, axis or mask that are not as described.

        Warns
        -----
        UserWarning
            An array without `channel_axis` that looks like a colour image: the last of three or more axes has 3 or 4
            cells, the two before it at least 8 times as many. It is processed as a volume. Also integers beyond 2^53.
        """
        if isinstance(image, Raster):
            return image
        array = unmasked(image, "image")
        if array.dtype.kind not in "iuf":
            raise TypeError(f"image must hold integers or real numbers, got {array.dtype}{_instead(array)}")
        if channel_axis is not None:
            channel_axis = integer("channel_axis", channel_axis, low=-array.ndim, high=array.ndim - 1)
        raster = cls(array, None, channel_axis)
        if raster.ndim < 2:
            raise ValueError(f"image must have two or more axes without the channels, got shape {array.shape}")
        if not array.size:
            raise ValueError(f"image is empty, shape {array.shape}")
        known = raster.cells
        if mask is not None:
            inside = np.asarray(mask)
            if inside.dtype != np.bool_ or inside.shape != raster.shape:
                raise ValueError(
                    f"mask must be boolean of shape {raster.shape}, got {inside.dtype} of shape {inside.shape}"
                )
            raster, known = cls(array, inside, channel_axis), known[inside]
        if not all_finite(known):
            bad = known[~np.isfinite(known)]
            raise ValueError(f"image must be finite, got {bad[0]} at {len(bad)} place(s); a mask can leave them out")
        if known.size and array.dtype.kind in "iu" and array.dtype.itemsize == 8:
            if max(int(known.max()), -int(known.min())) > _EXACT:
                warn("the image holds integers beyond 2^53, which float64 rounds: subtract an offset first")
        if channel_axis is None and not axes_known and _looks_coloured(array.shape):
            warn(
                f"the image of shape {array.shape} is taken for a volume: channel_axis=-1 makes its last axis one of "
                "channels"
            )
        return raster

    @property
    def cells(self) -> npt.NDArray[Any]:
        """The values with the channels last, a view, (..., m)."""
        if self.channel_axis is None:
            return self.values[..., None]
        return np.moveaxis(self.values, self.channel_axis, -1)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the grid, i.e. of the image without its channels."""
        return self.cells.shape[:-1]

    @property
    def ndim(self) -> int:
        """The number of axes of the grid."""
        return self.values.ndim - (self.channel_axis is not None)

    @property
    def channels(self) -> int:
        """The number of channels, m."""
        return 1 if self.channel_axis is None else self.values.shape[self.channel_axis]

    def only(self, channels: Sequence[int]) -> Raster:
        """Return the image of some channels."""
        if self.channel_axis is None:
            return self
        return Raster(np.take(self.values, channels, axis=self.channel_axis), self.inside, self.channel_axis)

    @property
    def thin_axes(self) -> tuple[int, ...]:
        """The axes of the grid that have length 1, besides the two longest axes."""
        thin = [axis for axis, size in enumerate(self.shape) if size == 1]
        return tuple(thin[: max(0, self.ndim - 2)])

    def without_thin_axes(self) -> Raster:
        """Return the same image without :attr:`thin_axes`, a view with the channels last."""
        if not self.thin_axes:
            return self
        cells = self.cells.squeeze(self.thin_axes)
        inside = None if self.inside is None else self.inside.squeeze(self.thin_axes)
        return Raster(cells[..., 0], inside) if self.channel_axis is None else Raster(cells, inside, -1)

    @property
    def whole(self) -> bool:
        """Whether every cell takes part."""
        return self.inside is None or bool(self.inside.all())

    def pixels(self, dtype: npt.DTypeLike | None = None) -> npt.NDArray[np.floating[Any]]:
        """Return the cells as floats that hold them, (..., m): float64 or wide integers as float64, others as float32.

        Parameters
        ----------
        dtype : dtype, optional
            The type to compute in; at least of this type. The model subtracts an offset before it computes in float32.
        """
        return self.cells.astype(held_type(self.values.dtype, self.computed_type(dtype)), copy=False)

    def computed_type(self, dtype: npt.DTypeLike | None) -> np.dtype[Any]:
        """Return `dtype`, checked; for None float32, or float64 for integers of more than 16 bits."""
        wide = self.values.dtype.kind in "iu" and self.values.dtype.itemsize > 2
        kind = np.dtype(dtype) if dtype is not None else np.dtype(np.float64 if wide else np.float32)
        if kind.newbyteorder("=") not in (np.float32, np.float64):
            raise ValueError(f"dtype must be float32 or float64, got {kind}")
        return kind

    def chosen_type(self, dtype: npt.DTypeLike | None) -> np.dtype[Any] | None:
        """Return `dtype`, checked; for None float64 for integers of more than 16 bits, otherwise None."""
        kind = self.computed_type(dtype)
        return None if dtype is None and kind == np.float32 else kind

    def frame(self, units: Sequence[float] | None = None) -> Frame:
        """Choose the offset and the unit of the values, divided by the units of the channels, from about 2^16 cells."""
        values = self.cells.reshape(-1, self.channels)
        if self.inside is not None:
            values = values[self.inside.ravel()]
        some = values[:: max(1, len(values) >> 16)].astype(np.float64)
        return Frame.of(some if units is None else some / np.asarray(units))

    def like(self, value: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Convert a function on the cells to an image with the axes, type and masked pixels of this one.

        Parameters
        ----------
        value : (..., m) array
            Rounded and clipped if the image has an integer type.
        """
        image = value[..., 0] if self.channel_axis is None else np.moveaxis(value, -1, self.channel_axis)
        image = into_integers(np.ascontiguousarray(image), self.values.dtype)
        return image if self.whole or self.inside is None else self.unchanged(image, ~self.inside)

    def unchanged(self, image: npt.NDArray[Any], where: npt.NDArray[np.bool_]) -> npt.NDArray[Any]:
        """Return an image of this shape and type, with the given values at some cells of the grid."""
        if self.channel_axis is not None:
            where = np.expand_dims(where, self.channel_axis)
        return np.where(where, self.values, image)


def _instead(array: npt.NDArray[Any]) -> str:
    """Say how an image of truth values or of complex numbers is given."""
    if array.dtype == np.bool_:
        return ": give image.astype(numpy.float32), and compare the result with 0.5"
    if array.dtype.kind == "c":
        return ": give both parts as channels, numpy.stack([image.real, image.imag], axis=-1) with channel_axis=-1"
    return ""


def _looks_coloured(shape: tuple[int, ...]) -> bool:
    """Return whether the last axis looks like channels."""
    return len(shape) > 2 and shape[-1] in (3, 4) and min(shape[-3:-1]) >= FAR * shape[-1]
