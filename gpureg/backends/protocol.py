"""The protocol of the primitives: those that every backend implements, and those that it may override.

Their equations are in ``kernels/README.md``; ``data.py`` has the protocol for functions and weights.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from ..arrays import FloatArray
from ..graphs.grid import AnyGraph, GridGraph
from .cells import CellPrimitives
from .cosines import CosineSolves
from .curvature import Curvature
from .groups import GroupPrimitives
from .multilevel import Multilevel
from .patches import (
    PatchForm,
)
from .scalars import Scalars
from .types import Array, Conductance, Smoothness, Storage, Weighted, expect_stored
from .zones import Zones


class Backend(CosineSolves, Curvature, Multilevel, Scalars, CellPrimitives, GroupPrimitives, Zones):
    """One device that computes in one floating-point type.

    Parameters
    ----------
    device : Device
    dtype : dtype
        float32 or float64.
    """

    # Primitives. A public method allocates `out` if it is None; the method with an underscore writes into it.

    @abstractmethod
    def patch_distance(
        self, graph: AnyGraph, f: Array | FloatArray, form: PatchForm, *, storage: Storage = "full"
    ) -> Weighted:
        """Compute weights from patches of `f`, a device function, or a host function (n, m).

        On a grid, weights can be stored in float16 ("half"): the relative error is at most 2^-11, or the absolute one
        2^-25 for weights below 2^-14. Weights of patches of one cell can be recomputed at each use ("none").

        Raises
        ------
        BackendUnavailable
            A storage that this backend or kind of graph does not support.
        """

    def degree(self, weighted: Weighted) -> Array:
        """Sum the weights (or gamma(u, v)^2, if given) around each vertex, 1 channel."""
        out = self.empty(weighted.graph, 1)
        self._degree(weighted, out)
        return out

    @abstractmethod
    def _degree(self, weighted: Weighted, out: Array) -> None: ...

    def largest_weight(self, weighted: Weighted) -> Array:
        """Find the largest weight (or gamma(u, v)^2, if given) around each vertex, 1 channel; 0 without neighbours."""
        out = self.empty(weighted.graph, 1)
        self._largest_weight(weighted, out)
        return out

    @abstractmethod
    def _largest_weight(self, weighted: Weighted, out: Array) -> None: ...

    def aggregate(
        self, weighted: Weighted, f: Array, share: Array, centre: Array, radius: int, *, out: Array | None = None
    ) -> Array:
        """Sum the neighbours' values with the weights of all patches that cover a vertex of a grid.

        `share` and `centre` have 1 channel; the weights are stored.
        """
        expect_stored(weighted)
        out = self._out(weighted.graph, self.channels(f), out)
        self._aggregate(weighted, f, share, centre, radius, out)
        return out

    @abstractmethod
    def _aggregate(
        self, weighted: Weighted, f: Array, share: Array, centre: Array, radius: int, out: Array
    ) -> None: ...

    def difference(self, weighted: Weighted, f: Array, *, out: Array | None = None) -> Array:
        """Compute the difference d_w f, a function on the directed edges."""
        out = self.empty_edges(weighted.graph, self.channels(f)) if out is None else out
        self._difference(weighted, f, out)
        return out

    @abstractmethod
    def _difference(self, weighted: Weighted, f: Array, out: Array) -> None: ...

    def adjoint(self, weighted: Weighted, H: Array, *, out: Array | None = None) -> Array:
        """Apply the adjoint of the difference to a function on the directed edges."""
        out = self._out(weighted.graph, self.channels(H), out)
        self._adjoint(weighted, H, out)
        return out

    @abstractmethod
    def _adjoint(self, weighted: Weighted, H: Array, out: Array) -> None: ...

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
        """Compute a power of the gradient norm: 1 channel if coupled, otherwise one per channel of f.

            (|grad f|^2 + eps^2)^power

        With an `edge_power`:

            (sum over the edges of (d^2 + eps^2)^edge_power)^power
        """
        out = self._out(weighted.graph, 1 if coupled else self.channels(f), out)
        self._gradient_norm(weighted, f, power, eps, coupled, edge_power, out)
        return out

    @abstractmethod
    def _gradient_norm(
        self,
        weighted: Weighted,
        f: Array,
        power: float,
        eps: float,
        coupled: bool,
        edge_power: float | None,
        out: Array,
    ) -> None: ...

    def p_laplacian(self, weighted: Weighted, f: Array, g: Conductance, *, out: Array | None = None) -> Array:
        """Compute the p-Laplacian of f, given the conductances."""
        out = self._out(weighted.graph, self.channels(f), out)
        self._p_laplacian(weighted, f, g, out)
        return out

    @abstractmethod
    def _p_laplacian(self, weighted: Weighted, f: Array, g: Conductance, out: Array) -> None: ...

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
        """Do one sweep of the Gauss-Jacobi process, given the conductances; `out` must not be f."""
        out = self._out(weighted.graph, self.channels(f), out)
        self._jacobi_step(weighted, f, f0, g, lam, theta, out)
        return out

    @abstractmethod
    def _jacobi_step(
        self, weighted: Weighted, f: Array, f0: Array, g: Conductance, lam: float | Array, theta: float, out: Array
    ) -> None: ...

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
        """Do one step of the explicit Euler process, given the conductances; `out` must not be f."""
        out = self._out(weighted.graph, self.channels(f), out)
        self._euler_step(weighted, f, f0, g, lam, tau, out)
        return out

    @abstractmethod
    def _euler_step(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        g: Conductance,
        lam: float | Array,
        tau: float | Array,
        out: Array,
    ) -> None: ...

    # Several primitives in one; a backend with a fused kernel overrides them

    def conductances(self, weighted: Weighted, f: Array, model: Smoothness, *, g: Array | None = None) -> Conductance:
        """Compute the conductances for the p-Laplacian and both processes.

        `g` is scratch memory with one channel per gradient norm.
        """
        if model.edge:
            return model
        if model.p == 2:
            return None
        return self.gradient_norm(weighted, f, power=model.power, eps=model.eps, coupled=model.coupled, out=g)

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
        """Compute the conductances and do one Jacobi step, from `f` to `out`.

        `g` is scratch memory as in :meth:`conductances`.
        """
        found = self.conductances(weighted, f, model, g=g)
        return self.jacobi_step(weighted, f, f0, found, lam, theta=theta, out=out)

    def similarity_step(
        self,
        graph: GridGraph,
        f: Array | FloatArray,
        form: PatchForm,
        f0: Array,
        lam: float | Array,
        *,
        guide: Array | FloatArray | None = None,
        largest: bool = False,
        out: Array | None = None,
    ) -> Array:
        """Do one Jacobi sweep at p = 2 from `f` with weights computed from patches.

        `f` is a device function, or a host function (n, m). The patches are those of `guide`, another one of q
        channels, by default those of f. With `largest`, lam is in
        units of the largest weight around each vertex. A fused kernel does not store the weights. This is one step of
        the bilateral filter, or of nonlocal means.
        """
        weighted = self.patch_distance(graph, f if guide is None else guide, form)
        if largest:
            lam = self._in_units(graph, lam, self.largest_weight(weighted))
        return self.jacobi_step(weighted, self.on_device(graph, f), f0, None, lam, out=out)

    def _in_units(self, graph: GridGraph, lam: float | Array, units: Array) -> Array:
        """Multiply lam by the function `units`; infinite values stay infinite."""
        given = lam if isinstance(lam, float | int) else self.get(graph, lam)
        fidelity = np.broadcast_to(np.asarray(given, self.dtype), (graph.n_vertices, 1))
        finite = np.where(np.isinf(fidelity), 0, fidelity) * self.get(graph, units)
        return self.put(graph, np.where(np.isinf(fidelity), fidelity, finite))

    def finish(self) -> None:
        """Wait until the device has finished all work."""

    def release(self) -> None:
        """Free memory of the device that is only a cache; for a new try after its memory has run out."""
