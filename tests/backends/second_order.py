"""Newton's primitives by sums over lists of edges, and how far a device may be off."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from bounds import DIVISION, POW
from primitives import assert_within
from problems import Problem, rounded

from gpureg.backends import Smoothness
from gpureg.backends.curvature import Bend

FLOOR = 0.25


@dataclasses.dataclass(frozen=True, eq=False)
class Setting:
    """Where the second derivative of a problem's energy is taken, with a dual variable or without one.

    `h` is a problem's f0. With the edge norm y(v, u) = -y(u, v), as in Newton's method.
    """

    one: Problem
    p: float
    eps: float
    dual: bool

    @property
    def what(self) -> str:
        return f"p = {self.p}, {'with y' if self.dual else 'without y'}"

    @property
    def y(self) -> Any:
        one = self.one
        return (one.y - one.y[one.opposite]) / 2 if one.edge_norm else one.y

    @property
    def model(self) -> Smoothness:
        return Smoothness(self.p, self.eps, True, self.one.edge_norm)

    def differences(self) -> tuple[Any, ...]:
        """df and dh with what a device's may be off."""
        return (*self.one.dual.difference(self.one.f), *self.one.dual.difference(self.one.f0))

    def summed(self, x: Any) -> Any:
        """The sums of a norm over all channels, at each edge."""
        total = x.sum(axis=1, keepdims=True)
        return total if self.one.edge_norm else self.one.around(total)[self.one.rows]

    def numbers(self) -> tuple[Any, Any, Any]:
        """g, the factor of the products, and the longest y, at each edge; with the vertex norm exact in both types."""
        one, p = self.one, self.p
        share, q = one.dual.share, self.summed(one.dual.difference(one.f)[0] ** 2) + self.eps**2
        g = share * np.maximum(q ** ((p - 2) / 2), FLOOR if one.edge_norm else 0)
        factor = (2 - p) / q if self.dual else share * (2 - p) * q ** ((p - 4) / 2)
        found = g, factor, share * q ** ((p - 1) / 2)
        return found if one.edge_norm else tuple(map(rounded, found))

    def off(self) -> tuple[Any, Any, Any]:
        """Relative errors of the numbers, which a device computes with the edge norm: powers magnify that of q."""
        one, p = self.one, self.p
        if not one.edge_norm:
            return 0.0, 0.0, 0.0
        d, d_off = one.dual.difference(one.f)
        q = self.summed(d**2) + self.eps**2
        q_off = (one.dual.gamma(d.shape[1] + 3) * q + self.summed(2 * np.abs(d) * d_off + d_off**2)) / q
        pow_off = one.dual.gamma(POW + DIVISION + 4) + one.dual.u * np.abs(np.log(q)) * abs(p - 4)
        return tuple(pow_off + abs(power) * q_off for power in ((p - 2) / 2, (p - 4) / 2, (p - 1) / 2))

    def products(self) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
        """<df, dh> and <y, dh> times the factor at each edge, each with its error."""
        df, f_off, dh, h_off = self.differences()
        one, y = self.one, self.y
        factor, factor_off = self.numbers()[1], self.off()[1]
        terms = one.dual.gamma(6 + (1 if one.edge_norm else one.dual.neighbours[one.rows]) * df.shape[1])
        found = []
        for x, x_off in ((df, f_off), (y, np.zeros_like(y))):
            size = np.abs(factor) * self.summed((np.abs(x) + x_off) * (np.abs(dh) + h_off))
            moved = np.abs(factor) * self.summed(x_off * (np.abs(dh) + h_off) + np.abs(x) * h_off)
            found.append((factor * self.summed(x * dh), moved + (terms + factor_off) * size))
        return found[0], found[1]

    def hessian(self) -> tuple[Any, Any]:
        """The product with h, and its error; with the vertex norm the products are given exactly in both types."""
        one, (df, f_off, dh, h_off), y = self.one, self.differences(), self.y
        g, g_off = self.numbers()[0], self.off()[0]
        (s, s_off), (t, t_off) = self.products()
        if not one.edge_norm:
            s, s_off, t, t_off = rounded(s), 0.0, rounded(t), 0.0
        if self.dual:
            flux = g * dh - (s * y + t * df) / 2
            size = g * np.abs(dh) + (np.abs(s * y) + np.abs(t * df)) / 2
            moved = (
                g * h_off + g_off * g * np.abs(dh) + (s_off * np.abs(y) + t_off * np.abs(df) + np.abs(t) * f_off) / 2
            )
        else:
            flux = g * dh - s * df
            size = g * np.abs(dh) + np.abs(s * df)
            moved = g * h_off + g_off * g * np.abs(dh) + s_off * np.abs(df) + np.abs(s) * f_off
        pinned = np.isinf(one.lam)
        lam = np.where(pinned, 0, one.lam)
        back = one.opposite
        total = lam * one.f0 + one.around(one.own * (flux[back] - flux))
        sizes = lam * np.abs(one.f0) + one.around(one.own * (size[back] + size))
        error = one.around(one.own * (moved[back] + moved)) + one.dual.gamma(one.dual.neighbours + 20) * sizes
        return np.where(pinned, 0, total), np.where(pinned, 0, error)

    def dual_newton(self) -> tuple[Any, Any]:
        """The new y, and its error."""
        one, (df, f_off, dh, h_off), y = self.one, self.differences(), self.y
        g, g_off = self.numbers()[0], self.off()[0]
        s, s_off = self.products()[0]
        if not one.edge_norm:
            s, s_off = rounded(s), 0.0
        size = g * (np.abs(df) + np.abs(dh)) + np.abs(s * y)
        moved = g * (f_off + h_off) + g_off * g * (np.abs(df) + np.abs(dh)) + s_off * np.abs(y)
        return g * (df + dh) - s * y, moved + one.dual.gamma(20) * size

    def shorten(self) -> tuple[Any, Any]:
        """The shortened y, and its error: a root, a quotient, and the terms of the norm."""
        one, y = self.one, self.y
        length, most = np.sqrt(self.summed(y**2)), self.numbers()[2]
        terms = y.shape[1] * (1 if one.edge_norm else one.dual.neighbours[one.rows])
        found = y * np.minimum(1, most / np.maximum(length, 1e-300))
        return found, (one.dual.gamma(terms + 12 + DIVISION) + self.off()[2]) * np.abs(found)


