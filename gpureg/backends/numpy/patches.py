"""The primitives that compare patches, in numpy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...arrays import FloatArray
from ...graphs.grid import AnyGraph, GridGraph, row_major
from ..patches import PatchForm, over_patches, padded_for_patches, padded_shape, patch_jumps
from ..types import Array, Storage, Weighted, expect_storage, expect_stored
from .edges import NumpyGraph


class NumpyPatches(NumpyGraph):
    """Weights computed from patches."""

    def patch_bytes(self, graph: AnyGraph, channels: int, radius: int) -> tuple[int, ...]:
        # the padded function, a copy, a difference and its square; distances and intermediate sums
        cells = math.prod(padded_shape(graph, radius)) * self.dtype.itemsize
        return (cells * channels,) * 4 + (cells,) * 4

    def patch_distance(self, graph: AnyGraph, f: FloatArray, form: PatchForm, *, storage: Storage = "full") -> Weighted:
        expect_storage(graph, form, storage)
        weighted = self._patch_distance(graph, f, form)
        if storage == "half":
            # rounded to float16, but stored in the backend's dtype
            return Weighted(graph, None, weighted.weights.astype(np.float16).astype(self.dtype), storage=storage)
        return weighted

    def _patch_distance(self, graph: AnyGraph, f: FloatArray, form: PatchForm) -> Weighted:
        padded, sites = padded_for_patches(graph, f.astype(self.dtype), form.radius)
        if isinstance(graph, GridGraph):
            weights = np.zeros((graph.half_window, *graph.shape), self.dtype)
            for h, step in enumerate(graph.forward_offsets):
                inside, there = graph.ends(step)
                rho = self._rho(padded, form, inside, there)
                spatial = 1.0 if form.spatial is None else float(form.spatial[h])
                maps = [] if form.maps is None else [form.maps.reshape(*graph.shape, 2)[at] for at in (inside, there)]
                weights[h][inside] = self._similarity(rho, form, spatial, *maps)
            if graph.mask is not None:
                weights[graph.edges.unit_half() == 0] = 0
            return Weighted(graph, None, weights)
        ndim = 1 if graph.grid is None else graph.grid.ndim
        window = form.window(ndim).astype(self.dtype)
        jumps = patch_jumps(window.shape, row_major(padded.shape[1:]))
        flat, g = padded.reshape(len(padded), -1), window.ravel()
        weights = np.empty(graph.n_edges, self.dtype)
        for rows, edges in self._row_blocks(graph.indptr):
            u = np.repeat(np.arange(rows.start, rows.stop), np.diff(graph.indptr[rows.start : rows.stop + 1]))
            a, b = sites[u], sites[graph.indices[edges]]
            rho = np.zeros(len(a), self.dtype)
            for jump, g_j in zip(jumps, g, strict=True):
                rho += g_j * ((flat[:, a + jump] - flat[:, b + jump]) ** 2).sum(axis=0)
            maps = [] if form.maps is None else [form.maps[u], form.maps[graph.indices[edges]]]
            factor = 1.0 if form.spatial is None else form.spatial[edges]
            weights[edges] = self._similarity(rho, form, factor, *maps)
        return Weighted(graph, None, weights)

    def _rho(
        self, padded: FloatArray, form: PatchForm, here: tuple[slice, ...], there: tuple[slice, ...]
    ) -> FloatArray:
        """Compute the distances of the patches of cells of a grid, given as slices; `padded` has its channels first."""
        side = len(form.profile) - 1
        own, other = (padded[:, *(slice(at.start, at.stop + side) for at in box)] for box in (here, there))
        difference = other - own
        difference *= difference
        rho: FloatArray = difference[0] if len(difference) == 1 else difference.sum(axis=0)
        for axis in range(rho.ndim):
            rho = _along(rho, axis, form.profile.astype(self.dtype))
        return rho

    def _similarity(self, rho: FloatArray, form: PatchForm, spatial: Any, *maps: FloatArray) -> FloatArray:
        """Compute weights from distances; `maps` are those of both ends."""
        if form.scale is None:
            return rho
        kept = rho - self.real(form.shift)
        if maps:
            at_u, at_v = (x.astype(self.dtype) for x in maps)
            kept = np.maximum(kept - (at_u[..., 0] + at_v[..., 0]), 0) * (at_u[..., 1] * at_v[..., 1])
        np.maximum(kept, 0, out=kept)
        kept *= self.real(-form.scale)
        near = np.exp(kept, out=kept)
        if form.cut:
            near[near < form.cut] = 0
        similarity: FloatArray = near if isinstance(spatial, float) and spatial == 1 else spatial * near
        return similarity.astype(self.dtype, copy=False)

    def _aggregate(self, weighted: Weighted, f: Array, share: Array, centre: Array, radius: int, out: Array) -> None:
        grid = expect_stored(weighted)

        values, shares = f.reshape(*grid.shape, -1), share.reshape(grid.shape)
        total = over_patches(centre.reshape(grid.shape), radius)[..., None] * values
        for h, step in enumerate(grid.forward_offsets):
            start, end = grid.ends(step)
            w = self.real(1) if weighted.weights is None else weighted.weights[h][start]
            for here, there in ((start, end), (end, start)):
                given = np.zeros(grid.shape, self.dtype)
                given[here] = w * shares[here]
                total[here] += over_patches(given, radius)[here][..., None] * values[there]
        out[...] = total.reshape(f.shape)


def _along(x: FloatArray, axis: int, profile: FloatArray) -> FloatArray:
    """Sum the cells of patches along an axis, with the weights of the profile; what sticks out is left out."""
    length = x.shape[axis] - len(profile) + 1
    slabs = [x[(slice(None),) * axis + (slice(j, j + length),)] for j in range(len(profile))]
    flat = bool((profile == 1).all())
    total: FloatArray = profile[0] * slabs[0]
    for g, slab in zip(profile[1:], slabs[1:], strict=True):
        total += slab if flat else g * slab
    return total
