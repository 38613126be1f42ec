"""OpenCL: any GPU with a driver, or a CPU through PoCL; the kernels are in ``kernels/opencl``."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..protocol import Backend
from ..types import Array, BackendUnavailable, Conductance, Device, Weighted
from .cosines import OpenCLCosines
from .curvature import OpenCLCurvature
from .groups import OpenCLGroups
from .listing import devices
from .multilevel import OpenCLMultilevel
from .patches import OpenCLPatches
from .scalars import OpenCLScalars
from .sweeps import OpenCLSweeps
from .zones import OpenCLZones

__all__ = ["OpenCLBackend", "devices", "make"]


class OpenCLBackend(
    OpenCLSweeps,
    OpenCLCosines,
    OpenCLScalars,
    OpenCLCurvature,
    OpenCLMultilevel,
    OpenCLGroups,
    OpenCLPatches,
    OpenCLZones,
):
    """The primitives as OpenCL C kernels."""

    name = "opencl"

    def _degree(self, weighted: Weighted, out: Array) -> None:
        self._run("degree", weighted, [out.buffer], sums=1)

    def _largest_weight(self, weighted: Weighted, out: Array) -> None:
        self._run("degree", weighted, [out.buffer], ("-DLARGEST",), sums=1)

    def _difference(self, weighted: Weighted, f: Array, out: Array) -> None:
        self._run("difference", weighted, [f.buffer, out.buffer], (f"-DM={f.channels}",), sums=0)

    def _adjoint(self, weighted: Weighted, H: Array, out: Array) -> None:
        self._run("adjoint", weighted, [H.buffer, out.buffer], (f"-DM={H.channels}",), sums=H.channels)

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
        norms = 1 if coupled else f.channels
        options = (f"-DM={f.channels}", f"-DG={norms}", *(() if edge_power is None else ("-DEDGE_NORM",)))
        self._run("gradient_norm", weighted, args, options, sums=norms)

    def _p_laplacian(self, weighted: Weighted, f: Array, g: Conductance, out: Array) -> None:
        conductance, options = self._g(g, f.channels)
        args, options = [f.buffer, *conductance, out.buffer], (f"-DM={f.channels}", *options)
        self._run("p_laplacian", weighted, args, options, sums=f.channels)

    def _jacobi_step(
        self, weighted: Weighted, f: Array, f0: Array, g: Conductance, lam: float | Array, theta: float, out: Array
    ) -> None:
        conductance, g_options = self._g(g, f.channels)
        lams, lam_options = self._lam(lam)
        args = [f.buffer, f0.buffer, *conductance, *lams, self.real(theta), out.buffer]
        options = (f"-DM={f.channels}", *g_options, *lam_options)
        self._run("jacobi_step", weighted, args, options, sums=2 * f.channels)

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
        options = (f"-DM={f.channels}", *g_options, *lam_options, *tau_options)
        self._run("euler_step", weighted, args, options, sums=f.channels)


def make(device: Device, dtype: npt.DTypeLike) -> Backend:
    """Make the backend on this device."""
    if np.dtype(dtype) == np.float64 and not device.float64:
        raise BackendUnavailable(f"{device.id} ({device.name}) does not compute in float64; use dtype float32")
    return OpenCLBackend(device, dtype)
