"""The energy of a problem on the host in float64, with all its first and second derivatives.

One gradient norm for all channels: a problem with one norm per channel is cut into its channels before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .. import backends
from ..arrays import FloatArray, IntArray
from ..graphs.components import Components
from ..graphs.grid import GridGraph
from ..model.matrices import Edges, undirected_edges
from ..model.on_device import DeviceProblem
from ..model.problem import Problem

if TYPE_CHECKING:
    import numpy.typing as npt
    from scipy.sparse import csc_array, csr_array


@dataclass(frozen=True, eq=False)
class HostEnergy:
    """The energy of eq. 19 with eps (eq. 15) on the host.

    Attributes
    ----------
    on : DeviceProblem
        The problem in float64, on the numpy backend.
    edges : Edges
        Each undirected edge once; those of weight 0 too.
    start, end : (D,) int array
        The ends of the directed edges: row k is (u, v) of edge k, row E + k its opposite.
    own, other : (D,) float array
        gamma(u, v) and gamma(v, u) of each.
    f0 : (n, m) float array
    lam : (n, 1) float array
        The fidelity; 0 where f is pinned.
    pinned : (n,) bool array
        Where lam is infinite.
    without_data : (n,) bool array
        The vertices of connected components without any data; f is a constant there.
    p, eps : float
    """

    on: DeviceProblem
    edges: Edges
    start: IntArray
    end: IntArray
    own: FloatArray
    other: FloatArray
    f0: FloatArray
    lam: FloatArray
    pinned: npt.NDArray[np.bool_]
    without_data: npt.NDArray[np.bool_]
    p: float
    eps: float

    @classmethod
    def of(cls, problem: Problem) -> HostEnergy:
        """Make the energy of a problem in the units of its frame, from its data in float64."""
        data = problem.f0 if problem.data is None else problem.data
        exact = replace(problem, f0=problem.frame.into(data, np.dtype(np.float64)))
        on = DeviceProblem.put(exact, backends.get("numpy", np.float64))
        graph, n = problem.graph, problem.graph.n_vertices
        inside = np.ones(n, bool)
        if isinstance(graph, GridGraph) and graph.mask is not None:
            inside = graph.mask.ravel()
        edges = undirected_edges(on)
        edges = edges[inside[edges.u] & inside[edges.v]]
        given = np.broadcast_to(problem.lam, (n, 1))[:, 0]
        pinned = np.isinf(given) | ~inside
        lam = np.where(pinned, 0, given)
        return cls(
            on,
            edges,
            np.concatenate([edges.u, edges.v]),
            np.concatenate([edges.v, edges.u]),
            np.concatenate([edges.there, edges.back]),
            np.concatenate([edges.back, edges.there]),
            exact.f0,
            lam[:, None],
            pinned,
            _without_data(edges, pinned | (lam > 0)),
            problem.p,
            problem.eps,
        )

    def with_eps(self, eps: float) -> HostEnergy:
        """Return the same energy with another eps."""
        return replace(self, eps=eps)

    @property
    def share(self) -> float:
        """The part of a gradient norm that counts: edges have two, one from each end."""
        return 0.5 if self.on.edge_norm else 1.0

    @property
    def group(self) -> IntArray | slice:
        """The gradient norm of each directed edge: its own (edge norm), or that of its start, (D,)."""
        return slice(None) if self.on.edge_norm else self.start

    @property
    def solved(self) -> npt.NDArray[np.bool_]:
        """The vertices whose value is computed, (n,): not pinned, and in a component with data."""
        return ~(self.pinned | self.without_data)

    @cached_property
    def matrix(self) -> csr_array:
        """d_w (eq. 4), (D, n)."""
        from scipy.sparse import csr_array

        rows = len(self.start)
        values = np.stack([self.other, -self.own], axis=1).ravel()
        columns = np.stack([self.end, self.start], axis=1).ravel()
        return csr_array((values, columns, np.arange(0, 2 * rows + 1, 2)), shape=(rows, len(self.f0)))

    @cached_property
    def adjoint(self) -> csc_array:
        """The transpose of d_w, (n, D)."""
        return self.matrix.T

    def grouped(self, x: FloatArray) -> FloatArray:
        """Sum a number per directed edge, (D,), over the edges of each gradient norm."""
        if self.on.edge_norm:
            return x
        sums: FloatArray = np.bincount(self.start, x, minlength=len(self.f0)).astype(np.float64)
        return sums

    def at(self, f: FloatArray) -> Point:
        """Return the energy's parts at f, (n, m)."""
        return Point(self, f)


