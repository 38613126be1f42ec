"""How far a device may be from the exact value of a primitive: forward error analysis, one function a primitive.

Counting (Higham, Accuracy and Stability of Numerical Algorithms, chapters 3 and 4). u is the unit roundoff, 2^-24 or
2^-53. An operation is off by a factor 1 + delta with |delta| <= u; a product of k such factors is within
gamma(k) = k u/(1 - k u) of 1, and so is a quotient of a product of i by one of k - i. A sum of k terms puts at most k
such factors on each term, whatever the order of its additions, and fused multiply-adds only save factors; a term that
is 0 costs nothing, so the lanes and offsets that lead out of a grid do not count. ("At most k": k - 1 additions, and
one for the accumulator that a kernel may start from.)

What the OpenCL standard grants beyond that (1 ulp is at most 2 u of the value): division 2.5 ulp = 5 u, sqrt 3 ulp =
6 u, exp 3 ulp = 6 u, pow 16 ulp = 32 u. CUDA, Warp's CPU code and numpy are sharper. Subnormal results may be flushed
to 0.

All inputs are exact in the device's type (tests see to that), except where a bound says otherwise. The exact value is
represented by the float64 oracle, whose own rounding obeys the same bounds with u = 2^-53: it widens a float32 bound by
a factor 1 + 2^-29, and doubles a float64 bound.
"""

from __future__ import annotations

import math

import cases
import numpy as np
from bounds_box import in_box

from gpureg.arrays import FloatArray
from gpureg.backends import PatchForm
from gpureg.backends.numpy.duality import conjugate
from gpureg.backends.numpy.duality import length as length_of
from gpureg.graphs.csr import Graph

DIVISION, EXP, POW = 5, 6, 32  # in units of u


