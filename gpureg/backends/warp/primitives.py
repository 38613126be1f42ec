"""NVIDIA Warp: CUDA devices, or the CPU; the kernels are in ``kernels/warp``."""

from __future__ import annotations

import contextlib
import copy
import math
import os
import tempfile
import weakref
from collections.abc import Iterator
from typing import Any

import numpy.typing as npt
import warp as wp

from ...kernels.warp import (
    adjoint,
    degree,
    difference,
    energy,
    euler_step,
    gradient_norm,
    jacobi_step,
    max_change,
    p_laplacian,
)
from ..numpy import primitives as host
from ..protocol import Backend
from ..types import Array, Conductance, Device, EdgeNorm, Weighted
from . import pool
from .duality import WarpDuality
from .layout import channels_of
from .patches import WarpPatches
from .pool import launch_all, quiet
from .zones import WarpZones

CUDA_TIER, CPU_TIER = 0, 3

# Recorded sweeps per graph with its weights: two buffers in turn, and as many dampings.
_SWEEPS = 8

_NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"


@contextlib.contextmanager
def _without_driver_warning() -> Iterator[None]:
    """Drop the one line that Warp's C++ writes to stderr where there is no CUDA driver; no setting of its own does."""
    try:
        stderr = os.dup(2)
    except OSError:  # a process without stderr
        yield
        return
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            said.seek(0)
            for line in said:
                if _NO_DRIVER not in line:
                    os.write(2, line)


def devices() -> list[Device]:
    """All CUDA devices, then the CPU."""
    with quiet(), _without_driver_warning():
        wp.init()
    processor = host.devices()[0]
    described = []
    for i, device in enumerate(wp.get_devices()):
        gpu = bool(device.is_cuda)
        driver = f"Warp {wp.config.version}"
        if gpu:
            driver += ", CUDA {}.{}".format(*wp.get_cuda_driver_version())
        described.append(
            Device(
                backend="warp",
                id=f"warp:{device.alias}",
                name=device.name if gpu else processor.name,
                driver=driver,
                kind="gpu" if gpu else "cpu",
                memory=int(device.total_memory) if gpu else processor.memory,
                vector_width=1,
                float64=True,
                rank=(CUDA_TIER if gpu else CPU_TIER, i),
                handle=device,
            )
        )
    return sorted(described, key=lambda device: device.rank)


