"""The derivatives of one problem in the units of its frame, and those in the units and forms of the caller."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..graphs.grid import GridGraph
from ..model.problem import Problem
from .energy import HostEnergy
from .partials import Partials


@dataclass(frozen=True, eq=False)
class Part:
    """The derivatives of L with respect to what one problem depends on, for one or all channels.

    Attributes
    ----------
    f0 : (n, m) float array
    lam : (n,) float array
        One per vertex; 0 where f is pinned.
    edges : (D,) float array
        With respect to gamma(u, v), if it was given as an array; otherwise with respect to the weight of each directed
        edge, where both directions of an edge have half of the derivative with respect to its weight.
    p, eps : float
    """

    f0: FloatArray
    lam: FloatArray
    edges: FloatArray
    p: float
    eps: float

    @classmethod
    def none(cls, energy: HostEnergy) -> Part:
        """Return derivatives that are 0."""
        return cls(np.zeros_like(energy.f0), np.zeros(len(energy.f0)), np.zeros(len(energy.start)), 0.0, 0.0)

    @classmethod
    def of(cls, partials: Partials, *, sign: float, f0: FloatArray) -> Part:
        """Make the derivatives from those of S, times a sign; `f0`, (n, m), is that of the data."""
        energy = partials.point.energy
        if isinstance(energy.on.problem.gamma, str):
            once = partials.weights() / 2
            edges = np.concatenate([once, once])
        else:
            edges = partials.gamma()
        lam = np.where(energy.pinned, 0, partials.lam)
        return cls(f0, sign * lam, sign * edges, sign * partials.p, sign * partials.eps)

    def plus(self, other: Part) -> Part:
        """Return the sum of the derivatives."""
        return Part(*(getattr(self, field.name) + getattr(other, field.name) for field in fields(self)))

    def in_units_of_the_data(self, energy: HostEnergy) -> Part:
        """Convert from the units of the frame, for an L whose gradient was taken in those of the data.

        With data = offset + scale f the frame has the eps divided by the scale, and the fidelity lam scale^(2-p), which
        depends on p.
        """
        problem = energy.on.problem
        scale, p = problem.frame.scale, problem.p
        through_lam = float((self.lam * energy.lam[:, 0]).sum())
        return replace(
            self,
            # the gradient in units of the frame is scale times as large: all derivatives grow by it
            lam=scale * self.lam * scale ** (2 - p),
            edges=scale * self.edges,
            p=scale * (self.p - math.log(scale) * through_lam),
        )


def joined(parts: Sequence[Part]) -> Part:
    """Join the derivatives of the channels: those of what they share are sums."""
    f0 = np.concatenate([part.f0 for part in parts], axis=1)
    shared = functools.reduce(Part.plus, [replace(part, f0=np.zeros(1)) for part in parts])
    return replace(shared, f0=f0)


def lam_as_given(problem: Problem, lam: FloatArray) -> Any:
    """Return derivatives per vertex, (n,), in the form of lam: a number, or an array of the shape of the vertices."""
    if problem.lam.ndim == 0:
        return float(lam.sum())
    return lam.reshape(problem.graph.shape) if isinstance(problem.graph, GridGraph) else lam


def edges_as_given(energy: HostEnergy, values: FloatArray) -> npt.NDArray[np.float64]:
    """Return a number per directed edge, (D,), as (n_edges,) for a stored graph, (*shape, K) for a grid."""
    graph = energy.on.problem.graph
    place = np.concatenate([energy.edges.place, energy.edges.place_back])
    if not isinstance(graph, GridGraph):
        found = np.zeros(graph.n_edges)
        found[place] = values
        return found
    planes = np.zeros((len(graph.offsets), graph.n_vertices))
    planes.reshape(-1)[place] = values
    return np.ascontiguousarray(planes.T).reshape(*graph.shape, len(graph.offsets))
