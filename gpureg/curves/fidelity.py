"""Choose the fidelity of curves by Stein's estimate of the error: :func:`fitted`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from .chain import Chain
from .cleaning import Cleaned
from .noise import TELLING

# Candidates: five in two decades; the best is refined twice, to ten per decade.
_FIDELITIES = np.logspace(-6, 4, 26)
_FINER = (10**0.2, 10**0.1)
# Windows, in vertices, over which the estimate is averaged for a fidelity that varies; a piece must have six of them.
_WINDOWS, _LEAST = (320, 80, 20), 6
# A narrower window must lower the estimated error by this factor.
_MARGIN = 0.85
# Instead of infinity, where a vertex is pinned.
_PINNED = 1e12
# The least noise that counts, of the largest in a piece.
_RANGE = 0.01
# Searches for outliers that only the fit shows.
_ROUNDS = 3


# The vertices of a curve in the order of its pieces, the sizes of these, and which are rings.
Pieces = tuple[IntArray, IntArray, npt.NDArray[np.bool_]]


@dataclass(frozen=True, eq=False)
class Fit:
    """The fit of one curve at p = 2: the fidelity and the positions (k,) and (k, d) of its vertices in ``alive``."""

    lam: FloatArray
    u: FloatArray


def fitted(curves: Sequence[Cleaned], pinned: Sequence[npt.NDArray[np.bool_]], p: float) -> list[Fit]:
    """Choose the fidelity at each vertex, and find outliers that only the fit shows, which are taken out of `curves`.

    Parameters
    ----------
    curves : sequence of Cleaned
    pinned : sequence of (m,) bool arrays
        Merged vertices of each curve that do not move.
    p : float
        For p = 2 the fidelity varies along a curve where that lowers the error. For another p it is one number for each
        piece, times G^(p - 2), with G the root mean square of the gradient norm of the fit at p = 2.

    Returns
    -------
    list of Fit
        The fidelity is infinite where there is no noise.
    """
    fits: dict[int, Fit] = {}
    todo = list(range(len(curves)))
    for attempt in range(_ROUNDS + 1):
        found = _fits([curves[k] for k in todo], [pinned[k] for k in todo], p)
        again = []
        for k, (fit, leverage) in zip(todo, found, strict=True):
            fits[k] = fit
            if attempt < _ROUNDS and curves[k].refit(fit.u, leverage):
                again.append(k)
        todo = again
        if not todo:
            break
    return [fits[k] for k in range(len(curves))]


class _Search:
    """Stein's estimate of the error of all pieces of several curves.

    Per vertex, in units of the variance: |u - f|^2 / sigma^2 + 2 d h.
    """

    def __init__(self, chain: Chain, f: FloatArray, sigma: FloatArray, still: npt.NDArray[np.bool_]) -> None:
        self.chain, self.f, self.still = chain, f, still
        self.free = np.add.reduceat(~still, chain.starts).astype(np.float64) * f.shape[1]
        # where the noise varies along a piece, so does the fidelity, as 1 / sigma^2
        most = np.maximum.reduceat(np.where(still, 0, sigma), chain.starts)
        least = np.maximum(np.minimum.reduceat(np.where(still, math.inf, sigma), chain.starts), _RANGE * most)
        most, least = np.where(most > 0, most, 1), np.where(most > 0, least, 1)
        sigma = np.maximum(sigma, self.spread(least))
        self.inverse = np.where(still, 0.0, sigma**-2.0)
        self.held = np.where(still, _PINNED, self.spread(most * least) / sigma**2)

    def fit(self, lam: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Fit with the fidelity `lam` (n,) times that of the noise.

        Returns
        -------
        u : (n, d) array
        h : (n,) array
            The leverages.
        cost : (n,) array
            The estimate at each vertex; 0 where it is pinned.
        """
        u, h = self.chain.smooth(self.f, lam * self.held)
        cost = ((u - self.f) ** 2).sum(axis=1) * self.inverse + 2 * self.f.shape[1] * h * ~self.still
        return u, h, cost

    def per_piece(self, cost: FloatArray) -> FloatArray:
        """Sum over pieces, (c,)."""
        sums: FloatArray = np.add.reduceat(cost, self.chain.starts)
        return sums

    def spread(self, values: FloatArray) -> FloatArray:
        """Repeat a number of each piece at its vertices, (n,)."""
        return np.repeat(values, self.chain.sizes)


