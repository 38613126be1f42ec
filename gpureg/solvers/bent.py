"""The linear system of a Newton step on the device, solved by conjugate gradients with a V-cycle."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .. import backends
from ..arrays import FloatArray
from ..backends import Array, Backend, Box, Numbers, Ratio, Recorded, Smoothness
from ..backends.curvature import Bend, least_square
from ..model.on_device import DeviceProblem
from .conductances import Conductances, raised
from .cycle import Cycle

# The smallest conductance for p > 2, as a share of the largest one: where df vanishes, so do the conductances, and the
# matrix may be singular where lam is 0.
FLOOR = 1e-10
# Maximal conjugate gradient steps per Newton step.
_INNER = 1000


def in_float64(problem: DeviceProblem) -> DeviceProblem:
    """Return the problem in float64 on the same device; the problem itself if the device has no float64."""
    narrow, graph = problem.backend, problem.weighted.graph
    if narrow.dtype == np.float64 or not narrow.device.float64:
        return problem
    wide, gamma = backends.get(narrow.device.id, "float64"), problem.host_gamma()

    def put(x: Array) -> Array:
        return wide.put(graph, narrow.get(graph, x))

    if problem.weighted.directed:
        assert gamma is not None
        weighted = wide.prepare_gamma(graph, gamma.astype(np.float64))
    else:
        weighted = wide.prepare(graph, None if gamma is None else gamma.astype(np.float64))
    lam = problem.lam if isinstance(problem.lam, float) else put(problem.lam)
    box = None if problem.box is None else Box(put(problem.box.low), put(problem.box.high))
    return replace(problem, backend=wide, weighted=weighted, f0=put(problem.f0), lam=lam, box=box)


@dataclass(frozen=True, eq=False)
class Memory:
    """Device functions of Newton's method, (n, m), and the numbers of conjugate gradients."""

    gradient: Array
    h: Array
    residual: Array
    direction: Array
    product: Array
    solved: Array
    numbers: Numbers

    @classmethod
    def empty(cls, problem: DeviceProblem) -> Memory:
        """Allocate the memory."""
        backend, graph, m = problem.backend, problem.weighted.graph, problem.channels
        gradient, h, residual, direction, product, solved = (backend.empty(graph, m) for _ in range(6))
        return cls(gradient, h, residual, direction, product, solved, backend.numbers(3))


