"""NVIDIA Warp: CUDA devices, or the CPU; the kernels are in ``kernels/warp``."""

from __future__ import annotations

import numpy.typing as npt
import warp as wp

from ...kernels.warp import (
    adjoint,
    degree,
    difference,
    euler_step,
    gradient_norm,
    jacobi_step,
    p_laplacian,
)
from ..protocol import Backend
from ..types import Array, Conductance, Device, Smoothness, Weighted
from .cosines import WarpCosines
from .curvature import WarpCurvature
from .groups import WarpGroups
from .layout import channels_of
from .lent import WarpLent
from .listing import devices
from .multilevel import WarpMultilevel
from .patches import WarpPatches
from .scalars import WarpScalars
from .sweeps import WarpSweeps
from .zones import WarpZones

__all__ = ["WarpBackend", "devices", "make"]


class WarpBackend(
    WarpCosines,
    WarpScalars,
    WarpCurvature,
    WarpMultilevel,
    WarpGroups,
    WarpLent,
    WarpPatches,
    WarpSweeps,
    WarpZones,
):
    """The primitives as Warp kernels."""

    def _degree(self, weighted: Weighted, out: Array) -> None:
        self._run(degree.make, weighted, (False,), [], out)

    def _largest_weight(self, weighted: Weighted, out: Array) -> None:
        self._run(degree.make, weighted, (True,), [], out)

    def _difference(self, weighted: Weighted, f: Array, out: Array) -> None:
        self._run(difference.make, weighted, (channels_of(f),), [f], out)

    def _adjoint(self, weighted: Weighted, H: Array, out: Array) -> None:
        bound = weighted.topology
        options = (bound.access, channels_of(H))
        self._launch_vertices(bound.layout, adjoint.make, options, [self._mirrored(weighted), H], out)

    def _gradient_norm(
        self,
        weighted: Weighted,
        f: Array,
        power: float,
        eps: float,
        coupled: bool,
        edge_power: float | None,
        out: Array,
    ) -> None:
        M = channels_of(f)
        options = (M, 1 if coupled else M, edge_power is not None)
        inputs = [f, self._squared(eps), power, edge_power or 0.0]
        self._run_runs(gradient_norm.make, weighted, options, inputs, out, edge_power is not None)

    def _p_laplacian(self, weighted: Weighted, f: Array, g: Conductance, out: Array) -> None:
        M = channels_of(f)
        options, conductance = self._conductance(g, M)
        self._run(p_laplacian.make, weighted, (M, *options), [f, *conductance], out)

    def _jacobi_step(
        self, weighted: Weighted, f: Array, f0: Array, g: Conductance, lam: float | Array, theta: float, out: Array
    ) -> None:
        M = channels_of(f)
        options, conductance = self._conductance(g, M)
        inputs = [f, f0, *conductance, lam, theta]
        compiled_in = (M, *options, isinstance(lam, wp.array))
        self._run_runs(jacobi_step.make, weighted, compiled_in, inputs, out, isinstance(g, Smoothness))

    def _euler_step(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        g: Conductance,
        lam: float | Array,
        tau: float | Array,
        out: Array,
    ) -> None:
        M = channels_of(f)
        options, conductance = self._conductance(g, M)
        arrays = (isinstance(lam, wp.array), isinstance(tau, wp.array))
        self._run(euler_step.make, weighted, (M, *options, *arrays), [f, f0, *conductance, lam, tau], out)

    def finish(self) -> None:
        wp.synchronize_device(self._on)


def make(device: Device, dtype: npt.DTypeLike) -> Backend:
    """Make the backend on this device."""
    return WarpBackend(device, dtype)
