"""Groups of similar patches of a grid, and the step whose fidelity is a matrix for each group.

A group belongs to a reference u, a cell of a coarse lattice: the patches v in a window around u that are most like that
of u. The function that is regularized has whole patches as values; see ``docs/mathematics.md``.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.grid import GridGraph
from .data import Data
from .patches import reflected
from .types import Array

# The sides of blocks of references are multiples of this, so that passes with other lattices have the same blocks.
_UNIT = 12


@dataclass(frozen=True)
class GroupForm:
    """Which patches are compared, and which belong to a group.

    Attributes
    ----------
    patch, window : tuple of int
        Radii of a patch, and of the window of its group, along each axis, in cells.
    step : tuple of int
        References are every step-th cell along an axis, and the last one.
    nearest : int
        Number n of patches that always belong to a group.
    most : int
        Number of patches that a group has at most, at least `nearest`.
    flat : float
        All patches whose mean squared difference from that of the reference is at most this belong to the group.
    """

    patch: tuple[int, ...]
    window: tuple[int, ...]
    step: tuple[int, ...]
    nearest: int
    most: int
    flat: float = 0.0

    @property
    def cells(self) -> int:
        """Number of cells of a patch, M."""
        return math.prod(2 * r + 1 for r in self.patch)

    @property
    def places(self) -> int:
        """Number of cells of the window."""
        return math.prod(2 * r + 1 for r in self.window)

    @property
    def reach(self) -> tuple[int, ...]:
        """Distance along each axis, in cells, of the cells on which a new value depends."""
        return tuple(2 * (w + p) for w, p in zip(self.window, self.patch, strict=True))

    @property
    def block(self) -> tuple[int, ...]:
        """Sides of a block of references in cells: two blocks with one between them write no cell in common.

        A part of a grid that begins at multiples of twice these sides has the blocks of the whole grid.
        """
        units = (math.lcm(_UNIT, step) for step in self.step)
        return tuple(max(-(-reach // unit), 1) * unit for reach, unit in zip(self.reach, units, strict=True))

    def lattice(self, shape: tuple[int, ...]) -> tuple[IntArray, ...]:
        """Return the positions of the references along each axis of a grid."""
        found = []
        for size, step in zip(shape, self.step, strict=True):
            every = np.arange(0, size, step)
            found.append(every if every[-1] == size - 1 else np.append(every, size - 1))
        return tuple(found)

    def counts(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """Return the number of references along each axis of a grid."""
        return tuple(
            (size - 1) // step + 1 + ((size - 1) % step > 0) for size, step in zip(shape, self.step, strict=True)
        )

    def references(self, shape: tuple[int, ...]) -> IntArray:
        """Return the vertices of the references in row-major order, (n_references,)."""
        grids = np.meshgrid(*self.lattice(shape), indexing="ij")
        return np.ravel_multi_index([grid.ravel() for grid in grids], shape)

    def offsets(self) -> IntArray:
        """Return the cells of the window as steps from its middle, (places, ndim), in row-major order."""
        places = np.indices([2 * r + 1 for r in self.window]).reshape(len(self.window), -1)
        steps: IntArray = (places.T - np.array(self.window)).astype(np.int64)
        return steps


@dataclass(frozen=True, eq=False)
class Groups:
    """The groups of a grid on a device.

    Attributes
    ----------
    graph : GridGraph
    form : GroupForm
    members : object
        (n_references, most) integers: the places of members in the window, in increasing order.
    sizes : object
        (n_references,) integers: how many members a group has; 0 for a reference outside the mask.
    """

    graph: GridGraph
    form: GroupForm
    members: Any
    sizes: Any


class GroupPrimitives(Data):
    """The primitives of groups of patches."""

    @abstractmethod
    def patch_groups(
        self,
        graph: GridGraph,
        guide: Array | FloatArray,
        form: GroupForm,
        *,
        level: Array | FloatArray | None = None,
    ) -> Groups:
        """Find the group of each reference of a grid.

        Let d(u, v) be the squared difference of the patches of `guide` at u and v, the sum over cells and channels,
        and t the larger of the `nearest`-th smallest d(u, v) over the window and of

            flat level(u) M m,   M cells of a patch, m channels

        The members of u are the vertices v of the window, inside the grid and its mask, with d(u, v) <= t. If there are
        K > most of them, in row-major order, only those of rank i with floor((i + 1) most/K) > floor(i most/K) remain.
        Cells of patches beyond the grid are reflected, without repeating the edge cell.

        Parameters
        ----------
        graph : GridGraph
        guide : (n, m) array, on the host, or a device function
        form : GroupForm
        level : (n,) array, on the host, or a device function, optional
            Factor of ``form.flat`` at a reference; None means 1.
        """

    @abstractmethod
    def get_groups(self, groups: Groups) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        """Copy groups to the host: the members, (n_references, most), and the sizes, (n_references,)."""

    @abstractmethod
    def group_step(
        self,
        groups: Groups,
        f0: Array | FloatArray,
        guide: Array | FloatArray,
        variance: float | Array | FloatArray,
    ) -> Array:
        """Estimate the patches of all members of all groups, and average them.

        For a group with N members and each channel, let a(v) be the patch of `f0` at v, b(v) that of `guide`, m and
        m_b their means over the group, and

            C = 1/(N - 1) sum_v (b(v) - m_b)(b(v) - m_b)^T          0 if N = 1
            S = diag(mean over v of the patch of `variance` at v)
            r(v) = S (C + S)^-1 (a(v) - m)          a(v) - b(v) if trace C > largest_trace(dtype) min S

        In the second case the matrix is so near to a singular one that its solution would be rounding errors: the
        variance is tiny beside the contrast. The result at a cell is f0 minus the mean of r over all groups and all
        patches that cover it; it is `guide` where there is none. In units of the noise, x' = S^(-1/2) x for every patch
        x, a(v) - r(v) is the minimiser of

            1/2 sum_v' |f'(v) - a'(v')|^2 / N  +  1/2 (f'(v) - a'(v))^T Lam' (f'(v) - a'(v)),
            Lam' = S^(-1/2) C S^(-1/2)

        which is (Lam + I)^-1 (Lam a(v) + m) with Lam = S^(1/2) Lam' S^(-1/2) = C S^-1.

        Parameters
        ----------
        groups : Groups
        f0, guide : (n, m) arrays, on the host, or device functions
        variance : float > 0, or (n,) array on the host, or a device function
            Variance of the noise in each channel.

        Returns
        -------
        Array
            A device function of m channels.
        """


def largest_trace(dtype: npt.DTypeLike) -> float:
    """Return the largest trace of C over the least variance of a group with which a device computes in this type.

    A stable solution has errors of about trace/variance roundings, in units of the noise.
    """
    return 0.25 / float(np.finfo(dtype).eps)


def as_column(values: Any) -> Any:
    """Return numbers (n,) on the host as a function of one channel; a device function as it is."""
    return values.reshape(-1, 1) if isinstance(values, np.ndarray) else values


def group_planes(grid: GridGraph, f: FloatArray, form: GroupForm) -> FloatArray:
    """Pad a function (n, m) by the patch, by reflection without repeating the edge cell: (m, *padded shape)."""
    widest = max(form.patch)
    padded = reflected(grid, f, widest)
    inner = tuple(slice(widest - r, widest + r + size) for r, size in zip(form.patch, grid.shape, strict=True))
    return padded[:, *inner]
