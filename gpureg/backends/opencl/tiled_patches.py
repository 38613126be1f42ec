"""The step that compares patches as a GPU takes it, in OpenCL: functions are read where they are, without copies."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...graphs.grid import GridGraph
from ..patches import PatchForm
from ..types import Array
from .cells import OpenCLCells
from .geometry import GridGeometry
from .patch_tiles import ITEMS, LARGEST_AVERAGE, PatchTiles


class OpenCLTiledPatches(OpenCLCells):
    """Weights from patches in blocks of cells that a work group has in local memory."""

    def _patch_tiles(
        self, graph: GridGraph, form: PatchForm, compared: int, channels: int, *, guided: bool, largest: bool
    ) -> PatchTiles | None:
        """Return the blocks of a step; None if the device or the form needs the kernels of strips."""
        handle = self.device.handle
        if self.device.kind != "gpu" or graph.ndim != 2 or handle.max_work_group_size < ITEMS:
            return None
        tiles = PatchTiles(graph, form, self.dtype.itemsize, compared, channels, guided, largest)
        return tiles.that_fits(int(handle.local_mem_size))

    def _always_tiled(self, graph: GridGraph, channels: int, compared: int, radius: int) -> bool:
        """Return whether a step with patches of this radius has room in tiles, whatever else its form needs."""
        form = PatchForm(np.ones(2 * radius + 1), maps=np.empty(0), average=LARGEST_AVERAGE)
        return self._patch_tiles(graph, form, compared, channels, guided=True, largest=True) is not None

    def _mask_args(self, tiles: PatchTiles) -> list[Any]:
        """Return the kernel arguments for the mask."""
        if tiles.graph.mask is None:
            return [self._nothing, np.int32(0), np.int32(0)]
        words = tiles.mask_words()
        return [self.upload(words), np.int32(words.shape[1]), np.int32(tiles.mask_left)]

    def _form_args(self, tiles: PatchTiles) -> list[Any]:
        """Return the kernel arguments for the patch and the exponential."""
        form = tiles.form
        profile = self.upload(form.profile.astype(self.dtype))
        return [profile, self.real(form.shift), self.real(tiles.scale(self.real)), self.real(form.cut)]

    def _tiled_step(self, tiles: PatchTiles, f: Array, guide: Array, f0: Array, lam: float | Array, out: Array) -> None:
        """Do one Jacobi sweep at p = 2 from `f` to `out`; the patches are those of `guide`, functions on the device."""
        graph, form = tiles.graph, tiles.form
        geometry = self._geometry(graph)
        assert isinstance(geometry, GridGeometry)
        lams, lam_options = self._lam(lam)
        others = [
            *self._mask_args(tiles),
            self._nothing if form.maps is None else self.on_device(graph, form.maps).buffer,
            *(np.int32(size) for size in (*graph.shape, *tiles.reach)),
            self.upload(tiles.spatial().astype(self.dtype)),
            *self._form_args(tiles),
            np.int64(geometry.pitch),
            np.int64(geometry.plane),
            np.int64(geometry.guard),
            f0.buffer,
            *lams,
            out.buffer,
        ]
        for first, of_launch in tiles.launches(f.channels):
            args = [guide.buffer, f.buffer, np.int32(first), *others]
            options = (*of_launch.options, *lam_options)
            self._launch("similarity_step_gpu", options, args, of_launch.size, (ITEMS, 1))