class Bounds:
    """Bounds for one graph with its weights, in one type."""

    def __init__(self, graph: cases.AnyGraph, weights: FloatArray | None, dtype: str) -> None:
        csr = graph if isinstance(graph, Graph) else graph.to_graph(weights)
        self.n = graph.n_vertices
        self.dtype = np.dtype(dtype)
        self.u = cases.UNIT_ROUNDOFF[dtype]
        self.rows, self.columns = csr.edge_rows(), csr.indices
        self.w = np.ones(len(self.rows)) if csr.weights is None else csr.weights.astype(np.float64)
        self.neighbours = np.bincount(self.rows, minlength=self.n)[:, None]
        self.slack = 1 + cases.UNIT_ROUNDOFF["float64"] / self.u

    def gamma(self, k: float | np.ndarray) -> np.ndarray:
        """Relative error of k roundings."""
        k = np.asarray(k, float)
        return k * self.u / (1 - k * self.u)

    def _sum(self, terms: FloatArray) -> FloatArray:
        """Sums over the edges of each vertex, (n, columns of terms)."""
        return np.stack([np.bincount(self.rows, t, minlength=self.n) for t in terms.T], axis=-1)

    def degree(self) -> FloatArray:
        """D weights added."""
        return self.slack * self.gamma(self.neighbours) * self._sum(self.w[:, None])

    def _raised(self, q: FloatArray, relative: FloatArray, power: float) -> FloatArray:
        """Relative error of q^power where q > 0 is known to `relative`.

        (1 + e)^s with |e| <= r is within (1 - r)^-|s| of 1. The exponent itself is rounded to the device's type, off by
        d: a factor q^d. Then pow's own error. (1/sqrt, which stands in for the power -1/2, has 11 u of its own.)
        """
        if power == 1:
            return relative
        rounded = float(self.dtype.type(power))
        power_off = abs(rounded - power) * (np.abs(np.log(q)) + 2 * relative)
        base_off = -abs(rounded) * np.log1p(-relative)
        return np.expm1(power_off + base_off + math.log1p(float(self.gamma(POW))))

    def _squared_gradient(self, channels: int, coupled: bool) -> FloatArray:
        """Relative error of |grad f|^2 + eps^2, a sum of nonnegative terms.

        The difference of f counts twice, times itself and times w: 4 roundings a term; D terms for each channel that
        shares the norm; eps times itself 1, which is less than a term's; the last addition 1.
        """
        return self.gamma(self.neighbours * (channels if coupled else 1) + 5)

    def gradient_norm(self, q: FloatArray, power: float, channels: int, coupled: bool) -> FloatArray:
        """`q` is the exact |grad f|^2 + eps^2."""
        relative = self._raised(q, self._squared_gradient(channels, coupled), power)
        return self.slack * relative * q**power

    def p_laplacian(self, f: FloatArray, g: FloatArray | None) -> FloatArray:
        """Terms w (g_u + g_v) (f_u - f_v) of 4 roundings, D of them, of both signs: relative to the sum of their sizes.

        Warp multiplies in another order, with as many roundings.
        """
        terms = self._conductance(g) * np.abs(f[self.rows] - f[self.columns])
        return self.slack * self.gamma(self.neighbours + 4) * self._sum(terms)

    def _conductance(self, g: FloatArray | None) -> FloatArray:
        pair = 2.0 if g is None else g[self.rows] + g[self.columns]
        return self.w[:, None] * pair

    def jacobi_step(
        self, f: FloatArray, f0: FloatArray, g: FloatArray | None, lam: float | FloatArray, theta: float
    ) -> FloatArray:
        """The quotient (lam f0 + sum a f_v)/(lam + sum a), then f + theta (quotient - f).

        A numerator's term a f_v has 3 roundings and D additions, one more for lam f0: D + 4. A denominator's has 2,
        D and 1: D + 3. With the division D + D + 7 + 5 on each term, relative to the quotient of the sum of the terms'
        sizes by the denominator. Where theta is not 1 that error shrinks by theta, and a subtraction, a multiplication
        and an addition put 3 roundings on theta |quotient - f| and 1 on |f|.
        Vertices that keep their data are exact.
        """
        lam = np.broadcast_to(np.asarray(lam, float), (self.n, 1))
        pinned = np.isinf(lam)
        lam = np.where(pinned, 0, lam)
        a = self._conductance(g)
        total = lam + self._sum(np.broadcast_to(a, (len(a), a.shape[1])))
        keeps = pinned | (total == 0)
        divisor = np.where(total == 0, 1, total)
        sizes = (lam * np.abs(f0) + self._sum(a * np.abs(f[self.columns]))) / divisor
        quotient = (lam * f0 + self._sum(a * f[self.columns])) / divisor
        bound = self.gamma(2 * self.neighbours + 7 + DIVISION) * sizes
        if theta != 1:
            moving = self.gamma(3) * (theta * np.abs(quotient - f) + np.abs(f))
            bound = (1 + self.gamma(3)) * theta * bound + moving
        return self.slack * np.where(keeps, 0, bound)

    def energy(
        self, q: FloatArray, f: FloatArray, f0: FloatArray, lam: float | FloatArray, p: float, coupled: bool
    ) -> float:
        """Nonnegative terms per vertex, then a long sum.

        q^(p/2)/p: the power's error, the division 5, p's own rounding 1, an addition per gradient norm. lam/2
        |f - f0|^2: 2 for the difference, 1 for its square, M additions, 2 for lam, an addition per gradient norm. The
        long sum adds n numbers in float64, or with compensation: 4 u covers that and the rounding of the parts.
        """
        channels, norms = f.shape[1], q.shape[1]
        lam = np.broadcast_to(np.asarray(lam, float), (self.n, 1))
        lam = np.where(np.isinf(lam), 0, lam)
        relative = self._raised(q, self._squared_gradient(channels, coupled), p / 2)
        smoothness = q ** (p / 2) / p
        fidelity = lam / 2 * ((f - f0) ** 2).sum(axis=1, keepdims=True)
        parts = (smoothness * ((1 + relative) * (1 + self.gamma(DIVISION + 1 + norms)) - 1)).sum()
        parts += (fidelity * self.gamma(channels + 5 + norms)).sum()
        total = smoothness.sum() + fidelity.sum()
        return self.slack * float(parts + total * (4 * self.u + self.n * cases.UNIT_ROUNDOFF["float64"]))

    def max_change(self, change: float) -> float:
        """One subtraction; the largest of rounded numbers is the largest one, rounded."""
        return self.slack * self.u * change

    def patch_distance(
        self,
        rho: FloatArray,
        form: PatchForm,
        spatial: FloatArray,
        channels: int,
        ndim: int,
        taken: FloatArray | float = 0.0,
        strength: FloatArray | float = 1.0,
    ) -> FloatArray:
        """`rho` is the exact distance, `spatial` its factor, both per weight, and so are a(u) + a(v) and q(u) q(v).

        Terms g_j d d of 4 roundings, g_j rounded once (once an axis where it is applied axis by axis), P M additions.
        Then max(rho - shift, 0) scale: shift and scale are rounded to the type, a subtraction and a multiplication; the
        exponential turns that absolute error into a relative one and adds its own; the spatial factor is rounded and
        multiplied: 2. Maps add a(u) + a(v) to shift, one rounding of what is taken off, and two multiplications. A
        similarity below the type's normal range may be flushed.
        """
        relative = self.gamma(len(form.profile) ** ndim * channels + 4 + ndim)
        if form.scale is None:
            return self.slack * relative * rho
        off = form.shift + taken
        scale, roundings = form.scale * strength, self.gamma(4 if form.maps is None else 7)
        exponent = np.maximum(rho - off, 0) * scale
        taken_off = self.u * (form.shift if form.maps is None else 3 * off)
        exponent_off = (relative * rho + taken_off) * scale * (1 + roundings) + roundings * exponent
        similarity = spatial * np.exp(-exponent)
        off = (1 + np.expm1(exponent_off)) * (1 + self.gamma(EXP + 2)) - 1
        return self.slack * (off * similarity + np.finfo(self.dtype).tiny * (spatial > 0))