@dataclass(frozen=True, eq=False)
class Bent:
    """The energy near f, to second order.

    Attributes
    ----------
    problem : DeviceProblem
    f : device function, (n, m)
    model : Smoothness
        With the eps of the step, and one norm.
    y : device function on the edges, m channels
    g : device function, (n, 1), or None
        share q^((p-2)/2), not too small; None with the edge norm and for p = 2.
    by : device function, (n, 1), or None
        The factor of the products with y; with the vertex norm.
    floor : float
        The least q^((p-2)/2).
    conductances : (E,) array
    """

    problem: DeviceProblem
    f: Array
    model: Smoothness
    y: Array
    g: Array | None
    by: Array | None
    floor: float
    conductances: FloatArray

    @classmethod
    def at(cls, matrix: Conductances, f: Array, y: Array, model: Smoothness) -> Bent:
        """Compute it at f, and shorten y for p < 2; for p >= 2 y becomes the slope."""
        problem, p, eps = matrix.problem, model.p, model.eps
        backend, weighted, graph = problem.backend, problem.weighted, problem.weighted.graph
        least = FLOOR if p > 2 else 0.0
        g = by = most = None
        if model.edge:
            c = matrix.of_edges(backend.get(graph, f).astype(np.float64), p, eps, least)
            floor = float(c.min(initial=np.inf)) if least and len(c) else 0.0
        else:
            q = backend.get(graph, backend.gradient_norm(weighted, f, power=1, eps=eps, coupled=True))
            q = np.maximum(q.astype(np.float64), least_square(backend.dtype))
            host, floor = raised(q, (p - 2) / 2, least), 0.0
            c = matrix.of_vertices(host[:, 0])
            g, by, most = (backend.put(graph, x) for x in (host, (2 - p) / q, q ** ((p - 1) / 2)))
        if p < 2:
            backend.shorten(weighted, y, f, model, most)
        found = cls(problem, f, model, y, g, by, floor, c)
        if p >= 2:
            found._slopes()
        return found

    def _slopes(self) -> None:
        """Overwrite y by g df."""
        backend, graph = self.problem.backend, self.problem.weighted.graph
        nothing = backend.put(graph, np.zeros((graph.n_vertices, self.problem.channels)))
        products = None if self.model.edge else backend.put(graph, np.zeros((graph.n_vertices, 2)))
        backend.dual_newton(self.problem.weighted, nothing, self._bend(products, dual=True))

    def _bend(self, products: Array | None, *, dual: bool) -> Bend:
        return Bend(self.f, self.model, self.y if dual else None, self.g, products, self.floor)

    def move(self, h: Array) -> None:
        """Do Newton's step h of y."""
        backend, weighted, products = self.problem.backend, self.problem.weighted, None
        if not self.model.edge:
            assert self.by is not None
            products = backend.gradient_product(weighted, self.f, h, self.by, y=self.y)
        backend.dual_newton(weighted, h, self._bend(products, dual=True))

    def solve(self, cycle: Cycle, memory: Memory, rtol: float) -> int:
        """Solve for the step, into ``memory.h``; return the steps of conjugate gradients.

        They end when the residual's product with its V-cycle has fallen by `rtol` squared.
        """
        problem, numbers = self.problem, memory.numbers
        backend, weighted, graph = problem.backend, problem.weighted, problem.weighted.graph
        h, residual, direction, product, z = (
            memory.h,
            memory.residual,
            memory.direction,
            memory.product,
            memory.solved,
        )
        dual, products, by = self.model.p < 2, None, self.by
        if not self.model.edge:
            products, by = backend.empty(graph, 2 if dual else 1), self._factor()
        bend = self._bend(products, dual=dual)

        def precondition(backend: Backend, at: int) -> None:
            cycle.solve(backend, residual, z)
            backend.dot_into(numbers[at], graph, residual, z)

        def step(backend: Backend, old: int, new: int) -> None:
            if products is not None:
                assert by is not None
                backend.gradient_product(weighted, self.f, direction, by, y=bend.y, out=products)
            backend.hessian(weighted, direction, bend, problem.lam, out=product)
            backend.dot_into(numbers[2], graph, direction, product)
            backend.combine(graph, 1.0, h, Ratio(numbers, old, 2), direction, out=h)
            backend.combine(graph, 1.0, residual, Ratio(numbers, old, 2, -1.0), product, out=residual)
            precondition(backend, new)
            backend.combine(graph, Ratio(numbers, new, old), direction, 1.0, z, out=direction)

        backend.combine(graph, -1.0, memory.gradient, 0.0, memory.gradient, out=residual)
        backend.combine(graph, 0.0, residual, 0.0, residual, out=h)
        precondition(backend, 0)
        backend.copy(graph, z, out=direction)
        first = float(backend.read(numbers)[0])
        turns = (
            Recorded(backend, lambda backend: step(backend, 0, 1)),
            Recorded(backend, lambda backend: step(backend, 1, 0)),
        )
        for done in range(_INNER):
            turns[done % 2]()
            read = backend.read(numbers)
            if not read[2] > 0 or not read[(done + 1) % 2] > rtol**2 * first:
                return done + 1
        return _INNER

    def _factor(self) -> Array:
        """Return the factor of the products for the matrix: without y for p >= 2."""
        assert self.by is not None and self.g is not None
        if self.model.p < 2:
            return self.by
        backend, graph = self.problem.backend, self.problem.weighted.graph
        return backend.put(graph, backend.get(graph, self.by) * backend.get(graph, self.g))
