"""What the vertices without data are joined to (:class:`Joined`), and heavier edges at the vertices with data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray, computed_type
from ..backends import Chosen
from ..checks import choice, number
from ..graphs.components import Components
from ..graphs.grid import AnyGraph, GridGraph
from ..model.matrices import Edges, undirected_edges
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from ..weights import Weights

Reweighting = Literal["wnll", "none"]


@dataclass(frozen=True, eq=False)
class Joined:
    """The weighted edges of a graph, and its components.

    Attributes
    ----------
    graph : Graph or GridGraph
    known : (n,) bool array
        The vertices with data.
    edges : Edges
        The undirected edges, with both values of gamma.
    components : Components
        Those of the edges of weight > 0.
    """

    graph: AnyGraph
    known: npt.NDArray[np.bool_]
    edges: Edges
    components: Components

    @classmethod
    def of(
        cls,
        f0: FloatArray,
        graph: AnyGraph,
        known: npt.NDArray[np.bool_],
        *,
        weights: Weights | npt.ArrayLike | None = None,
        gamma: str | npt.ArrayLike = "sqrt",
        backend: Chosen = "auto",
        dtype: npt.DTypeLike | None = None,
        wanted: npt.NDArray[np.bool_] | None = None,
    ) -> Joined:
        """Compute the weights and find the components; weight functions compare f0, (n, m).

        With `wanted`, (n,), only edges with at least one end wanted are there.
        """
        kind = computed_type(dtype)
        problem = Problem.make(f0, graph, lam=0.0, weights=weights, gamma=gamma, eps=0.0, dtype=kind, framed=True)
        edges = undirected_edges(DeviceProblem.put(problem, backends.get(backend, kind)), wanted)
        joined = (edges.there > 0) & (edges.back > 0)
        return cls(graph, known, edges, Components.of_edges(graph.n_vertices, edges.u[joined], edges.v[joined]))

    @property
    def reached(self) -> npt.NDArray[np.bool_]:
        """Whether a vertex has data, or is joined to one with data by edges of weight > 0, (n,)."""
        return ~self.components.without(self.known)

    def reweighted(self, factor: float | Literal["wnll"]) -> FloatArray:
        """Multiply gamma(u, v) gamma(v, u) of each edge at a vertex with data by a factor.

        "wnll" is (1 + n / k) / 2 for k of n vertices with data, counted in the component of the edge.

        Returns
        -------
        array
            One number per directed edge, in the form of the `weights` of :func:`gpureg.regularize`.
        """
        edges, labels = self.edges, self.components.labels
        factors = np.full(self.components.count, factor) if factor != "wnll" else self._sampling()
        at_data = self.known[edges.u] | self.known[edges.v]
        values = edges.there * edges.back * np.where(at_data, factors[labels[edges.u]], 1.0)
        if not isinstance(self.graph, GridGraph):
            weights = np.zeros(self.graph.n_edges)
            weights[edges.place] = weights[edges.place_back] = values
            return weights
        planes = np.zeros((len(self.graph.offsets), self.graph.n_vertices))
        planes.reshape(-1)[edges.place] = values
        planes.reshape(-1)[edges.place_back] = values
        return planes.T.reshape(*self.graph.shape, -1)

    def _sampling(self) -> FloatArray:
        """Return the factor of weighted nonlocal Laplacians in each component, (c,).

        The sum of Shi, Osher and Zhu counts the differences at a vertex with data n/k times, at others once: an edge is
        in it from both of its ends.
        """
        known = np.maximum(self.components.sums(self.known), 1)
        factors: FloatArray = (1 + self.components.sizes() / known) / 2
        return factors


def as_reweighting(
    reweighting: Reweighting | float | None, p: float, gamma: str | npt.ArrayLike
) -> float | Literal["wnll"] | None:
    """Check a reweighting; None leaves the weights as they are.

    Raises
    ------
    ValueError, TypeError
        A number that is not > 0, an unknown name, or a gamma that is not a function of the weight alone.
    """
    symmetric = isinstance(gamma, str) and gamma in ("sqrt", "combinatorial")
    if reweighting is None:
        return "wnll" if p == 2 and symmetric else None
    if isinstance(reweighting, str):
        if choice("reweighting", reweighting, ("wnll", "none")) == "none":
            return None
    elif number("reweighting", reweighting, above=0) == 1:
        return None
    if not symmetric:
        raise ValueError("reweighting needs gamma='sqrt' or 'combinatorial': leave it None, or 'none'")
    return "wnll" if isinstance(reweighting, str) else float(reweighting)
