"""The layout of data for the OpenCL kernels over blocks of grid cells, as in ``strip.cl``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...arrays import FloatArray
from ...graphs.grid import GridGraph, row_major
from ..patches import PatchForm, patch_jumps
from .geometry import round_up
from .layout import Upload

# On a CPU, rows of a block, and packs of a row with two sums per cell, or fewer packs with more sums: the sums of a
# work item fit the L2 cache. A part of a grid that begins at multiples of both has the blocks of the whole grid.
ROWS, PACKS = 32, 8
# On a GPU, rows of a work item; bytes of as many numbers as the largest radius of a patch whose sums are in registers,
# as in the kernel; bytes of the channels of a launch.
_GPU_ROWS, _RING_BYTES, _GPU_BYTES = 8, 32, 16

# Bytes of all slots, the scratch memory for the sums of both ends of an edge: they fit the last-level cache.
_SLOT_BYTES = 1 << 25

# With a row length of a multiple of this, neighbouring rows would share the sets of a cache.
_ALIASING_BYTES = 1 << 12


@dataclass(frozen=True)
class Slots:
    """The slots of a step that computes a weight once for both ends of the edge, and its launches.

    Attributes
    ----------
    reach : int
        Rows from a cell to its farthest neighbour.
    side : int
        Cells on each side of the block in a row of a slot.
    blocks, strips : int
        Blocks per strip; number of strips.
    size : int
        Numbers in a slot.
    at_once : int
        Strips per launch.
    ring : int
        Strips that have slots: those of a launch and those above that reach into them.
    """

    reach: int
    side: int
    blocks: int
    strips: int
    size: int
    at_once: int
    ring: int


@dataclass(frozen=True)
class Strips:
    """A grid, cut into blocks of S rows of B packs of N cells, for patches of one form.

    Parameters
    ----------
    graph : GridGraph
    form : PatchForm
    lanes : int
        N.
    itemsize : int
        Bytes of a number.
    gpu : bool
    sums : int
        Sums per cell in a work item.
    """

    graph: GridGraph
    form: PatchForm
    lanes: int
    itemsize: int
    gpu: bool
    sums: int

    @property
    def rows(self) -> int:
        """Rows of a block, S."""
        if self.graph.ndim == 1:
            return 1
        if self.gpu:
            return 1 if self.form.radius > _RING_BYTES // self.itemsize or self.form.average else _GPU_ROWS
        return ROWS

    @property
    def packs(self) -> int:
        """Packs in a row of a block, B: a power of two."""
        packs = 1
        while not self.gpu and packs * self.sums < PACKS * 2 and packs < PACKS:
            packs *= 2
        return packs

    @property
    def size(self) -> tuple[int, int]:
        """Number of blocks of a strip, and of strips."""
        shape = self.graph.shape
        strips = math.prod(shape[:-2]) * -(-(shape[-2] if len(shape) > 1 else 1) // self.rows)
        return -(-shape[-1] // (self.packs * self.lanes)), strips

    @property
    def reach(self) -> int:
        """Largest offset along the last axis, in cells."""
        return int(np.abs(self.graph.offsets[:, -1]).max(initial=0))

    @property
    def pitch(self) -> int:
        """Numbers in a padded row."""
        beside = 4 * self.form.radius + 2 * self.form.average
        wide = self.graph.shape[-1] + beside + (self.packs + 3) * self.lanes
        pitch = round_up(wide, self.lanes) + 2 * self.left
        return pitch if pitch * self.itemsize % _ALIASING_BYTES else pitch + self.lanes

    @property
    def plane(self) -> int:
        """Numbers in a padded plane."""
        return math.prod(s + 2 * self.form.radius for s in self.graph.shape[:-1]) * self.pitch

    @property
    def left(self) -> int:
        """Zeros in a padded row before its first patch."""
        return round_up(self.reach + self.form.average, self.lanes)

    def options(self, channels: int) -> tuple[str, ...]:
        """Return the build options for patches of `channels` channels."""
        form = self.form
        options = [f"-DNDIM={self.graph.ndim}", f"-DN={self.lanes}", f"-DS={self.rows}", f"-DB={self.packs}"]
        options += [f"-DR={form.radius}", f"-DQ={channels}", *(["-DUNROLLED"] if self.gpu else [])]
        options += ["-DFLAT"] if bool((form.profile == 1).all()) else []
        options += ["-DSHIFTED_DISTANCE"] if form.scale is not None and form.shift != 0 else []
        options += ["-DSPATIAL"] if form.spatial is not None else []
        options += ["-DMASKED"] if self.graph.mask is not None else []
        options += [f"-DA={form.average}"] if form.average else []
        options += ["-DCUT"] if form.scale is not None and form.cut else []
        options += ["-DMAPS"] if form.scale is not None and form.maps is not None else []
        return tuple(options)

    def channel_groups(self, channels: int) -> list[tuple[int, int]]:
        """Return the first channel and the number of channels of each launch of a step."""
        most = _GPU_BYTES // self.itemsize if self.gpu else channels
        return [(first, min(most, channels - first)) for first in range(0, channels, most)]

    def offsets(self, pairs: bool) -> tuple[npt.NDArray[np.int32], FloatArray]:
        """Return the window and its spatial factors; for `pairs` the forward half, sorted by the last axis."""
        graph = self.graph
        half = np.ones(graph.half_window) if self.form.spatial is None else self.form.spatial
        if pairs:
            order = np.argsort(graph.forward_offsets[:, -1], kind="stable")
            return graph.forward_offsets[order].astype(np.int32), half[order]
        return graph.offsets.astype(np.int32), np.concatenate([half[::-1], half])

    def args(
        self,
        upload: Upload,
        planes: tuple[Any, Any, Any],
        steps: npt.NDArray[np.int32],
        spatial: FloatArray,
        real: Any,
    ) -> list[Any]:
        """Return the kernel arguments STRIP_ARGS; `planes` are those of the guide, the mask and the maps, padded."""
        graph, form, r = self.graph, self.form, self.form.radius
        guide, inside, maps = planes
        padded = tuple(s + 2 * r for s in graph.shape[:-1])
        # The patch along the leading axes, on three axes or more, as index steps in the padded plane.
        leading = form.window(max(graph.ndim - 2, 0))
        lines = patch_jumps(leading.shape, row_major(padded)[: leading.ndim] * self.pitch)
        scale = 0.0 if form.scale is None else form.scale
        largest = float(np.finfo(real).max)
        return [
            guide,
            np.int64(self.plane),
            np.int64(self.pitch),
            np.int64(self.left),
            inside,
            maps,
            upload(np.array(graph.shape, np.int32)),
            np.int32(len(steps)),
            upload(steps),
            upload(spatial.astype(real)),
            np.int32(leading.size),
            upload(lines),
            upload(leading.ravel().astype(real)),
            upload(form.profile.astype(real)),
            real(form.shift),
            real(exp2_scale(scale, largest)),
            real(form.cut),
        ]

    def slots(self) -> Slots:
        """Compute the slots of a step over pairs."""
        blocks, strips = self.size
        reach = int(np.abs(self.graph.offsets[:, 0]).max(initial=0))
        side = round_up(max(self.reach, 1), self.lanes)
        size = (self.rows + reach) * self.sums * (self.packs * self.lanes + 2 * side)
        at_once = min(strips, max(1, _SLOT_BYTES // (blocks * size * self.itemsize)))
        return Slots(reach, side, blocks, strips, size, at_once, at_once + -(-reach // self.rows))


def exp2_scale(scale: float, largest: float) -> float:
    """Return the factor of a distance in exp2, finite in its type, as infinity times 0 is NaN."""
    return -min(scale * math.log2(math.e), largest)