def _fits(curves: Sequence[Cleaned], pinned: Sequence[npt.NDArray[np.bool_]], p: float) -> list[tuple[Fit, FloatArray]]:
    """Fit curves together; return the fit and the leverages of each."""
    parts = [curve.pieces() for curve in curves]
    chain = Chain(np.concatenate([part[1] for part in parts]), np.concatenate([part[2] for part in parts]))
    centred = [curve.points - curve.points.mean(axis=0) for curve in curves]
    f = np.concatenate([x[order] for x, (order, *_) in zip(centred, parts, strict=True)])
    sigma = np.concatenate([curve.sigma[order] for curve, (order, *_) in zip(curves, parts, strict=True)])
    still = np.concatenate(
        [held[curve.alive][order] for curve, held, (order, *_) in zip(curves, pinned, parts, strict=True)]
    )
    search = _Search(chain, f, sigma, still | ~(sigma > 0))
    local = _Local(chain) if p == 2 else None
    lam = _one_each(search, parts, local)
    lam = lam if local is None else _narrowed(search, local, lam)
    u, h, _ = search.fit(lam)
    if p != 2:
        slope = np.sqrt(2 * chain.squared_steps(u) / chain.sizes)
        with np.errstate(divide="ignore"):
            lam = lam * search.spread(np.where(slope > 0, slope, np.nan) ** (p - 2))
        lam[np.isnan(lam)] = math.inf
    lam = np.where(search.still, math.inf, lam * search.held)
    found, begin = [], 0
    for curve, (order, *_) in zip(curves, parts, strict=True):
        mine = slice(begin, begin + len(order))
        begin += len(order)
        back = np.empty_like(order)
        back[order] = np.arange(len(order))
        # the fit of vertices that are pinned is exact only to rounding
        moved = np.where(search.still[mine, None], f[mine], u[mine])[back] + curve.points.mean(axis=0)
        found.append((Fit(lam[mine][back], moved), h[mine][back]))
    return found


def _one_each(search: _Search, parts: Sequence[Pieces], local: _Local | None) -> FloatArray:
    """Choose one fidelity for each piece; return it at each vertex, (n,). `local` learns the estimates."""
    chain = search.chain
    lowest = np.full(len(chain.sizes), math.inf)
    best = np.ones(len(chain.sizes))
    for number, lam in enumerate(_FIDELITIES):
        costs = search.fit(np.full(len(search.f), lam))[2]
        if local is not None:
            local.take(number, costs)
        cost = search.per_piece(costs)
        better = cost < lowest
        lowest, best = np.where(better, cost, lowest), np.where(better, lam, best)
    for factor in _FINER:
        middle = best
        for trial in (middle / factor, middle * factor):
            cost = search.per_piece(search.fit(search.spread(trial))[2])
            better = cost < lowest
            lowest, best = np.where(better, cost, lowest), np.where(better, trial, best)
    # short pieces of a long curve tell little: they take the fidelity of its others
    begin = 0
    for _, sizes, _ in parts:
        mine = slice(begin, begin + len(sizes))
        begin += len(sizes)
        told = sizes >= TELLING
        if told.any() and not told.all():
            best[mine][~told] = np.exp(np.average(np.log(best[mine][told]), weights=sizes[told]))
    return search.spread(best)


class _Local:
    """The best fidelity at each vertex of the long pieces, by the estimate averaged over windows along the piece."""

    def __init__(self, chain: Chain) -> None:
        long = chain.sizes >= _LEAST * min(_WINDOWS)
        pieces = zip(chain.starts[long].tolist(), chain.sizes[long].tolist(), chain.rings[long].tolist(), strict=True)
        self.windows = [
            (window, slice(begin, begin + n), ring, np.full(n, math.inf), np.zeros(n, np.int64))
            for begin, n, ring in pieces
            for window in _WINDOWS
            if n >= _LEAST * window
        ]

    def take(self, number: int, cost: FloatArray) -> None:
        """Compare the estimate (n,) for the candidate of this number with those so far."""
        for window, piece, ring, lowest, place in self.windows:
            mean = _averaged(cost[piece], window, ring)
            better = mean < lowest
            lowest[better] = mean[better]
            place[better] = number

    def lam(self, width: int, lam: FloatArray) -> FloatArray:
        """Return `lam` (n,) with the fidelities found with windows of this width."""
        lam = lam.copy()
        for window, piece, ring, _, place in self.windows:
            if window == width:
                lam[piece] = np.exp(_averaged(np.log(_FIDELITIES[place]), window / 2, ring))
        return lam


def _narrowed(search: _Search, local: _Local, lam: FloatArray) -> FloatArray:
    """Let the fidelity (n,) vary within the pieces where that lowers the estimated error."""
    cost = search.per_piece(search.fit(lam)[2]) - search.free
    for window in sorted({window for window, *_ in local.windows}, reverse=True):
        trial = local.lam(window, lam)
        # the expected error is the estimate less d per vertex
        new = search.per_piece(search.fit(trial)[2]) - search.free
        # and the least of several estimates is lower by chance, by about 1 per coordinate and window
        better = (new < _MARGIN * cost) & (cost - new > search.free / window)
        lam, cost = np.where(search.spread(better), trial, lam), np.where(better, new, cost)
    return lam


def _averaged(values: FloatArray, deviation: float, ring: bool) -> FloatArray:
    """Average along a piece, (n,), nearly as a Gaussian of this deviation does: three times over a box."""
    from scipy.ndimage import uniform_filter1d

    size = max(1, round(math.sqrt(4 * deviation**2 + 1)))
    for _ in range(3):
        values = uniform_filter1d(values, size, mode="wrap" if ring else "reflect")
    found: FloatArray = values
    return found
