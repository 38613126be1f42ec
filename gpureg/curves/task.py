"""Prepare curves for a run of the model, and put its result back: :class:`Task`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.csr import Graph
from .chain import Chain
from .cleaning import Cleaned, Found
from .curves import Curves
from .fidelity import fitted


@dataclass(frozen=True, eq=False)
class Task:
    """What to regularize: the vertices of all curves without repeats and outliers, cut at their gaps.

    Attributes
    ----------
    cleaned : list of Cleaned
    orders : list of (k,) int arrays
        The order of the vertices of each curve in the graph: indices in ``Cleaned.alive``.
    graph : Graph
    f0 : (m, d) array
        Their positions, each curve about its mean.
    fidelity : (m,) array
        Infinite where a vertex is pinned.
    lam : tuple of float
        The fidelity of each curve.
    minimiser : (m, d) array or None
        The result for p = 2, if it is known.
    """

    cleaned: list[Cleaned]
    orders: list[IntArray]
    graph: Graph
    f0: FloatArray
    fidelity: FloatArray
    lam: tuple[float, ...]
    minimiser: FloatArray | None

    @classmethod
    def of(
        cls,
        curves: Curves,
        lam: float | FloatArray | None,
        sigma: float | None,
        p: float,
        held: npt.NDArray[np.bool_],
        keep_ends: bool,
        whole: bool,
    ) -> Task:
        """Find the task.

        Parameters
        ----------
        curves : Curves
        lam : float or (n,) array, optional
            The caller's fidelity: the curves stay as they are.
        sigma : float, optional
        p : float
        held : (n,) bool array
            Vertices that do not move.
        keep_ends : bool
        whole : bool
            Whether the curves stay as they are also without `lam`.
        """
        fixed = curves.split(held)
        robust = lam is None and not whole
        cleaned = [
            Cleaned(x, shut, still, sigma, robust)
            for x, shut, still in zip(curves.points, curves.closed, fixed, strict=True)
        ]
        pinned = []
        for curve, still, shut in zip(cleaned, fixed, curves.closed, strict=True):
            pins = np.zeros(len(curve.merged), bool)
            np.logical_or.at(pins, curve.of, still)
            if keep_ends and not shut:
                pins[[0, -1]] = True
            pinned.append(pins)
        minimiser: FloatArray | None = None
        if lam is None:
            fits = fitted(cleaned, pinned, p)
            each = [fit.lam for fit in fits]
            free = [np.median(fit[np.isfinite(fit)]) if np.isfinite(fit).any() else math.inf for fit in each]
            known = tuple(float(x) for x in free)
        else:
            each = (
                curves.split(lam.copy())
                if isinstance(lam, np.ndarray)
                else [np.full(len(x), lam) for x in curves.points]
            )
            known = () if isinstance(lam, np.ndarray) else (lam,) * len(each)
            each = [np.where(pins, math.inf, x) for x, pins in zip(each, pinned, strict=True)]
        parts = [curve.pieces() for curve in cleaned]
        orders = [order for order, *_ in parts]
        chain = Chain(np.concatenate([part[1] for part in parts]), np.concatenate([part[2] for part in parts]))
        f0 = np.concatenate([_centred(c.points, c.points)[order] for c, order in zip(cleaned, orders, strict=True)])
        if lam is None and p == 2:
            minimiser = np.concatenate(
                [_centred(fit.u, c.points)[order] for fit, c, order in zip(fits, cleaned, orders, strict=True)]
            )
        fidelity = np.concatenate([x[order] for x, order in zip(each, orders, strict=True)])
        return cls(cleaned, orders, chain.graph(f0), f0, fidelity, known, minimiser)

    @property
    def sigma(self) -> tuple[float, ...]:
        """The noise of each curve."""
        return tuple(float(np.median(curve.sigma)) for curve in self.cleaned)

    @property
    def found(self) -> tuple[Found, ...]:
        """What was found in each curve."""
        return tuple(curve.found() for curve in self.cleaned)

    def displacements(self, value: FloatArray) -> FloatArray:
        """Compute the displacement of each vertex of the input, (n, d), from new positions (m, d) in the graph."""
        moves, begin = [], 0
        for curve, order in zip(self.cleaned, self.orders, strict=True):
            mine = slice(begin, begin + len(order))
            begin += len(order)
            moved = np.empty_like(value[mine])
            # exactly 0 for a vertex that is pinned, or if nothing was done
            moved[order] = value[mine] - self.f0[mine]
            new = curve.points + moved
            step = curve.filled(new) - curve.merged
            step[curve.alive] = moved
            moves.append(step[curve.of])
        return np.concatenate(moves)


def _centred(x: FloatArray, by: FloatArray) -> FloatArray:
    centred: FloatArray = x - by.mean(axis=0)
    return centred
