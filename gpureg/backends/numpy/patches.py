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
        profile = form.profile.astype(self.dtype)
        if isinstance(graph, GridGraph):
            weights = np.zeros((graph.half_window, *graph.shape), self.dtype)
            around = GridGraph(padded.shape[1:])
            for h, step in enumerate(graph.forward_offsets):
                start, end = around.ends(step)
                rho: FloatArray = ((padded[:, *end] - padded[:, *start]) ** 2).sum(axis=0)
                for axis in range(graph.ndim):
                    length = rho.shape[axis] - len(profile) + 1
                    slabs = (rho.take(range(j, j + length), axis) for j in range(len(profile)))
                    rho = sum((g * slab for g, slab in zip(profile, slabs, strict=True)), np.zeros((), self.dtype))
                spatial = 1.0 if form.spatial is None else float(form.spatial[h])
                inside, there = graph.ends(step)
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

    def _similarity(self, rho: FloatArray, form: PatchForm, spatial: Any, *maps: FloatArray) -> FloatArray:
        """Compute weights from distances; `maps` are those of both ends."""
        if form.scale is None:
            return rho
        kept = rho - form.shift
        if maps:
            at_u, at_v = (x.astype(self.dtype) for x in maps)
            kept = np.maximum(kept - (at_u[..., 0] + at_v[..., 0]), 0) * (at_u[..., 1] * at_v[..., 1])
        near = np.exp(-np.maximum(kept, 0) * form.scale)
        similarity: FloatArray = spatial * np.where(near < form.cut, 0, near)
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
