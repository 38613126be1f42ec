"""The certified solvers' primitives in numpy (float64) against literal loops, and against what they must mean."""

from __future__ import annotations

import functools
import itertools
import math

import cases
import duality
import numpy as np
import paper
import pytest
from literal import CHANNELS, Form, assert_close, both_forms
from numpy.testing import assert_array_equal

from gpureg.backends import Smoothness
from gpureg.graphs.csr import Graph

P = (1.0, 1.2, 1.5, 2.0, 3.0, 6.0)
BETA, SIGMA = 0.375, 0.7

some_graphs = pytest.mark.parametrize("name", ["small row", "small masked", "small csr", "pixel", "csr, one vertex"])
channel_kinds = pytest.mark.parametrize(("channels", "coupled"), CHANNELS)
both_norms = pytest.mark.parametrize("edge_norm", [False, True], ids=["vertex", "edge"])


class Setting:
    """A graph with its gamma, functions on its vertices and edges, as arrays and as dictionaries."""

    def __init__(self, backend, name, channels, coupled, directed):
        form = Form(backend, name, directed)
        case = form.case
        self.form, self.graph, self.weighted = form, case.graph, form.weighted
        self.V, self.E, self.gamma = case.V, form.E, form.gamma
        self.coupled, self.channels = coupled, channels
        n = self.graph.n_vertices
        self.f, self.f0, self.f_before = (cases.function(self.graph, channels, seed) for seed in (11, 13, 17))
        self.y, self.before = (self._on_edges(seed) for seed in (19, 23))
        lam = 0.5 + cases.rng(29).random((n, 1))
        some = lam.copy()
        some[1::4] = np.inf
        each = 0.5 + cases.rng(31).random(self.f.shape)
        each[::3] = np.inf
        self.lams = {"number": 0.75, "column": lam, "some infinite": some, "infinite": math.inf, "each": each}

    def _on_edges(self, seed):
        H = 2 * cases.rng(seed).random((len(self.form.edges), self.channels)) - 1
        # where gamma is 0 both ways there is no edge: solvers leave a 0 there
        there = [self.gamma[u, v] > 0 or self.gamma[v, u] > 0 for u, v in self.form.edges]
        return H * np.array(there, float).reshape(-1, 1)

    def functions(self, f):
        return self.form.case.functions(f)

    def column(self, number):
        return self.functions(np.broadcast_to(number, (self.graph.n_vertices, 1)).astype(float))[0]

    def host(self, H):
        return self.form.to_host(H)

    def edge_functions(self, H):
        return [dict(zip(self.form.edges, column, strict=True)) for column in H.T.tolist()]

    def edge_array(self, Hs):
        rows = [[H[e] for H in Hs] for e in self.form.edges]
        return np.array(rows, float).reshape(len(rows), self.channels)

    def inside(self, H, edge_norm, radius):
        """H, scaled where that is needed to lengths of at most `radius`."""
        Hs = self.edge_functions(H)
        lengths = duality.lengths(self.V, self.E, Hs, self.coupled, edge_norm)
        scaled = [
            {(u, v): one[u, v] * min(1, radius / max(length[(u, v) if edge_norm else u], 1e-9)) for u, v in one}
            for one, length in zip(Hs, lengths, strict=True)
        ]
        return self.edge_array(scaled)

    def model(self, p, eps, edge_norm):
        return Smoothness(p, eps, self.coupled, edge_norm)


# Nothing is written into it: the tests of one setting share it.
shared = functools.cache(Setting)


@pytest.fixture
def setting(oracle, name, channels, coupled, directed):
    return shared(oracle, name, channels, coupled, directed)


# Vectors


@some_graphs
@channel_kinds
@pytest.mark.parametrize("directed", [False])
@pytest.mark.parametrize("over", ["number", "column", "some infinite", "infinite", "each"])
def test_dot(oracle, setting, over):
    """`over` a number, a column, one value a channel; infinite ones."""
    s, by = setting, setting.lams[over]
    overs = s.functions(np.broadcast_to(by, s.f.shape).astype(float))
    found = oracle.dot(s.weighted.graph, s.f, s.f0, over=by)
    assert isinstance(found, float)
    expected = duality.dot(s.V, s.functions(s.f), s.functions(s.f0), overs)
    assert_close(found, expected, scale=np.abs(s.f * s.f0).sum())
    if over == "infinite":
        assert found == 0


