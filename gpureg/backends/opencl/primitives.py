"""OpenCL: any GPU with a driver, or a CPU through PoCL; the kernels are in ``kernels/opencl``."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ...graphs.grid import AnyGraph
from ..protocol import Backend
from ..types import Array, BackendUnavailable, Conductance, Device, Smoothness, Weighted
from .cosines import OpenCLCosines
from .geometry import GridGeometry
from .groups import OpenCLGroups
from .layout import GridLayout
from .listing import devices
from .patches import OpenCLPatches
from .sums import OpenCLSums
from .zones import OpenCLZones

__all__ = ["OpenCLBackend", "devices", "make"]


class OpenCLBackend(OpenCLCosines, OpenCLSums, OpenCLGroups, OpenCLPatches, OpenCLZones):
    """The primitives as OpenCL C kernels."""

    name = "opencl"

    def sweep_bytes(self, graph: AnyGraph, channels: int, norms: int) -> int:
        geometry = self._geometry(graph)
        if not isinstance(geometry, GridGeometry) or self.device.kind == "gpu" or not norms:
            return 0
        blocks = geometry.blocks(channels, norms, True, self.device.handle.max_compute_units)
        return math.prod(blocks.count) * blocks.ring_size * self.dtype.itemsize

    def _degree(self, weighted: Weighted, out: Array) -> None:
        self._run("degree", weighted, [out.buffer])

    def _largest_weight(self, weighted: Weighted, out: Array) -> None:
        self._run("degree", weighted, [out.buffer], ("-DLARGEST",))

    def _difference(self, weighted: Weighted, f: Array, out: Array) -> None:
        self._run("difference", weighted, [f.buffer, out.buffer], (f"-DM={f.channels}",))

    def _adjoint(self, weighted: Weighted, H: Array, out: Array) -> None:
        self._run("adjoint", weighted, [H.buffer, out.buffer], (f"-DM={H.channels}",))

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
        args = [f.buffer, self.real(eps) ** 2, self.real(power), self.real(edge_power or 0), out.buffer]
        norms = f"-DG={1 if coupled else f.channels}"
        options = (f"-DM={f.channels}", norms, *(() if edge_power is None else ("-DEDGE_NORM",)))
        self._run("gradient_norm", weighted, args, options)

    def _p_laplacian(self, weighted: Weighted, f: Array, g: Conductance, out: Array) -> None:
        conductance, options = self._g(g, f.channels)
        self._run("p_laplacian", weighted, [f.buffer, *conductance, out.buffer], (f"-DM={f.channels}", *options))

    def _jacobi_step(
        self, weighted: Weighted, f: Array, f0: Array, g: Conductance, lam: float | Array, theta: float, out: Array
    ) -> None:
        conductance, g_options = self._g(g, f.channels)
        lams, lam_options = self._lam(lam)
        args = [f.buffer, f0.buffer, *conductance, *lams, self.real(theta), out.buffer]
        self._run("jacobi_step", weighted, args, (f"-DM={f.channels}", *g_options, *lam_options))

    def sweep(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        lam: float | Array,
        model: Smoothness,
        *,
        theta: float,
        g: Array | None,
        out: Array,
    ) -> Array:
        layout = weighted.topology
        fused = isinstance(layout, GridLayout) and self.device.kind == "cpu" and not weighted.directed
        if not fused or not model.has_function:
            return super().sweep(weighted, f, f0, lam, model, theta=theta, g=g, out=out)
        G = model.norms(f.channels)
        stored = weighted.weights is not None and weighted.storage != "none"
        cores = self.device.handle.max_compute_units
        geometry = layout.geometry
        blocks = geometry.blocks(f.channels, G, stored, cores, wide=geometry.wide and weighted.storage != "none")
        lams, lam_options = self._lam(lam)
        args = [
            f.buffer,
            f0.buffer,
            self.real(model.power),
            self.real(model.eps) ** 2,
            *lams,
            self.real(theta),
            np.int32(blocks.band),
            np.int32(blocks.stretch),
            np.int32(geometry.jump),
            np.int32(blocks.slots),
            np.int64(blocks.ring_pitch),
            layout.rings(blocks, self._allocate),
            out.buffer,
        ]
        options = (f"-DM={f.channels}", f"-DG={G}", *lam_options)
        self._run("sweep", weighted, args, options, blocks.count, exact=True, local=(1, 1))
        return out

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
        conductance, g_options = self._g(g, f.channels)
        lams, lam_options = self._lam(lam)
        taus, tau_options = self._number(tau, "-DTAU_ARRAY")
        args = [f.buffer, f0.buffer, *conductance, *lams, *taus, out.buffer]
        self._run("euler_step", weighted, args, (f"-DM={f.channels}", *g_options, *lam_options, *tau_options))


def make(device: Device, dtype: npt.DTypeLike) -> Backend:
    """Make the backend on this device."""
    if np.dtype(dtype) == np.float64 and not device.float64:
        raise BackendUnavailable(f"{device.id} ({device.name}) does not compute in float64; use dtype float32")
    return OpenCLBackend(device, dtype)
