"""The result of denoising a point cloud: :class:`PointDenoising`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..regularization.denoised import Denoised
from ..shapes.cloud import Cloud


@dataclass(frozen=True, eq=False, kw_only=True)
class PointDenoising(Denoised[float]):
    """The result of denoising a point cloud: see :class:`Denoised`.

    Attributes
    ----------
    filter : {"surface", "normals", "positions", "values"}
    lam : float or (n,) array
        One per point without repetitions and outliers if it was an array, or if the noise is not the same everywhere;
        of several groups of channels that of the one with the least noise.
    sigma : float
        The given noise, or the root mean square of `levels`; NaN if it cannot be told.
    cloud : Cloud
        The input points.
    k : int
        Neighbours that each point chose in the graph.
    spacing : float
        Median distance from a point to its nearest neighbour in the input, copies left out.
    normals : (n, d) float array or None
        The regularized unit normals, of either orientation, 0 for outliers; None with the filters of other functions.
    levels : (n,) float array or None
        The estimated noise around each point; NaN where it cannot be told, and for outliers. None if sigma was given.
    outliers : (n,) bool array
        Points that lie alone, or off the surface of their neighbours: they took no part, and are where they were.
    repeated : int
        Number of points that repeat others and were merged with them while the points were denoised.
    """

    WHAT: ClassVar[Mapping[str, str]] = {
        "surface": "quadrics through 8 to 160 neighbours, a scale for each point, along averaged normals",
        "normals": "normals of the neighbourhoods, points moved to fit them",
        "positions": "positions of the points",
        "values": "values at the points",
    }

    cloud: Cloud
    k: int
    spacing: float
    normals: FloatArray | None = None
    levels: FloatArray | None = None
    outliers: npt.NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    repeated: int = 0

    @property
    def points(self) -> FloatArray:
        """Positions of the points after denoising, (n, d)."""
        return self.value if self.moves else self.cloud.points

    @property
    def unknown(self) -> int:
        """Number of points, other than outliers, where the noise cannot be told."""
        return 0 if self.levels is None else int((np.isnan(self.levels) & ~self.outliers).sum())

    def warnings(self) -> list[str]:
        """Say in sentences which points were left as they were, and why."""
        told, n = [], len(self.cloud.points)
        if self.outliers.any():
            told.append(
                f"{int(self.outliers.sum())} of {n} points are outliers, alone or off the surface of their neighbours: "
                "they took no part and stay where they are"
            )
        if self.unknown:
            told.append(
                f"the noise of {self.unknown} of {n} points cannot be told, they have too few neighbours: they stay as "
                "they are; sigma= says it"
            )
        return told

    def describe(self) -> str:
        """Describe the filter and its parameters in one line."""
        if np.isnan(self.sigma):
            return f"{self.WHAT[self.filter]}: the noise cannot be told from so few points"
        return super().describe()

    def _parameters(self) -> str:
        return f"{self.k} neighbours, {super()._parameters()}"
