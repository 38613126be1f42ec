"""Groups of patches in Warp."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...arrays import FloatArray
from ...graphs.grid import GridGraph
from ..groups import GroupForm, Groups
from ..types import Array, BackendUnavailable
from .launching import WarpLaunches


class WarpGroups(WarpLaunches):
    """Groups of patches."""

    def patch_groups(
        self, graph: GridGraph, guide: FloatArray, form: GroupForm, *, level: FloatArray | None = None
    ) -> Groups:
        raise BackendUnavailable("groups of patches")

    def get_groups(self, groups: Groups) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        raise BackendUnavailable("groups of patches")

    def group_step(self, groups: Groups, f0: FloatArray, guide: FloatArray, variance: float | FloatArray) -> Array:
        raise BackendUnavailable("groups of patches")