@some_graphs
@channel_kinds
@pytest.mark.parametrize("directed", [False])
@pytest.mark.parametrize("over", ["number", "column", "some infinite", "infinite", "each"])
@pytest.mark.parametrize("place", [None, 0, 1], ids=["into another", "into x", "into y"])
def test_combine(oracle, setting, over, place):
    """The same, written to either input."""
    s, by = setting, setting.lams[over]
    overs = s.functions(np.broadcast_to(by, s.f.shape).astype(float))
    expected = s.form.case.array(duality.combine(s.V, -0.75, s.functions(s.f), 1.5, s.functions(s.f0), overs))
    pair = [s.f.copy(), s.f0.copy()]
    out = None if place is None else pair[place]
    back = oracle.combine(s.weighted.graph, -0.75, pair[0], 1.5, pair[1], over=by, out=out)
    assert out is None or back is out
    assert_close(back, expected)


# The gradient


@both_norms
@both_forms
@some_graphs
@channel_kinds
# eps = 0 where p < 2 has no derivative: the functions are flat somewhere
@pytest.mark.parametrize(("p", "eps"), [*itertools.product(P, [cases.EPS]), (2.0, 0.0), (3.0, 0.0)])
def test_gradient(oracle, setting, edge_norm, p, eps):
    """With lam a number, with some pinned, and without data."""
    s = setting
    fs, f0s = s.functions(s.f), s.functions(s.f0)
    g = oracle.conductances(s.weighted, s.f, s.model(p, eps, edge_norm))
    norms = (
        paper.edge_norms(s.E, s.gamma, fs, eps, s.coupled)
        if edge_norm
        else paper.norms(s.V, s.E, s.gamma, fs, eps, s.coupled)
    )

    def expected(data, lam):
        found = duality.gradient(s.V, s.E, s.gamma, fs, data, s.column(lam), p, norms, edge_norm)
        return s.form.case.array(found)

    some, out = s.lams["some infinite"], np.full_like(s.f, np.nan)
    assert oracle.gradient(s.weighted, s.f, s.f0, g, some, out=out) is out
    given = oracle.gradient(s.weighted, s.f, s.f0, g, 0.75), oracle.gradient(s.weighted, s.f, None, g, 0.75)
    assert_close(out, expected(f0s, some))
    assert_close(np.stack(given), np.stack([expected(f0s, 0.75), expected(None, 0.75)]))


@both_norms
@both_forms
@channel_kinds
@pytest.mark.parametrize("name", ["small row", "small csr"])
@pytest.mark.parametrize("p", P)
def test_gradient_is_that_of_the_energy(oracle, setting, edge_norm, p):
    """By central differences.

    With eps = 1/4 and steps of h = 1e-3 the five-point formula is off by h^4/30 times a fifth derivative of the order
    of eps^-4 times the gradient, 1e-11 of it, and by the energy's rounding over h, about 1e-12: 1e-8 leaves room.
    """
    s, h = setting, 1e-3
    lam = s.lams["some infinite"]
    free = np.broadcast_to(np.isfinite(lam), s.f.shape)
    f = np.where(free, s.f, s.f0)
    model = s.model(p, 0.25, edge_norm)

    def energy_at(index, step):
        moved = f.copy()
        moved[index] += step
        return oracle.energy(s.weighted, moved, s.f0, lam, model)

    numeric = np.zeros_like(f)
    for index in np.argwhere(free):
        at = tuple(index)
        near, far = energy_at(at, h) - energy_at(at, -h), energy_at(at, 2 * h) - energy_at(at, -2 * h)
        numeric[at] = (8 * near - far) / (12 * h)
    g = oracle.conductances(s.weighted, f, model)
    found = oracle.gradient(s.weighted, f, s.f0, g, lam)
    assert np.abs(found - numeric).max() <= 1e-8 * np.abs(found).max()
    assert not found[~free].any()


# The dual step


@both_norms
@both_forms
@some_graphs
@channel_kinds
@pytest.mark.parametrize("p", P)
def test_dual_step(oracle, setting, edge_norm, p):
    """Against the equation of the prox solved by halving; lengths from 0 over the unit ball's to several times that.

    For p = 1 the house's limit of share (1 - 32 u) is within the tolerance.
    """
    s, off, longest = setting, [], []
    for scale, eps in itertools.product((0.25, 4.0), (0.0, 0.125)):
        step = {"model": s.model(p, eps, edge_norm), "beta": BETA, "sigma": SIGMA}
        back, expected, largest = stepped(oracle, s, step, scale)
        # 0 where no edge is: the sum over the edges is that over all
        off += [(s.form.from_host(back) - expected) / largest]
        off += [(back.sum() - s.form.from_host(back).sum()) / max(np.abs(back).sum(), 1) * np.ones((1, s.channels))]
        found = s.edge_functions(s.form.from_host(back))
        longest += [r for length in duality.lengths(s.V, s.E, found, s.coupled, edge_norm) for r in length.values()]
    assert_close(np.concatenate(off), np.zeros((sum(map(len, off)), s.channels)), scale=1)
    if p == 1:
        assert max(longest, default=0) <= (0.5 if edge_norm else 1)


