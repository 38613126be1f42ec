"""The result of denoising a mesh: :class:`MeshDenoising`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ..arrays import FloatArray, IntArray
from ..regularization.denoised import Denoised
from ..shapes.surface import Surface

# Taubin smoothing: a step towards the mean of the neighbours, then one away from it.
TAUBIN = (0.5, -0.53)


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshDenoising(Denoised[float]):
    """The result of denoising a mesh: see :class:`Denoised`.

    Attributes
    ----------
    filter : {"normals", "positions", "Taubin", "values"}
    lam : float or array
        An array if `lam` was one, or if the noise is not the same everywhere: (n,), one per vertex without repetitions;
        for "normals" (F,), one per face with an area. 0 for the rounds of guided normals. Of several groups of channels
        that of the one with the least noise.
    sigma : float
        The noise, as :func:`gpureg.estimate_mesh_noise` gives it; NaN if it cannot be told.
    surface : Surface
        The input mesh.
    edge : float
        Mean length of its edges.
    noise : (n,) float array
        The noise around each vertex; NaN where it cannot be told. Empty if it was not needed.
    spikes : int
        Number of single vertices (or values) far from all of their neighbours.
    components : int
        Number of connected components with a face.
    unknown : int
        Number of those whose noise cannot be told, and which were left as they are.
    rounds : (c,) int array or None
        Number of rounds of guided normals that each component took; None for other filters.
    left : int
        Number of vertices with a face that did not move, though nothing pinned them.
    """

    WHAT: ClassVar[Mapping[str, str]] = {
        "normals": "normals of the faces, vertices moved to fit them",
        "positions": "positions of the vertices",
        "values": "values at the vertices",
    }

    surface: Surface
    edge: float
    noise: FloatArray = field(default_factory=lambda: np.empty(0))
    spikes: int = 0
    components: int = 1
    unknown: int = 0
    rounds: IntArray | None = None
    left: int = 0

    @property
    def vertices(self) -> FloatArray:
        """Positions of the vertices after denoising, (n, 3)."""
        return self.value if self.moves else self.surface.vertices

    @property
    def noise_range(self) -> tuple[float, float]:
        """The 5 and 95 percent quantiles of the noise over the vertices; NaN without any."""
        known = self.noise[~np.isnan(self.noise)]
        if not known.size:
            return math.nan, math.nan
        low, high = np.quantile(known, [0.05, 0.95])
        return float(low), float(high)

    def describe(self) -> str:
        """Describe the filter and its parameters in one line."""
        if self.filter == "Taubin":
            return f"Taubin's pair of steps, {TAUBIN[0]} and {TAUBIN[1]}, {self.iterations} steps"
        if self.rounds is None or not self.results:
            return super().describe()
        most, each = int(self.rounds.max(initial=0)), sum(result.iterations for result in self.results[:2])
        rounds = f"{most} rounds" if most > 1 else "1 round" if most else "a part of 1 round"
        return f"{self.WHAT[self.filter]}; guided, p = 2, {rounds} of {each} iterations"

    def found(self) -> str:
        """Describe uneven noise, spikes, components, and what was left, in one line; "" without any of them."""
        low, high = self.noise_range
        words = [f"noise from {low:.3g} to {high:.3g}"] if high > 2 * low else []
        words += [f"{self.spikes} spikes"] if self.spikes else []
        words += [f"{self.components} components"] if self.components > 1 else []
        words += [f"{self.left} vertices left as they are"] if self.left else []
        words += [f"the noise of {self.unknown} components cannot be told"] if self.unknown else []
        return ", ".join(words)
