"""The part of an image that its missing pixels depend on: :class:`Part`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..graphs.grid import GridGraph
from ..regularization.harmonic import harmonic
from ..regularization.joined import Joined
from ..weights import Bilateral, Constant, Guided, Patch, Weights
from .guides import filled
from .raster import Raster

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Part:
    """The part of an image that missing pixels depend on.

    Attributes
    ----------
    raster : Raster
        The whole image.
    window : tuple of slice
        The box of the part.
    hole : bool array
        The missing pixels, in the shape of the box.
    graph : GridGraph
        That of the box. Pixels on which no missing one depends may be outside its mask, so that the energy is that of
        what is filled in, and a gap relative to it bounds that.
    f0 : (n, m) float64 array
        The values of the box, at missing pixels those of the nearest known ones.
    """

    raster: Raster
    window: tuple[slice, ...]
    hole: Mask
    graph: GridGraph
    f0: FloatArray

    @classmethod
    def of(
        cls,
        raster: Raster,
        missing: Mask,
        grid: GridGraph,
        weights: Weights | npt.ArrayLike | None,
        *,
        near: bool,
        masked: bool,
    ) -> Part:
        """Cut out the part of an image.

        A missing pixel depends on its neighbours, if not `near` also on theirs, through gradient norms; and weights
        depend on the patches around both. Unknown kinds of weights may depend on the whole image.
        """
        reach = np.abs(grid.offsets).max(axis=0, initial=0) * (1 if near else 2)
        window: tuple[slice, ...] = (slice(None),) * missing.ndim
        if weights is None or isinstance(weights, Constant | Bilateral | Patch):
            window = _window(missing, reach + (weights.patch_radius if isinstance(weights, Patch) else 0))
        hole = missing[window]
        cells = raster.cells[window].astype(np.float64)
        mask = None
        if masked and (weights is None or isinstance(weights, Weights)):
            from scipy import ndimage

            mask = ndimage.maximum_filter(hole, size=tuple(2 * reach + 1))
            mask = None if mask.all() else mask
        graph = GridGraph(hole.shape, grid.radius, grid.metric, spacing=grid.spacing, mask=mask)
        return cls(raster, window, hole, graph, filled(cells, ~hole).reshape(-1, cells.shape[-1]))

    @property
    def known(self) -> Mask:
        """Whether the value of a pixel is known, (n,)."""
        return ~self.hole.ravel()

    def started(
        self, weights: Weights | npt.ArrayLike | None, certified: bool, computed: dict[str, Any]
    ) -> tuple[FloatArray, FloatArray | None, Mask]:
        """Return f0 that weights can be computed from, a start, and the pixels to be filled in, (n,).

        A certified solver finds a start itself. Those without an edge of weight > 0 to a known pixel keep f0.
        """
        graph, known, f0 = self.graph, self.known, self.f0
        constant = weights is None or isinstance(weights, Constant)
        # every pixel is joined to the next along each axis
        steps = {tuple(step) for step in np.abs(graph.offsets)}
        plain = constant and steps.issuperset(map(tuple, np.eye(len(graph.shape), dtype=int)))
        if isinstance(weights, Weights) and not isinstance(weights, Constant | Guided):
            first = GridGraph(graph.shape, 1, "cityblock", mask=graph.mask)
            f0 = harmonic(f0, first, known, **computed)[0]
        if not certified:
            # Measured on the camera image. Holes 16, 32 and 64 pixels wide, filled from the nearest pixels, need 160,
            # 840 and 2320 sweeps to 0.1 % of the range at p = 2; with this start none. Patch weights (radius 2, h = 60,
            # 15 x 15 window, scratches) need 900 sweeps, 24 s, from the unweighted fill, and 50, 5 s in total, from the
            # weighted fill.
            start, reached = harmonic(f0, graph, known, weights=weights, **computed)
            return f0, start, reached & ~known
        if plain:
            return f0, None, ~known
        joined = Joined.of(f0, graph, known, weights=weights, wanted=~known, **computed)
        return f0, None, joined.reached & ~known

    def painted(self, value: FloatArray) -> npt.NDArray[Any]:
        """Return a copy of the image with the missing pixels filled in from a value of the part."""
        raster, hole = self.raster, self.hole
        paint, kind = value.reshape(*hole.shape, -1)[hole], raster.values.dtype
        if kind.kind in "iu":
            limits = np.iinfo(kind)
            paint = np.clip(np.rint(paint), limits.min, limits.max)
        whole = raster.cells.copy()
        whole[self.window][hole] = paint.astype(kind)
        image = whole[..., 0] if raster.channel_axis is None else np.moveaxis(whole, -1, raster.channel_axis)
        return np.ascontiguousarray(image)


def _window(missing: Mask, reach: npt.NDArray[np.int64]) -> tuple[slice, ...]:
    """Return the box of the pixels at most `reach` cells from a missing one, along each axis (ndim,)."""
    box = []
    for axis in range(missing.ndim):
        places = np.flatnonzero(missing.any(axis=tuple(a for a in range(missing.ndim) if a != axis)))
        low, high = int(places[0]) - int(reach[axis]), int(places[-1]) + 1 + int(reach[axis])
        box.append(slice(max(0, low), min(missing.shape[axis], high)))
    return tuple(box)