def stepped(oracle, s, step, scale):
    """A dual step from y and its predecessor times `scale`, what it should be, and the size of what it starts from."""
    y, before, model = scale * s.y, scale * s.before, step["model"]
    vectors = (s.edge_functions(y), s.edge_functions(before), s.functions(s.f), s.functions(s.f_before))
    z = duality.extrapolated(s.E, s.gamma, *vectors, BETA, SIGMA)
    expected = s.edge_array(duality.prox(s.V, s.E, z, SIGMA, model.p, model.eps, s.coupled, model.edge))
    place = s.host(before).copy()
    back = oracle.dual_step(s.weighted, s.host(y), place, s.f, s.f_before, **step)
    assert back is place
    return back, expected, max(1, np.abs(s.edge_array(z)).max(initial=0))


@both_norms
@channel_kinds
@pytest.mark.parametrize("directed", [False])
@pytest.mark.parametrize("name", ["small csr"])
@pytest.mark.parametrize("p", P)
@pytest.mark.parametrize("eps", [0.0, 0.25])
def test_dual_step_minimises(oracle, setting, edge_norm, p, eps):
    """The minimiser x of an objective J that is 1-strongly convex has J(x') - J(x) >= |x' - x|^2/2 for every x'."""
    s, share = setting, 0.5 if edge_norm else 1.0

    def objective(x, z):
        phi = duality.conjugates(s.V, s.E, s.edge_functions(x), p, eps, s.coupled, edge_norm)
        return ((x - z) ** 2).sum() / 2 + SIGMA * phi

    step = {"model": s.model(p, eps, edge_norm), "beta": 0.0, "sigma": SIGMA}
    x = oracle.dual_step(s.weighted, s.y, s.before.copy(), s.f, s.f, **step)
    z = s.y + SIGMA * oracle.difference(s.weighted, s.f)
    least, more = objective(x, z), []
    for seed, size in ((3, 1e-3), (5, 0.1), (7, 1.0)):
        other = x + size * (cases.rng(seed).random(x.shape) - 0.5)
        if p == 1:
            other = s.inside(other, edge_norm, share)
            other *= 1 - 1e-15  # inside in spite of the roundings
        more.append(objective(other, z) - least - ((other - x) ** 2).sum() / 2)
    assert min(more) >= -1e-12 * abs(least)


# The primal function, the gap


@both_forms
@some_graphs
@channel_kinds
@pytest.mark.parametrize("lam", ["number", "column", "some infinite", "infinite"])
def test_primal(oracle, setting, lam):
    """Against loops, and against what it is: the minimiser of <d_w f, y> + lam/2 |f - f0|^2 over f."""
    s, lam = setting, setting.lams[lam]
    out = np.full_like(s.f, np.nan)
    assert oracle.primal(s.weighted, s.host(s.y), s.f0, lam, out=out) is out
    expected = duality.primal(s.V, s.E, s.gamma, s.edge_functions(s.y), s.functions(s.f0), s.column(lam))
    assert_close(out, s.form.case.array(expected))
    column = np.broadcast_to(lam, (s.graph.n_vertices, 1))
    pinned = np.isinf(column)
    assert_array_equal(out[pinned[:, 0]], s.f0[pinned[:, 0]])
    weight = np.where(pinned, 0, column)

    def lagrangian(f):
        pairing = (oracle.difference(s.weighted, f) * s.host(s.y)).sum()
        return pairing + (weight / 2 * (f - s.f0) ** 2).sum()

    other = np.where(pinned, s.f0, s.f)
    rise = lagrangian(other) - lagrangian(out)
    # a quadratic rises from its minimum by exactly this
    assert_close(rise, (weight / 2 * (other - out) ** 2).sum(), scale=1 + np.abs(s.y).sum() + (weight * s.f**2).sum())


@both_norms
@both_forms
@some_graphs
@channel_kinds
@pytest.mark.parametrize("p", P)
def test_duality_gap(oracle, setting, edge_norm, p):
    """Never below 0, and the energy minus the dual energy, each taken by itself; relative to their size."""
    s, share = setting, 0.5 if edge_norm else 1.0
    y = s.inside(s.y, edge_norm, 0.95 * share) if p == 1 else s.y
    models = [s.model(p, eps, edge_norm) for eps in (0.0, 0.125)]
    given = [gaps(oracle, s, y, s.lams[lam], model) for lam in ("number", "some infinite") for model in models]
    found, expected = np.array(given).T
    assert_close(found, expected, scale=1)
    assert found.min() >= -1e-15  # a term of Fenchel's inequality is 0 at best, up to its roundings