def _without_data(edges: Edges, known: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Find the vertices of connected components without a known vertex, both (n,)."""
    if known.all():
        return np.zeros(len(known), bool)
    joined = (edges.there > 0) & (edges.back > 0)
    return Components.of_edges(len(known), edges.u[joined], edges.v[joined]).without(known)


@dataclass(frozen=True, eq=False)
class Point:
    """A function f, and what the derivatives of the energy need there.

    With the squared gradient norms q = |df|^2 + eps^2, each of a group of edges, the energy has the conductances
    c = q^((p-2)/2), whose derivative with respect to q is half of bend = (p-2) q^((p-4)/2).

    Attributes
    ----------
    energy : HostEnergy
    f : (n, m) float array
    """

    energy: HostEnergy
    f: FloatArray

    @cached_property
    def df(self) -> FloatArray:
        """The difference of f, (D, m)."""
        found: FloatArray = self.energy.matrix @ self.f
        return found

    @cached_property
    def q(self) -> FloatArray:
        """The squared gradient norms with eps, one per group."""
        return self.energy.grouped((self.df**2).sum(axis=1)) + self.energy.eps**2

    def power(self, exponent: float) -> FloatArray:
        """Compute a power of q; a negative power of 0 counts 0, as it is multiplied by a difference that is 0."""
        if exponent >= 0:
            found: FloatArray = self.q**exponent
            return found
        return np.where(self.q > 0, np.where(self.q > 0, self.q, 1) ** exponent, 0)

    @cached_property
    def c(self) -> FloatArray:
        """The conductances, one per group."""
        return self.power((self.energy.p - 2) / 2)

    @cached_property
    def bend(self) -> FloatArray:
        """Twice the derivative of the conductances with respect to q, one per group."""
        p = self.energy.p
        return (p - 2) * self.power((p - 4) / 2) if p != 2 else np.zeros_like(self.q)

    @cached_property
    def flux(self) -> FloatArray:
        """The derivative of the smoothness with respect to df, (D, m)."""
        e = self.energy
        return e.share * self.c[e.group][:, None] * self.df

    @property
    def value(self) -> float:
        """The energy."""
        e = self.energy
        smooth = e.share * (self.q ** (e.p / 2)).sum() / e.p
        return float(smooth + (e.lam * (self.f - e.f0) ** 2).sum() / 2)

    @cached_property
    def gradient(self) -> FloatArray:
        """The gradient, (n, m); 0 where f is not computed."""
        e = self.energy
        found: FloatArray = e.solved[:, None] * (e.lam * (self.f - e.f0) + e.adjoint @ self.flux)
        return found

    @property
    def rounding(self) -> FloatArray:
        """About the rounding error of the gradient, (n, m)."""
        e, unit = self.energy, float(np.finfo(np.float64).eps)
        size = np.abs(self.f)
        each = abs(e.matrix) @ size
        steep = e.share * (self.c + abs(e.p - 2) * self.power((e.p - 2) / 2))[e.group][:, None]
        found: FloatArray = unit * (e.lam * (size + np.abs(e.f0)) + abs(e.adjoint) @ (steep * each))
        return found

    def spread_out(self, x: FloatArray) -> FloatArray:
        """Return a function (n, m) with these numbers at the values that are computed, and 0 elsewhere."""
        out = np.zeros(self.f.shape)
        out[self.energy.solved] = x.reshape(-1, self.f.shape[1])
        return out