class WarpBackend(WarpDuality, WarpPatches, WarpZones):
    """The primitives as Warp kernels."""

    def __init__(self, device: Device, dtype: npt.DTypeLike) -> None:
        super().__init__(device, dtype)
        # The launches of past sweeps, for as long as their weights live.
        self._sweeps: weakref.WeakKeyDictionary[Weighted, dict[Any, Any]] = weakref.WeakKeyDictionary()

    def degree(self, weighted: Weighted) -> Array:
        out = self.empty(weighted.graph, 1)
        self._run(degree.make, weighted, (False,), [], out)
        return out

    def largest_weight(self, weighted: Weighted) -> Array:
        out = self.empty(weighted.graph, 1)
        self._run(degree.make, weighted, (True,), [], out)
        return out

    def difference(self, weighted: Weighted, f: Array, *, out: Array | None = None) -> Array:
        out = self.empty_edges(weighted.graph, channels_of(f)) if out is None else out
        self._run(difference.make, weighted, (channels_of(f),), [f], out)
        return out

    def adjoint(self, weighted: Weighted, H: Array, *, out: Array | None = None) -> Array:
        out = self.empty(weighted.graph, channels_of(H)) if out is None else out
        bound = weighted.topology
        options = (bound.access, channels_of(H))
        self._launch_vertices(bound.layout, adjoint.make, options, [self._mirrored(weighted), H], out)
        return out

    def gradient_norm(
        self,
        weighted: Weighted,
        f: Array,
        *,
        power: float,
        eps: float,
        coupled: bool,
        edge_power: float | None = None,
        out: Array | None = None,
    ) -> Array:
        M = channels_of(f)
        G = 1 if coupled else M
        out = self.empty(weighted.graph, G) if out is None else out
        options = (M, G, edge_power is not None)
        inputs = [f, self._squared(eps), power, edge_power or 0.0]
        self._run_runs(gradient_norm.make, weighted, options, inputs, out, edge_power is not None)
        return out

    def p_laplacian(self, weighted: Weighted, f: Array, g: Conductance, *, out: Array | None = None) -> Array:
        M = channels_of(f)
        out = self.empty(weighted.graph, M) if out is None else out
        options, conductance = self._conductance(g, M)
        self._run(p_laplacian.make, weighted, (M, *options), [f, *conductance], out)
        return out

    def jacobi_step(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        g: Conductance,
        lam: float | Array,
        *,
        theta: float = 1.0,
        out: Array | None = None,
    ) -> Array:
        M = channels_of(f)
        out = self.empty(weighted.graph, M) if out is None else out
        options, conductance = self._conductance(g, M)
        inputs = [f, f0, *conductance, lam, theta]
        compiled_in = (M, *options, isinstance(lam, wp.array))
        self._run_runs(jacobi_step.make, weighted, compiled_in, inputs, out, isinstance(g, EdgeNorm))
        return out

    def euler_step(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        g: Conductance,
        lam: float | Array,
        tau: float | Array,
        *,
        out: Array | None = None,
    ) -> Array:
        M = channels_of(f)
        out = self.empty(weighted.graph, M) if out is None else out
        options, conductance = self._conductance(g, M)
        arrays = (isinstance(lam, wp.array), isinstance(tau, wp.array))
        self._run(euler_step.make, weighted, (M, *options, *arrays), [f, f0, *conductance, lam, tau], out)
        return out

    def energy(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        lam: float | Array,
        *,
        p: float,
        eps: float,
        coupled: bool,
        edge_norm: bool = False,
    ) -> float:
        bound, M = weighted.topology, channels_of(f)
        options = (bound.access, M, 1 if coupled else M, edge_norm, isinstance(lam, wp.array))
        inputs = [bound.argument, f, f0, lam, p, self._squared(eps)]
        return float(
            self._partial(energy.make, bound.layout.shape, options, inputs, wp.float64, bound.layout.work).sum()
        )

    def max_change(self, weighted: Weighted, a: Array, b: Array) -> float:
        options = (self.real, channels_of(a))
        shape = weighted.topology.layout.shape
        return float(self._partial(max_change.make, shape, options, [a, b], self.real, math.prod(shape)).max())

    def sweep(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        lam: float | Array,
        *,
        p: float,
        eps: float,
        coupled: bool,
        theta: float,
        edge_norm: bool = False,
        g: Array | None,
        out: Array,
    ) -> Array:
        """Launched from a record the second time: a solver swaps the same two buffers over and over.

        To check and pack the arguments of a launch takes Python longer than a GPU needs for a small graph.
        """
        settings: dict[str, Any] = {"p": p, "eps": eps, "coupled": coupled, "theta": theta, "edge_norm": edge_norm}
        if p != 2 and not edge_norm and g is None:  # an output of its own every time
            return super().sweep(weighted, f, f0, lam, g=g, out=out, **settings)
        arrays = (f, f0, lam, g, out)
        key = (*(x if isinstance(x, float | int) else id(x) for x in arrays), *settings.values(), pool.cores())
        past = self._sweeps.setdefault(weighted, {})
        if key in past:
            for commands in past[key][0]:
                launch_all(commands)
            return out
        recorder = copy.copy(self)
        recorder._recorded = []
        super(WarpBackend, recorder).sweep(weighted, f, f0, lam, g=g, out=out, **settings)
        if len(past) >= _SWEEPS:
            past.clear()
        # with the arrays, lest another one gets the number of one that is gone
        past[key] = (recorder._recorded, arrays)
        return out

    def finish(self) -> None:
        wp.synchronize_device(self._on)


def make(device: Device, dtype: npt.DTypeLike) -> Backend:
    """The backend on this device."""
    return WarpBackend(device, dtype)
