"""How the certified solvers' primitives are called, and how far a device may be off."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import cases
import numpy as np
from primitives import Call
from problems import Problem, oracle, rounded

from gpureg.backends import Box

if TYPE_CHECKING:
    from checking import On

BETA, SIGMA, TAU = 0.375, 0.75, 0.3125


def over(one: Problem) -> Iterator[tuple[str, Any]]:
    """What is divided by: a number, a column, one value a channel, infinite."""
    each = rounded(np.where(one.f > 0.5, np.inf, 0.25 + one.f**2))
    yield from (("1", 1.0), ("0.75", 0.75), ("infinity", float("inf")), ("a column", one.positive), ("each", each))


def dot(one: Problem) -> Iterator[Call]:
    for what, by in over(one):
        args = {"a": one.f, "b": one.f0, "over": by}
        yield Call(f"over {what}", args, lambda exact, by=by: one.dual.dot(one.f, one.f0, by))


def combine(one: Problem) -> Iterator[Call]:
    for what, by in over(one):
        for place in (None, "x", "y"):
            yield Call(
                f"over {what}, into {place or 'another'}",
                {"a": -0.75, "x": one.f, "b": 1.5, "y": one.f0, "over": by},
                lambda exact, by=by: one.dual.combine(-0.75, one.f, 1.5, one.f0, by),
                place=place,
            )


def gradient(one: Problem) -> Iterator[Call]:
    for p in sorted({max(p, 1.5) for p, _ in one.kind.classes}):
        g = None if p == 2 and not one.edge_norm else any_conductances(one, p)
        for word, lam in (("0.75", 0.75), ("an array", one.positive)):
            for f0 in (one.f0, None):

                def bound(exact, p=p, g=g, lam=lam, f0=f0):
                    data = np.zeros_like(one.f) if f0 is None else f0
                    return one.dual.gradient(one.f, data, g, np.asarray(lam), p, cases.EPS)

                what = f"p = {p}, lam {word}{', without data' if f0 is None else ''}"
                yield Call(what, {"f": one.f, "f0": f0, "g": g, "lam": lam}, bound)


def any_conductances(one: Problem, p: float) -> Any:
    if one.edge_norm:
        return one.smoothness(p)
    return rounded(oracle().conductances(one.on_oracle, one.f, one.smoothness(p)))


def dual_step(one: Problem) -> Iterator[Call]:
    def inside(device: On, found: Any, there: Any) -> None:
        """What makes a certificate of it: inside the unit ball, by exact sums."""
        lengths = np.sqrt(one.dual.norms(one.edges(found).astype(np.float64) ** 2))
        assert lengths.max(initial=0) <= one.dual.share, "outside the unit ball"

    for p, eps in one.kind.classes:
        args = {
            "y": one.y, "previous": one.y_before, "f": one.f, "f_previous": one.f_before,
            "model": one.smoothness(p, eps), "beta": BETA, "sigma": SIGMA,
        }  # fmt: skip

        def bound(exact, p=p):
            return one.host(one.dual.dual_step(one.y, one.y_before, one.f, one.f_before, BETA, SIGMA, p))

        yield Call(f"p = {p}, eps = {eps}", args, bound, place="previous", also=inside if p == 1 else None)
    # steps of their own at the vertices, and a momentum of f alone
    for p, eps in one.kind.classes[:1]:
        sigma = rounded(0.25 + one.f[:, :1] ** 2)
        args = {
            "y": one.y, "previous": one.y_before, "f": one.f, "f_previous": one.f_before,
            "model": one.smoothness(p, eps), "beta": (BETA, 0.0), "sigma": sigma,
        }  # fmt: skip

        def of_vertices(exact, p=p, sigma=sigma):
            own = sigma[one.rows]
            if one.edge_norm:
                own = np.minimum(own, sigma[one.columns])
            y = one.y, one.y_before
            return one.host(one.dual.dual_step(*y, one.f, one.f_before, BETA, own, p, beta_y=0.0))

        what = f"p = {p}, eps = {eps}, sigma of each vertex"
        yield Call(what, args, of_vertices, place="previous", also=inside if p == 1 else None)


def around(one: Problem) -> Box:
    """A box that holds f, at its ends at some vertices; no box at others."""
    wide = rounded(0.25 * np.abs(one.f_before))
    low = np.where(one.f > 0.25, one.f, one.f - wide)
    return Box(rounded(low), rounded(np.where(one.f < 0.5, one.f + wide, one.f)))


def proximal(one: Problem) -> Iterator[Call]:
    tau = rounded(0.25 + one.f[:, :1] ** 2)
    for word, lam, step, box in (("0.75", 0.75, TAU, None), ("an array, in a box", one.lam, tau, around(one))):
        for place in (None, "f"):

            def bound(exact, lam=lam, step=step):
                column = np.broadcast_to(lam, (len(one.f), 1))
                return one.dual.proximal(one.f, one.y, one.opposite, one.f0, column, step)

            args = {"f": one.f, "y": one.y, "f0": one.f0, "lam": lam, "tau": step, "box": box}
            yield Call(f"lam {word}, into {place or 'another'}", args, bound, place=place)


def primal(one: Problem) -> Iterator[Call]:
    for word, lam in (("0.75", 0.75), ("infinite", float("inf")), ("an array", one.positive)):

        def bound(exact, lam=lam):
            column = np.broadcast_to(lam, (len(one.f), 1))
            return one.dual.primal(one.y, one.opposite, one.f0, column)

        yield Call(f"lam {word}", {"y": one.y, "f0": one.f0, "lam": lam}, bound)


def duality_gap(one: Problem) -> Iterator[Call]:
    for p, eps in one.kind.classes:
        y = one.inside(one.y) if p == 1 else one.y
        for word, lam in (("0.75", 0.75), ("an array", one.positive)):

            def bound(exact, p=p, eps=eps, y=y, lam=lam):
                column = np.broadcast_to(lam, (len(one.f), 1))
                return one.dual.duality_gap(one.f, y, one.opposite, one.f0, column, p, eps)

            args = {"f": one.f, "y": y, "f0": one.f0, "lam": lam, "model": one.smoothness(p, eps)}
            yield Call(f"p = {p}, eps = {eps}, lam {word}", args, bound)
    p, eps = one.kind.classes[0]
    y, box = one.inside(one.y) if p == 1 else one.y, around(one)

    def in_box(exact):
        return one.dual.duality_gap(one.f, y, one.opposite, one.f0, one.lam, p, eps, box=(box.low, box.high))

    args = {"f": one.f, "y": y, "f0": one.f0, "lam": one.lam, "model": one.smoothness(p, eps), "box": box}
    yield Call(f"p = {p}, eps = {eps}, in a box", args, in_box)
