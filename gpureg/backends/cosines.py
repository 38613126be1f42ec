"""The protocol of systems whose eigenvectors are cosines, and the steps of a cosine transform on a device.

The equations are in ``kernels/opencl/cosine_solve.cl``.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..graphs.grid import GridGraph
from .data import Data
from .types import Array


@dataclass(frozen=True, eq=False)
class Cosines:
    """A matrix on a grid, given by its eigenvalues; its eigenvectors are cosines.

    Attributes
    ----------
    graph : GridGraph
    eigenvalues : (*shape, 1) array
        All > 0.
    place : object
        What the device needs; None if the transform is done on the host.
    """

    graph: GridGraph
    eigenvalues: FloatArray
    place: Any = None


class CosineSolves(Data):
    """Solve systems by cosine transforms."""

    @property
    def transforms(self) -> bool:
        """Whether the device does the transforms: it then reads nothing back. By default the host does them."""
        return False

    def cosines(self, graph: GridGraph, eigenvalues: FloatArray, channels: int) -> Cosines:
        """Prepare :meth:`cosine_solve` for functions of this many channels; `eigenvalues` are (*shape, 1)."""
        return Cosines(graph, eigenvalues)

    def cosine_solve(self, cosines: Cosines, r: Array, *, out: Array) -> Array:
        """Solve A x = r for the matrix with these eigenvalues; `out` may be r."""
        from scipy import fft

        shape = cosines.eigenvalues.shape
        axes = tuple(range(len(shape) - 1))
        host = self.get(cosines.graph, r).astype(np.float64).reshape(*shape[:-1], -1)
        solved = fft.idctn(fft.dctn(host, axes=axes, overwrite_x=True) / cosines.eigenvalues, axes=axes)
        self.overwrite(cosines.graph, solved.reshape(cosines.graph.n_vertices, -1), out=out)
        return out

    @abstractmethod
    def overwrite(self, graph: GridGraph, f: npt.NDArray[Any], *, out: Array) -> None:
        """Copy a host function (n, channels) over a device function."""


def radices(n: int) -> list[int]:
    """Return factors of n, in the order of the steps of a Fourier transform: fours, and then primes."""
    found = []
    for factor in (4, *range(2, n + 1)):
        while n % factor == 0:
            found.append(factor)
            n //= factor
        if n == 1:
            break
    return found


def roots(n: int, dtype: npt.DTypeLike) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return exp(-2 pi i k / n) and exp(-pi i k / (2 n)), k < n, as arrays (n, 2)."""
    angles = np.arange(n) * (np.pi / n)
    whole, quarter = (np.stack([np.cos(x), -np.sin(x)], axis=1).astype(dtype) for x in (2 * angles, angles / 2))
    return whole, quarter


@dataclass(frozen=True)
class Lines:
    """The lines along one axis of a grid, as ``cosine_solve`` numbers them.

    Attributes
    ----------
    n, count : int
        Cells of a line; lines of one channel.
    by_line : bool
        Whether the next number of the work space is of the next pair of lines, not of the next cell of a line.
    columns, inner, outer, block : int
        Lines side by side in a row; rows side by side in a slice; slices; rows of a slice.
    rows_along : int
        Rows from a cell of a line to the next one; 0 along the last axis.
    """

    n: int
    count: int
    by_line: bool
    columns: int
    inner: int
    outer: int
    block: int
    rows_along: int

    @classmethod
    def of(cls, shape: tuple[int, ...], axis: int) -> Lines:
        """Return the lines along an axis of a grid of this shape."""
        n, width, size = shape[axis], shape[-1], math.prod(shape)
        if axis == len(shape) - 1:
            return cls(n, size // n, False, 1, 1, size // n, 1, 0)
        inner = math.prod(shape[axis + 1 : -1])
        return cls(n, size // n, True, width, inner, math.prod(shape[:axis]), n * inner, inner)
