"""The primitives with which an image crosses to a device and back, and is blurred and mixed there.

Between the two an image stays on the device: it is converted, transposed, rounded and clipped there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, held_type, into_integers
from ..exchange import Memory
from ..frame import AS_GIVEN, Frame
from ..graphs.grid import AnyGraph, GridGraph
from .data import Data
from .types import Array


class CellPrimitives(Data):
    """The primitives of images; those of a host array are the reference for the devices."""

    def put_cells(
        self, grid: GridGraph, cells: npt.NDArray[Any], *, frame: Frame = AS_GIVEN, units: Sequence[float] = ()
    ) -> Array:
        """Copy the cells of an image to the device, as a function in the units of a frame.

            f_c(u) = (x_c(u)/unit_c - offset_c)/scale

        The quotient x/unit is rounded to the type that holds the image (:func:`gpureg.arrays.held_type`), the function
        once, to the backend's type.

        Parameters
        ----------
        grid : GridGraph
        cells : (*grid.shape, m) array
            Integers or real numbers of any type, with any strides.
        frame : Frame
            The offset of each channel, and the scale.
        units : sequence of m floats
            What the channels are divided by; empty for 1.
        """
        if self._crosses(cells.dtype, frame):
            out = self._target(grid, cells.shape[-1])
            self._cross(grid, cells, out, frame, units)
            return out
        x = cells.reshape(grid.n_vertices, -1)
        values = x.astype(held_type(x.dtype, self.dtype), copy=False)
        if len(units):
            values = values / np.asarray(units, values.dtype)
        return self.put(grid, frame.into(values, self.dtype))

    def get_cells(
        self,
        grid: GridGraph,
        f: Array,
        out: npt.NDArray[Any],
        *,
        frame: Frame = AS_GIVEN,
        units: Sequence[float] = (),
    ) -> None:
        """Write a device function, in the units of a frame, into the cells of an image.

            x_c(u) = (scale f_c(u) + offset_c) unit_c

        The sum is rounded to the type that holds the image. Integers are rounded to the nearest, of two the even one,
        and clipped.

        Parameters
        ----------
        grid : GridGraph
        f : Array
        out : (*grid.shape, m) array
            An image of any type, with any strides.
        frame, units
            As in :meth:`put_cells`.
        """
        if self._crosses(out.dtype, frame):
            self._cross(grid, out, f, frame, units, back=True)
            return
        values = frame.back(self.get(grid, f), held_type(out.dtype, self.dtype))
        if len(units):
            values = values * np.asarray(units, values.dtype)
        out[...] = into_integers(values, out.dtype).reshape(out.shape)

    def reads(self, memory: Memory) -> bool:
        """Return whether :meth:`put_memory` can use data where they lie."""
        return False

    def _crosses(self, kind: np.dtype[Any], frame: Frame) -> bool:
        """Return whether kernels convert images of this type, with no more rounding than the host."""
        return False

    def _target(self, grid: GridGraph, channels: int) -> Array:
        """Allocate a function that :meth:`_cross` writes."""
        return self.empty(grid, channels)

    def _cross(
        self,
        grid: GridGraph,
        image: npt.NDArray[Any],
        f: Array,
        frame: Frame,
        units: Sequence[float],
        *,
        back: bool = False,
    ) -> None:
        """Convert the cells of an image, (*shape, m), to a function; or with `back` the function to the cells."""
        raise NotImplementedError(f"{self!r} leaves the conversion of images to the host")

    def put_memory(self, graph: AnyGraph, memory: Memory, frame: Frame, *, fresh: bool = False) -> Array:
        """Return data on the device, (n, m), as a function in the units of a frame, without the host.

        Parameters
        ----------
        graph : Graph or GridGraph
        memory : Memory
            Numbers of n m channels, in the order of the vertices.
        frame : Frame
            As in :meth:`put_cells`.
        fresh : bool, default False
            Whether the function has memory of its own. If not, it is `memory` where nothing is to be converted.
        """
        raise NotImplementedError(f"{self!r} has no memory of Warp")

    def get_memory(self, graph: AnyGraph, f: Array, frame: Frame, dtype: npt.DTypeLike) -> Any:
        """Return a function, in the units of a frame, as data on the device: what ``Memory.numbers`` is, (n m,).

        The data are of this type, rounded as in :meth:`get_cells`.
        """
        raise NotImplementedError(f"{self!r} has no memory of Warp")

    def blur(self, grid: GridGraph, f: Array, taps: Sequence[FloatArray]) -> Array:
        """Convolve a device function along each axis with a symmetric kernel.

            out(u) = sum_j taps[|j|] f(u + j e_axis)          along the first axis, then along the others

        Cells beyond the grid are reflected, without repeating the edge cell. A mask has no influence.

        Parameters
        ----------
        grid : GridGraph
        f : Array
        taps : sequence of (r + 1,) arrays
            For each axis the middle of its kernel, and the values after it.
        """
        from scipy import ndimage

        values = self.get(grid, f).reshape(*grid.shape, -1)
        for axis in range(grid.ndim):
            if len(taps[axis]) > 1:
                kernel = np.concatenate([taps[axis][:0:-1], taps[axis]])
                values = ndimage.correlate1d(values, kernel, axis, mode="mirror")
        return self.put(grid, values.reshape(grid.n_vertices, -1))

    def mix(self, graph: AnyGraph, f: Array, matrix: FloatArray) -> Array:
        """Multiply the channels of a device function by a matrix (q, m): out_q(u) = sum_c matrix[q, c] f_c(u)."""
        values = self.get(graph, f)
        factors = np.asarray(matrix, self.dtype)
        # a sum in the order of the channels, for any number of vertices
        mixed = [sum(row[c] * values[:, c] for c in range(values.shape[1])) for row in factors]
        return self.put(graph, np.stack(mixed, axis=1))

    def on_device(self, graph: AnyGraph, f: Array | FloatArray) -> Array:
        """Return a device function, or copy a host function (n, m) to the device."""
        return self.put(graph, f) if isinstance(f, np.ndarray) else f

    def on_host(self, graph: AnyGraph, f: Array | FloatArray) -> FloatArray:
        """Return a host function (n, m) in the backend's type, or copy a device function to the host."""
        return f.astype(self.dtype, copy=False) if isinstance(f, np.ndarray) else self.get(graph, f)


def gaussian_taps(std: float, truncate: float) -> FloatArray:
    """Return the middle of a Gaussian kernel of sum 1, and the values after it, (r + 1,); r = truncate std, rounded."""
    if std == 0:
        return np.ones(1)
    radius = int(truncate * std + 0.5)
    # as scipy.ndimage.gaussian_filter computes them
    values = np.exp(-0.5 / (std * std) * np.arange(radius + 1) ** 2)
    return np.asarray(values / (values[0] + 2 * math.fsum(values[1:])))
