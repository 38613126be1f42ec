"""A problem on a device."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..backends import Array, Backend, Box, Conductance, Smoothness, Weighted
from ..frame import Frame
from ..weights import Weights
from .bipartite import has_swinging_part
from .problem import Gamma, Problem


@dataclass(frozen=True, eq=False)
class DeviceProblem:
    """A problem with its arrays on a device, as a solver needs it.

    Attributes
    ----------
    problem : Problem
    backend : Backend
    weighted : Weighted
        The graph with its weights.
    f0 : device function, (n, m)
        The data, in the device's variable.
    lam : float or device function, (n, 1)
        The fidelity, in the device's variable.
    scale : (n, 1) array or None
        The factor s below.
    box : Box or None
        Bounds on a minimiser, in the device's variable, which a certificate needs where lam is 0; None without.
    without_data : str
        The components without data that were set to a constant, and which one, in words; empty if there are none.

    Notes
    -----
    A gamma with a factor per vertex, gamma_uv = sqrt(w) s(u), is a change of variable: g = s f gives the problem of
    gamma = sqrt(w) with data s f0 and fidelity lam/s^2, with the same eps and energy. Kernels and solvers therefore
    only need sqrt(w), and `scale` is s.
    """

    problem: Problem
    backend: Backend
    weighted: Weighted
    f0: Array
    lam: float | Array
    scale: FloatArray | None
    box: Box | None = None
    without_data: str = ""

    @classmethod
    def put(cls, problem: Problem, backend: Backend, reference: FloatArray | None = None) -> DeviceProblem:
        """Put a problem on a device, with weights computed there from `reference`, (n, m), or from the data."""
        graph = problem.graph
        if not isinstance(problem.gamma, str):
            weighted = backend.prepare_gamma(graph, problem.gamma)
        elif isinstance(problem.weights, Weights):
            compared = problem.f0 if reference is None else reference
            weights, frame = problem.weights, Frame.of(compared)
            if problem.data is None and (own := weights.scaled(frame.scale)) is not None:
                # an operator's data are in their own units; the weights need not be
                weights, compared = own, frame.into(compared, backend.dtype)
            weighted = weights.prepare(backend, graph, compared)
        else:
            weighted = backend.prepare(graph, problem.weights)
        scale = _vertex_scale(problem.gamma, backend, weighted)
        f0 = problem.f0 if scale is None else problem.f0 * scale
        return cls(problem, backend, weighted, backend.put(graph, f0), put_lam(problem, backend, scale), scale)

    def changed(self, problem: Problem) -> DeviceProblem:
        """Return the problem with the same data, graph and weights, but another p, lam or eps."""
        return replace(self, problem=problem, lam=put_lam(problem, self.backend, self.scale))

    @property
    def p(self) -> float:
        """Degree of regularity."""
        return self.problem.p

    @property
    def eps(self) -> float:
        """Smoothing of the gradient norm."""
        return self.problem.eps

    @property
    def coupled(self) -> bool:
        """Whether all channels have one gradient norm, or one each."""
        return self.problem.coupled

    @property
    def edge_norm(self) -> bool:
        """Whether the smoothness is that of eq. 30."""
        return self.problem.norm == "edge"

    @property
    def channels(self) -> int:
        """Number of channels."""
        return int(self.problem.f0.shape[1])

    def swings(self) -> bool:
        """Return whether plain sweeps can oscillate between two states (on a bipartite part without data)."""
        if np.min(self.problem.lam) > 0:  # avoids reading the weights from the device
            return False
        return has_swinging_part(self.problem.graph, self.host_gamma(), self.problem.lam)

    def host_gamma(self) -> FloatArray | None:
        """Return the weights, or the given values of gamma, on the host; None if all edges have weight 1."""
        if self.weighted.directed:
            assert not isinstance(self.problem.gamma, str)
            return self.problem.gamma
        return self.backend.get_weights(self.weighted)

    def scratch(self) -> Array | None:
        """Allocate scratch memory for the conductances, if a sweep needs it."""
        if not self.model.has_function:
            return None
        return self.backend.empty(self.weighted.graph, self.model.norms(self.channels))

    @property
    def model(self) -> Smoothness:
        """The settings of the smoothness for a primitive: p, eps, coupled, edge."""
        return self.problem.smoothness

    def conductances(self, f: Array, g: Array | None = None) -> Conductance:
        """Compute the conductances at a device function, (n, m); `g` is scratch memory."""
        return self.backend.conductances(self.weighted, f, self.model, g=g)

    def put_function(self, f: FloatArray) -> Array:
        """Put a host function in the problem's variable, (n, m), on the device."""
        return self.backend.put(self.weighted.graph, f if self.scale is None else f * self.scale)

    def get_function(self, f: Array) -> FloatArray:
        """Read a device function as the problem's f, (n, m)."""
        host = self.backend.get(self.weighted.graph, f)
        return host if self.scale is None else (host / self.scale).astype(host.dtype)

    def change(self, a: Array, b: Array) -> float:
        """Compute the largest difference of two device functions, (n, m), as the problem's f; infinity for a NaN."""
        if self.scale is None:
            return self.backend.max_change(self.weighted.graph, a, b)
        # the device has s f: read it only at a check, and only for these gammas
        difference = self.get_function(a).astype(np.float64) - self.get_function(b)
        largest = float(np.abs(difference).max())
        return largest if math.isfinite(largest) else math.inf

    def energy(self, f: Array) -> float:
        """Compute the eps-smoothed energy of a device function, (n, m)."""
        return self.backend.energy(self.weighted, f, self.f0, self.lam, self.model)

    def duality_gap(self, f: Array, y: Array) -> float:
        """Compute the energy of a device function, in the box, minus the dual energy of one on the edges."""
        return self.backend.duality_gap(self.weighted, f, y, self.f0, self.lam, self.model, box=self.box)


def put_lam(problem: Problem, backend: Backend, scale: FloatArray | None) -> float | Array:
    """Put the fidelity on the device, in the device's variable; `scale` is (n, 1)."""
    lam = problem.lam
    if scale is not None:
        lam = np.broadcast_to(lam, scale.shape) / scale**2
    # a number > 0 and finite stays so in the type of the device
    limits = np.finfo(backend.dtype)
    lam = np.where((lam > 0) & (lam < np.inf), np.clip(lam, limits.tiny, limits.max), lam)
    return float(lam) if lam.ndim == 0 else backend.put(problem.graph, lam)


def _vertex_scale(gamma: Gamma | FloatArray, backend: Backend, weighted: Weighted) -> FloatArray | None:
    """Return the factor s(u) of gamma_uv = sqrt(w) s(u), (n, 1), 1 at a vertex without weight; None if not needed."""
    if not isinstance(gamma, str) or gamma == "sqrt":
        return None
    n = weighted.graph.n_vertices
    if gamma == "combinatorial":
        return np.full((n, 1), math.sqrt(0.5))
    degree = backend.get(weighted.graph, backend.degree(weighted)).astype(np.float64)
    factor = 2.0 if gamma == "normalized" else 1.0
    scale: FloatArray = 1 / np.sqrt(np.where(degree > 0, factor * degree, 1))
    return scale