class DualBounds:
    """Bounds of the certified solvers' primitives, for one graph with its gamma, in one type.

    `rows` and `columns` are the ends u and v of the edges, `own` and `other` gamma(u, v) and gamma(v, u), (n_edges, 1).
    A coupled norm adds the channels; `edge_norm` takes every edge for itself. Where gamma = sqrt(w), a difference is
    sqrt(w) (f(v) - f(u)): 8 roundings of the result (root 6). Where `directed`, it is one of two products: 2 of their
    sizes.
    """

    def __init__(
        self,
        n: int,
        rows: FloatArray,
        columns: FloatArray,
        own: FloatArray,
        other: FloatArray,
        *,
        directed: bool,
        coupled: bool,
        edge_norm: bool,
        dtype: str,
    ) -> None:
        self.n, self.rows, self.columns, self.own, self.other = n, rows, columns, own, other
        self.directed, self.coupled, self.edge_norm = directed, coupled, edge_norm
        self.u, self.dtype = cases.UNIT_ROUNDOFF[dtype], np.dtype(dtype)
        self.slack = 1 + cases.UNIT_ROUNDOFF["float64"] / self.u
        self.neighbours = np.bincount(rows, minlength=n)[:, None]
        self.share = 0.5 if edge_norm else 1.0

    def gamma(self, k: float | np.ndarray) -> np.ndarray:
        """Relative error of k roundings."""
        k = np.asarray(k, float)
        return k * self.u / (1 - k * self.u)

    def around(self, H: FloatArray) -> FloatArray:
        """Sums over the edges of each vertex, (n, m)."""
        return np.stack([np.bincount(self.rows, column, minlength=self.n) for column in H.T], axis=1)

    def norms(self, square: FloatArray) -> FloatArray:
        """The sums that belong to one norm, of a function on the edges."""
        if self.coupled:
            square = square.sum(axis=1, keepdims=True)
        return square if self.edge_norm else self.around(square)

    def terms(self, channels: int) -> FloatArray | float:
        """How many terms a norm has at most."""
        shared = channels if self.coupled else 1
        return float(shared) if self.edge_norm else self.neighbours * shared

    def difference(self, f: FloatArray) -> tuple[FloatArray, FloatArray]:
        """d_w(f) on the edges, and its error."""
        d = self.other * f[self.columns] - self.own * f[self.rows]
        sizes = self.other * np.abs(f[self.columns]) + self.own * np.abs(f[self.rows])
        return d, self.gamma(3) * sizes if self.directed else self.gamma(8) * np.abs(d)

    def adjoint(self, y: FloatArray, opposite: FloatArray) -> FloatArray:
        """The error: a root, a difference and a product (8), then the additions, at most one per neighbour."""
        sizes = self.around(self.own * (np.abs(y[opposite]) + np.abs(y)))
        return self.gamma(8 + self.neighbours) * sizes

    def dot(self, a: FloatArray, b: FloatArray, over: float | FloatArray) -> float:
        """A product and a division a term; the sum in float64, or with compensation: see :meth:`Bounds.energy`."""
        total = np.abs(a * b / over).sum()
        return self.slack * float(total * (self.gamma(1 + DIVISION) + 4 * self.u + self.n * 2.0**-53))

    def combine(self, a: float, x: FloatArray, b: float, y: FloatArray, over: float | FloatArray) -> FloatArray:
        """2 products, a division and an addition."""
        return self.slack * self.gamma(3 + DIVISION) * (np.abs(a * x) + np.abs(b * y / over))

    def gradient(self, f: FloatArray, f0: FloatArray, g: FloatArray | None, lam: FloatArray, p: float, eps: float):
        """Lam (f - f0) has 3 roundings with the last addition, the flow's terms 5 and one per neighbour.

        The conductances of the edge norm are found on the way: of q, a sum of M squares and eps^2, the power
        (p - 2)/2, which magnifies the error of q by |p - 2|/2.
        """
        d, off = self.difference(f)
        lam = np.where(np.isinf(lam), 0, lam)
        if self.edge_norm:
            q = self.norms(d**2) + eps**2
            q_off = self.gamma(self.terms(f.shape[1]) + 3) * q + self.norms(2 * np.abs(d) * off + off**2)
            conductance = q ** ((p - 2) / 2)
            low, high = np.maximum(q - q_off, eps**2) ** ((p - 2) / 2), (q + q_off) ** ((p - 2) / 2)
            conductance_off = np.maximum(np.abs(low - conductance), np.abs(high - conductance))
            conductance_off = conductance_off + self._power(q, (p - 2) / 2) * np.maximum(low, high)
        else:
            conductance = np.full((len(d), 1), 2.0) if g is None else g[self.rows] + g[self.columns]
            conductance_off = np.zeros_like(conductance)
        flow_off = self.own * (conductance * off + conductance_off * (np.abs(d) + off))
        flow_off = flow_off + self.gamma(8) * self.own * conductance * np.abs(d)
        total = self.around(self.own * conductance * np.abs(d)) + lam * np.abs(f - f0)
        return self.slack * (self.around(flow_off) + self.gamma(self.neighbours + 4) * total)

    def _power(self, q: FloatArray, power: float) -> FloatArray:
        """Relative error of pow itself and of its exponent, rounded to the type."""
        return self.gamma(POW) + self.u * abs(power) * np.abs(np.log(np.where(q > 0, q, 1)))

    def dual_step(
        self,
        y: FloatArray,
        previous: FloatArray,
        f: FloatArray,
        f_previous: FloatArray,
        beta: float,
        sigma: float | FloatArray,
        p: float,
        *,
        beta_y: float | None = None,
    ) -> FloatArray:
        """The prox moves two points nowhere farther apart: what z is off goes through, measured by the norm.

        z: 3 roundings on y and its predecessor, 4 on sigma d_w; f* is off by 3, and so is what its difference sees of
        it. r: a root (6) of a sum of squares. Then sigma t + share phi'(t) = r is solved for a value that is off by
        pow's error and a few roundings of r, say k r u; sigma + share phi'' >= sigma divides that, so s = r - sigma t
        is off by no more than k r u, and z s/r by k u |z|. k counts pow, its exponent (log q below 64 in all tests
        here, times |p - 2|/2), Newton's last step (4), the sums (8). p = 1 keeps 64 u below the unit ball.
        """
        beyond = f + beta * (f - f_previous)
        beyond_off = self.gamma(3) * ((1 + beta) * np.abs(f) + beta * np.abs(f_previous))
        d, off = self.difference(beyond)
        off = off + (1 + self.gamma(8)) * (self.other * beyond_off[self.columns] + self.own * beyond_off[self.rows])
        back = beta if beta_y is None else beta_y
        z = y + back * (y - previous) + sigma * d
        sizes = (1 + back) * np.abs(y) + back * np.abs(previous) + sigma * np.abs(d)
        z_off = self.gamma(4) * sizes + sigma * off
        moved = np.sqrt(self.norms(z_off**2))
        length = self.gamma(np.asarray(self.terms(y.shape[1])) + 7)
        k = 12 + DIVISION + (0 if p == 2 else POW + 64 * abs(p - 2) / 2) + (66 if p == 1 else 0)
        if not self.edge_norm:
            moved, length = moved[self.rows], length[self.rows]
        return self.slack * (moved + z_off + (2 * length + self.gamma(k)) * np.abs(z))

    def proximal(
        self,
        f: FloatArray,
        y: FloatArray,
        opposite: FloatArray,
        f0: FloatArray,
        lam: FloatArray,
        tau: float | FloatArray,
    ) -> FloatArray:
        """From f - tau d*y (3) a share w / (1 + w) of the way to f0, which two divisions and 3 roundings find (3 more).

        Clipping moves two points nowhere farther apart.
        """
        pinned = np.isinf(lam)
        sizes = np.abs(f) + tau * self.around(self.own * (np.abs(y[opposite]) + np.abs(y)))
        off = tau * self.adjoint(y, opposite) + self.gamma(3) * sizes
        off = off + self.gamma(2 * DIVISION + 6) * (sizes + np.abs(f0))
        return self.slack * np.where(pinned, 0, off)

    def primal(self, y: FloatArray, opposite: FloatArray, f0: FloatArray, lam: FloatArray) -> FloatArray:
        """The adjoint, a division and a subtraction."""
        sizes = self.around(self.own * (np.abs(y[opposite]) + np.abs(y)))
        bound = (self.adjoint(y, opposite) * (1 + self.gamma(6)) + self.gamma(DIVISION + 1) * sizes) / lam
        return self.slack * np.where(np.isinf(lam), 0, bound + self.u * np.abs(f0))

    def duality_gap(
        self,
        f: FloatArray,
        y: FloatArray,
        opposite: FloatArray,
        f0: FloatArray,
        lam: FloatArray,
        p: float,
        eps: float,
        *,
        box: tuple[FloatArray, FloatArray] | None = None,
    ) -> float:
        """Term by term, before they cancel.

        phi and phi* rise, so that what their arguments are off bounds what they are off; each then has pow's error,
        phi* twice of s t - share phi(t): what t is off counts to second order there. 4 roundings for their sum.
        """
        d, off = self.difference(f)
        count = np.asarray(self.terms(f.shape[1]))
        q = self.norms(d**2) + eps**2
        q_off = self.gamma(count + 3) * q + self.norms(2 * np.abs(d) * off + off**2)
        high, low = (q + q_off) ** (p / 2), np.maximum(q - q_off, 0) ** (p / 2)
        primal = self.share * high / p
        primal_off = primal - self.share * low / p + (self._power(q, p / 2) + self.gamma(DIVISION + 3)) * primal
        s = np.sqrt(self.norms(y**2))
        s_off = self.gamma(count + 7) * s
        above = conjugate(s + s_off, self.share, p, eps)
        below = conjugate(np.maximum(s - s_off, 0), self.share, p, eps)
        if p == 1:
            size = np.full_like(s, self.share * eps)  # the root of 1 - s^2, of a number that is off by a few u
            dual_off = above - below + size * np.sqrt(self.gamma(8)) * (s > 0.99 * self.share) + self.gamma(80) * size
        else:
            t = length_of(s, 0.0, self.share, p, eps)
            size = s * t + self.share * (t**2 + eps**2) ** (p / 2) / p
            exponents = self._power(s / self.share, p / (p - 1)) + self._power(t**2 + eps**2, p / 2)
            dual_off = above - below + (exponents + self.gamma(POW + 20)) * size
        pairs = self.norms(np.abs(d * y))
        pairs_off = self.norms(off * np.abs(y)) + self.gamma(count + 2) * pairs
        at_norms = primal_off + dual_off + pairs_off + self.gamma(4) * (primal + size + pairs)
        free = ~np.isinf(lam)
        nothing, lam = lam == 0, np.where(free & (lam > 0), lam, 1)
        pull = self.around(self.own * (y[opposite] - y))
        residual = lam * (f - f0) + pull
        residual_off = self.adjoint(y, opposite) + self.gamma(4) * (lam * np.abs(f - f0) + np.abs(pull))
        unmet = (2 * np.abs(residual) * residual_off + residual_off**2) / (2 * lam)
        size_of_unmet = residual**2 / (2 * lam)
        if box is not None:
            size_of_unmet, off_in_box = in_box(self.gamma, f, pull, self.adjoint(y, opposite), f0, lam, nothing, *box)
            unmet = np.where(nothing, 0, unmet) + off_in_box
        unmet = unmet + self.gamma(f.shape[1] + 4 + DIVISION) * size_of_unmet
        parts = float(at_norms.sum() + np.where(free, unmet, 0).sum())
        total = float((primal + size + pairs).sum() + np.where(free, size_of_unmet, 0).sum())
        return self.slack * (parts + total * (4 * self.u + self.n * 2.0**-53))