def at_vertices(one: Problem, x: Any) -> Any:
    """Numbers of the norms of vertices, given at each edge, (n, 1); 1 at a vertex without edges."""
    found = np.ones((one.graph.n_vertices, x.shape[1]))
    found[one.rows] = x
    return found


def compare(backend: Any, setting: Setting) -> None:
    """Hold a device to the sums, twice with the same bits; outputs are full of NaN, and what is read is not written."""
    one, graph, dual = setting.one, setting.one.graph, setting.dual
    at = one.on(backend)
    f, h, lam = (backend.put(graph, x) for x in (one.f, one.f0, one.lam))

    def y() -> Any:
        return backend.put_edges(graph, one.host(setting.y))

    def nan(channels: int) -> Any:
        return backend.put(graph, np.full((graph.n_vertices, channels), np.nan))

    def held(name: str, of: Any, exact: tuple[Any, Any], edges: bool = False) -> None:
        first, again = of(), of()
        read = (lambda x: one.edges(backend.get_edges(graph, x))) if edges else (lambda x: backend.get(graph, x))
        assert_within(read(first), *exact, f"{name}, {setting.what}")
        assert read(first).tobytes() == read(again).tobytes(), f"{name}, {setting.what}: other bits on the second run"

    g = products = most = None
    if not one.edge_norm:
        given, factor, longest = (at_vertices(one, x) for x in setting.numbers())
        g, by, most = (backend.put(graph, x) for x in (given, factor, longest))
        pairs = [(at_vertices(one, x), at_vertices(one, off)) for x, off in setting.products()][: 2 if dual else 1]
        exact, off = (np.concatenate(columns, axis=1) for columns in zip(*pairs, strict=True))
        alone = np.bincount(one.rows, minlength=graph.n_vertices) == 0
        exact[alone] = off[alone] = 0
        with_y = y() if dual else None
        held(
            "gradient_product",
            lambda: backend.gradient_product(at, f, h, by, y=with_y, out=nan(len(pairs))),
            (exact, off),
        )
        products = backend.put(graph, rounded(exact))
    bend = Bend(f, setting.model, y() if dual else None, g, products, FLOOR)
    held("hessian", lambda: backend.hessian(at, h, bend, lam, out=nan(one.channels)), setting.hessian())
    if dual:
        held(
            "dual_newton",
            lambda: backend.dual_newton(at, h, dataclasses.replace(bend, y=y())),
            setting.dual_newton(),
            edges=True,
        )
        held("shorten", lambda: backend.shorten(at, y(), f, setting.model, most), setting.shorten(), edges=True)
