"""Derivatives with respect to what the energy depends on: data, fidelity, weights, p and eps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from .energy import Point


@dataclass(frozen=True, eq=False)
class Partials:
    """The derivatives of a number S with respect to everything that the energy depends on.

    S is <rho, gradient>, with the gradient at every vertex; and plus sum_u sigma(u) a(u) with the diagonal a of the
    matrix lam + d* c d.

    Attributes
    ----------
    point : Point
    rho : (n, m) float array
    sigma : (n,) float array
    by_df : (D, m) float array
        With respect to df, for a fixed d rho.
    bent : (D,) float array
        bend times the sum over each group, at its edges.
    f, f0 : (n, m) float array
    lam : (n,) float array
    p, eps : float
    """

    point: Point
    rho: FloatArray
    sigma: FloatArray
    by_df: FloatArray
    bent: FloatArray
    f: FloatArray
    f0: FloatArray
    lam: FloatArray
    p: float
    eps: float

    @classmethod
    def of(cls, point: Point, rho: FloatArray, sigma: FloatArray | None = None) -> Partials:
        """Compute them for fixed rho, (n, m), and sigma, (n,), which is 0 if None."""
        e, h = point.energy, (point.energy.p - 2) / 2
        drho, c = e.matrix @ rho, point.c[e.group]
        if sigma is None:
            sigma = np.zeros(len(rho))
        of_edges = (point.df * drho).sum(axis=1) + e.own**2 * sigma[e.start] + e.other**2 * sigma[e.end]
        total = e.grouped(of_edges)
        bent = (point.bend * total)[e.group]
        by_df = e.share * (c[:, None] * drho + bent[:, None] * point.df)
        log = np.log(np.where(point.q > 0, point.q, 1))
        return cls(
            point,
            rho,
            sigma,
            by_df,
            bent,
            f=e.lam * rho + e.adjoint @ by_df,
            f0=-e.lam * rho,
            lam=((point.f - e.f0) * rho).sum(axis=1) + sigma,
            p=e.share * float((point.power(h) * log * total).sum()) / 2,
            eps=e.share * e.eps * float((point.bend * total).sum()),
        )

    def weights(self) -> FloatArray:
        """Return the derivatives with respect to the weight of each undirected edge, (E,), for a named gamma."""
        point, e = self.point, self.point.energy
        scale = np.ones((len(point.f), 1)) if e.on.scale is None else e.on.scale.astype(np.float64)
        f, rho, held = scale * point.f, scale * self.rho, scale[:, 0] ** 2 * self.sigma
        steps, rises = f[e.end] - f[e.start], rho[e.end] - rho[e.start]
        c = point.c[e.group]
        each = c * ((steps * rises).sum(axis=1) + held[e.start] + held[e.end])
        each = e.share * (each + self.bent / 2 * (steps**2).sum(axis=1))
        count = len(e.edges.u)
        found: FloatArray = each[:count] + each[count:]
        if e.on.problem.gamma in ("normalized", "degree"):
            degree = self._by_degree()
            found = found + degree[e.edges.u] + degree[e.edges.v]
        return found

    def _by_degree(self) -> FloatArray:
        """Return the derivatives with respect to the degrees, (n,), in the factors of gamma alone."""
        point, e = self.point, self.point.energy
        assert e.on.scale is not None
        factor = 2.0 if e.on.problem.gamma == "normalized" else 1.0
        weight = (e.own / e.on.scale[e.start, 0]) ** 2
        degree = np.bincount(e.start, weight, minlength=len(point.f))
        assert np.allclose(e.on.scale[:, 0] ** -2, np.where(degree > 0, factor * degree, 1))
        parts = point.f * (e.adjoint @ self.by_df) + self.rho * (e.adjoint @ point.flux)
        total = parts.sum(axis=1) + 2 * self.sigma * diagonal(point)
        return np.where(degree > 0, -total / (2 * np.where(degree > 0, degree, 1)), 0)

    def gamma(self) -> FloatArray:
        """Return the derivatives with respect to gamma(u, v) of each directed edge, (D,)."""
        point, e, flux = self.point, self.point.energy, self.point.flux
        count = len(e.edges.u)
        opposite = np.concatenate([np.arange(count, 2 * count), np.arange(count)])
        f, rho = point.f[e.start], self.rho[e.start]
        found: FloatArray = (f * (self.by_df[opposite] - self.by_df) + rho * (flux[opposite] - flux)).sum(axis=1)
        c = e.share * point.c[e.group]
        found += 2 * e.own * (c + c[opposite]) * self.sigma[e.start]
        return found


def diagonal(point: Point) -> FloatArray:
    """Return the diagonal of d* c d, (n,)."""
    e, n = point.energy, len(point.f)
    c = e.share * point.c[e.group]
    ends, each = np.concatenate([e.start, e.end]), np.concatenate([c * e.own**2, c * e.other**2])
    found: FloatArray = np.bincount(ends, each, minlength=n).astype(np.float64)
    return found