def gaps(oracle, s, y, lam, model):
    """The gap and what it should be, over the size of its parts."""
    p, eps, edge_norm = model.p, model.eps, model.edge
    f = np.where(np.isinf(np.broadcast_to(lam, (len(s.f), 1))), s.f0, s.f)
    ys, fs, f0s, lams = s.edge_functions(y), s.functions(f), s.functions(s.f0), s.column(lam)
    energy = paper.energy(s.V, s.E, s.gamma, fs, f0s, lams, p, eps, s.coupled, edge_norm)
    below = duality.dual_energy(s.V, s.E, s.gamma, ys, f0s, lams, p, eps, s.coupled, edge_norm)
    gap = oracle.duality_gap(s.weighted, f, s.host(y), s.f0, lam, model)
    assert isinstance(gap, float)
    # 1: halving leaves 2^-64 of an interval no shorter than that
    scale = 1 + energy + abs(below) + np.abs(y).sum()
    return gap / scale, (energy - below) / scale


# Optima in closed form: the gap is 0 there, and a step leaves them where they are


def regular_polygon(n, p, lam, radius):
    """The n-gon, vectors of constant gradient: lam (rho - rho0) + (sqrt(2 mu) rho)^p / rho = 0."""
    mu = 4 * math.sin(math.pi / n) ** 2
    rho = duality.root(lambda rho: lam * (rho - radius) + (math.sqrt(2 * mu) * rho) ** p / rho, radius)
    angle = 2 * math.pi * np.arange(n) / n
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Graph.from_edges([[k, (k + 1) % n] for k in range(n)]), radius * circle, rho * circle


def star(n, p, lam, d0, w):
    """A centre at d0, n leaves at 0: (n^(p/2) + n) w^(p/2) d^(p-1) = lam n/(n + 1) (d0 - d), the mean stays."""
    factor = (n ** (p / 2) + n) * w ** (p / 2)
    d = duality.root(lambda d: factor * d ** (p - 1) - lam * n / (n + 1) * (d0 - d), d0)
    f0 = np.zeros((n + 1, 1))
    f0[0] = d0
    f = np.full((n + 1, 1), (d0 - d) / (n + 1))
    f[0] += d
    return Graph.from_edges([[0, k] for k in range(1, n + 1)], np.full(n, w)), f0, f


OPTIMA = {
    "12-gon": lambda p: (*regular_polygon(12, p, 1.7, 3.0), 1.7, False),
    "star": lambda p: (*star(4, p, 8.0, 3.0, 0.5), 8.0, False),
    # the edge norm at lam is the vertex norm at twice that
    "one edge, edge norm": lambda p: (*star(1, p, 8.0, 3.0, 0.5), 4.0, True),
}


@pytest.mark.parametrize("p", P)
@pytest.mark.parametrize("optimum", OPTIMA)
def test_the_gap_is_0_at_an_optimum(oracle, optimum, p):
    """With eps = 0 and y = |grad_w f|^(p - 2) d_w f, which is unique as no gradient vanishes.

    Found by halving to 2^-64 of an interval. Tolerances: a few dozen roundings of numbers of the energy's size; for
    p = 1 the limit 1 - 32 u of a length besides.
    """
    graph, f0, f, lam, edge_norm = OPTIMA[optimum](p)
    weighted = oracle.prepare(graph, None)
    d = oracle.difference(weighted, f)
    length = np.abs(d) if edge_norm else oracle.gradient_norm(weighted, f, power=0.5, eps=0, coupled=True)
    y = (0.5 if edge_norm else 1) * d * (length if edge_norm else length[graph.edge_rows()]) ** (p - 2)
    model = Smoothness(p, 0.0, edge=edge_norm)
    energy = oracle.energy(weighted, f, f0, lam, model)
    assert energy > 1
    if optimum == "12-gon" and p == 1:
        assert np.linalg.norm(f[0]) == pytest.approx(2.5693819, abs=1e-7)
    assert abs(oracle.duality_gap(weighted, f, y, f0, lam, model)) <= 1e-13 * energy
    assert_close(oracle.primal(weighted, y, f0, lam), f)
    still = [
        (oracle.dual_step(weighted, y, y.copy(), f, f, model, beta=BETA, sigma=sigma) - y)
        / (1 + sigma * np.abs(d).max())
        for sigma in (0.01, 1.0, 30.0)
    ]
    assert_close(np.stack(still), np.zeros((3, *y.shape)), scale=1)
    # and it is positive elsewhere, by lam/2 |f - f*|^2 at least: the certificate
    moved = f + 0.01 * (cases.rng(5).random(f.shape) - 0.5)
    gap = oracle.duality_gap(weighted, moved, y, f0, lam, model)
    assert gap >= lam / 2 * ((moved - f) ** 2).sum() * (1 - 1e-9) > 0
