"""How the primitives of the paper's energy are called, and how far a device may be off: see primitives.py."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cases
import numpy as np
from primitives import Call
from problems import Problem


def ps(one: Problem) -> tuple[float, ...]:
    """p = 2 is a variant of its own, without conductances; what is not plain has few."""
    if not one.plain:
        return (0.7, 3.0)
    return cases.P_ALL if one.setup.full else tuple(p for p in cases.P_ALL if p != 2)


def loose(one: Problem, scale: Any) -> Any:
    """The counting of cases.TOLERANCES, relative to the sum of the sizes of the terms.

    With gamma as an array, or from the differences of single edges, terms cancel before they are raised to a power.
    """
    return cases.TOLERANCES[one.dtype] * (scale + 1e-30)


def degree(one: Problem) -> Iterator[Call]:
    bound = one.bounds.degree() if one.plain else loose(one, one.around(one.own**2))
    yield Call("", {}, lambda exact: bound)


def largest(one: Problem) -> Iterator[Call]:
    # one of the weights, which both types hold exactly; a square is rounded once
    yield Call("", {}, lambda exact: one.bounds.u * exact if one.directed else 0.0)


def difference(one: Problem) -> Iterator[Call]:
    # 2 products and a difference, or a root (6 u), a difference and a product: 8 u of the terms' sizes, twice
    bound = 16 * cases.UNIT_ROUNDOFF[one.dtype] * one.host(one.sizes)
    yield Call("", {"f": one.f}, lambda exact: bound)


def adjoint(one: Problem) -> Iterator[Call]:
    # a root, a difference and a product (8 u), then the additions, at most one per neighbour
    count = np.bincount(one.rows, minlength=one.graph.n_vertices)[:, None]
    sizes = one.around(one.own * (np.abs(one.H[one.opposite]) + np.abs(one.H)))
    yield Call("", {"H": one.H}, lambda exact: 2 * (8 + count) * cases.UNIT_ROUNDOFF[one.dtype] * sizes)


def gradient_norm(one: Problem) -> Iterator[Call]:
    G = 1 if one.coupled else one.channels
    settings = {"f": one.f, "coupled": one.coupled}
    if one.plain:
        powers = (1.0, 0.5, *(p / 2 for p in cases.P_ALL), *((p - 2) / 2 for p in cases.P_ALL))
        for power in dict.fromkeys(powers):
            yield Call(
                f"power {power}",
                {**settings, "power": power, "eps": cases.EPS},
                lambda exact, power=power: one.bounds.gradient_norm(one.q, power, one.channels, one.coupled),
                channels=G,
            )
    for p in () if one.plain else ps(one):
        for eps in (cases.EPS, 0.0):  # the root and the powers of 0 too
            yield Call(
                f"L^p norm, p = {p}, eps = {eps}",
                {**settings, "power": 1 / p, "eps": eps, "edge_power": p / 2},
                lambda exact: loose(one, exact.max(initial=0)),
                channels=G,
            )


def p_laplacian(one: Problem) -> Iterator[Call]:
    for p in ps(one):
        g = one.conductances(p)
        yield Call(
            f"p = {p}",
            {"f": one.f, "g": g},
            lambda exact, g=g, p=p: one.bounds.p_laplacian(one.f, g) if one.plain else loose(one, one.push(p)),
        )


def jacobi_step(one: Problem) -> Iterator[Call]:
    for p in ps(one):
        g = one.conductances(p)
        for lam in (one.lam, 0.75, 0.0, float("inf")) if one.setup.full and one.plain else (one.lam,):
            for theta in (1.0, 0.625) if one.plain else (0.625,):

                def bound(exact, g=g, lam=lam, theta=theta):
                    if one.plain:
                        return one.bounds.jacobi_step(one.f, one.f0, g, lam, theta)
                    # with gamma that is not symmetric a step is no mean: sums of pulls over sums of holds
                    return loose(one, 1 + np.abs(exact))

                what = f"p = {p}, theta = {theta}, lam {lam if isinstance(lam, float) else 'an array'}"
                yield Call(what, {"f": one.f, "f0": one.f0, "g": g, "lam": lam, "theta": theta}, bound)


def euler_step(one: Problem) -> Iterator[Call]:
    finite = np.where(np.isinf(one.lam), 0, one.lam)
    for p in (0.7, 3.0):
        yield Call(
            f"p = {p}",
            {"f": one.f, "f0": one.f0, "g": one.conductances(p), "lam": one.lam, "tau": one.tau},
            lambda exact, p=p: loose(one, 1 + one.tau * (one.push(p) + finite)),
        )
    for lam in () if one.edge_norm else (0.5, float("inf")):
        yield Call(
            f"p = 2, lam {lam}",
            {"f": one.f, "f0": one.f0, "g": None, "lam": lam, "tau": 0.0625},
            lambda exact: loose(one, 1 + one.largest_flow),
        )


def energy(one: Problem) -> Iterator[Call]:
    for p in cases.P_ALL if one.plain else ps(one):
        for lam in (one.lam, 0.75, float("inf")) if one.setup.full and one.plain else (one.lam,):
            model = one.smoothness(p)

            def bound(exact, p=p, lam=lam):
                if one.plain:
                    return one.bounds.energy(one.q, one.f, one.f0, lam, p, one.coupled)
                return loose(one, abs(exact))

            what = f"p = {p}, lam {lam if isinstance(lam, float) else 'an array'}"
            yield Call(what, {"f": one.f, "f0": one.f0, "lam": lam, "model": model}, bound)


def max_change(one: Problem) -> Iterator[Call]:
    """The largest change may sit anywhere, the last vertex and the last channel included."""
    yield Call("", {"a": one.f, "b": one.f0}, one.bounds.max_change)
    yield Call("no change", {"a": one.f, "b": one.f}, lambda exact: 0.0)
    n = one.graph.n_vertices
    places = {*range(0, n, max(n // 7, 1)), n // 2, n - 2, n - 1} if n > 4096 * 2 else {0, n // 2, n - 1}
    for u in sorted(places):
        for c in {0, one.channels - 1}:
            for value in (one.f[u, c] - 8, np.nan, np.inf):
                moved = one.f.copy()
                moved[u, c] = value
                what = f"{value} at {u}, {c}"
                if np.isfinite(value):
                    yield Call(what, {"a": one.f, "b": moved}, one.bounds.max_change)
                    continue
                yield Call(what, {"a": one.f, "b": moved}, lambda exact: 0.0)
                yield Call(f"{what}, the other way round", {"a": moved, "b": one.f}, lambda exact: 0.0)


def sweep(one: Problem) -> Iterator[Call]:
    """A backend may fuse the two primitives, and then round otherwise; from NaN in scratch memory and output."""
    for p in ps(one):
        model = one.smoothness(p)
        yield Call(
            f"p = {p}",
            {
                "f": one.f, "f0": one.f0, "lam": one.lam, "model": model, "theta": 0.625,
                "g": model.norms(one.channels) if model.has_function else None,
            },
            lambda exact: cases.TOLERANCES[one.dtype] * np.abs(exact).max(),
        )  # fmt: skip
