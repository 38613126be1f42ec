"""The numpy backend (float64) against the paper's equations as literal loops, and against facts with a proof."""

from __future__ import annotations

import functools
import itertools
import math

import cases
import numpy as np
import paper
import pytest
from numpy.testing import assert_allclose

from gpureg import backends
from gpureg.backends import PatchForm, Smoothness
from gpureg.graphs.csr import Graph
from gpureg.graphs.grid import GridGraph

# Both sides compute in float64 (u = 1.1e-16) and differ in the order of their sums alone. The counting of
# cases.TOLERANCES gives 1498 u = 1.7e-13 for 80 neighbours and 3 channels; the graphs here have at most 26. All
# comparisons are relative to the largest number of the compared array, because sums cancel at some vertices.
RTOL = 1e-12


@pytest.fixture(scope="module")
def oracle():
    return backends.get("numpy", "float64")


def assert_close(actual, expected, scale=None):
    expected = np.asarray(expected)
    largest = np.abs(expected).max(initial=0) if scale is None else scale
    assert_allclose(actual, expected, rtol=0, atol=RTOL * largest + 1e-300)


class Literal:
    """A case as the loops take it: vertices and edges found without gpureg, values under the vertices' names."""

    def __init__(self, name):
        self.graph = cases.graph(name)
        weights = cases.weights(name)
        if isinstance(self.graph, GridGraph):
            grid = self.graph
            self.V = paper.pixels(grid.shape)
            inside = [u for u in self.V if grid.mask is None or grid.mask[u]]
            self.E = paper.k_graph(inside, grid.radius, grid.metric, grid.spacing)
            self.w = dict.fromkeys(self.E, 1.0)
            if weights is not None:
                # A weight is stored once, at the end of the edge that comes first, under the number of its step.
                numbers = {tuple(step): h for h, step in enumerate(grid.forward_offsets.tolist())}
                for u, v in self.E:
                    if u < v:
                        step = tuple(b - a for a, b in zip(u, v, strict=True))
                        self.w[u, v] = self.w[v, u] = float(weights[numbers[step]][u])
        else:
            matrix = self.graph.to_scipy().toarray()
            stored = (self.graph.to_scipy() != 0).toarray()
            self.V = list(range(len(matrix)))
            # edges of weight 0 are left out here: they must not matter
            self.E = {(int(u), int(v)) for u, v in np.argwhere(stored)}
            self.w = {(u, v): float(matrix[u, v]) for u, v in self.E}
        self.gamma = paper.gamma_sqrt(self.E, self.w)

    def functions(self, f):
        """An array (n, m) as a list of m dictionaries."""
        return [dict(zip(self.V, column, strict=True)) for column in f.T.tolist()]

    def array(self, functions):
        """The reverse, (n, m)."""
        return np.array([[function[u] for function in functions] for u in self.V])

    def weighted(self, oracle, name):
        return oracle.prepare(self.graph, cases.weights(name))


@functools.cache
def literal(name):
    return Literal(name)


CHANNELS = [pytest.param(1, True, id="1"), pytest.param(3, True, id="3"), pytest.param(3, False, id="3 uncoupled")]

small_graphs = pytest.mark.parametrize("name", cases.SMALL)
channel_kinds = pytest.mark.parametrize(("channels", "coupled"), CHANNELS)


def test_the_small_graphs_are_small_and_have_edges():
    for name in cases.SMALL:
        assert literal(name).graph.n_vertices < 30
        assert literal(name).graph.n_edges > 0 or name in ("pixel", "csr, one vertex")


@small_graphs
def test_degree(oracle, name):
    case = literal(name)
    expected = [[paper.degree(case.E, case.w, u)] for u in case.V]
    assert_close(oracle.degree(case.weighted(oracle, name)), expected)


@small_graphs
@channel_kinds
def test_local_variation(oracle, name, channels, coupled):
    """Eq. 9 and 15; power 1/2 of |grad f|^2 + eps^2 is the norm."""
    case = literal(name)
    f = cases.function(case.graph, channels)
    norms = paper.norms(case.V, case.E, case.gamma, case.functions(f), cases.EPS, coupled)
    actual = oracle.gradient_norm(case.weighted(oracle, name), f, power=0.5, eps=cases.EPS, coupled=coupled)
    assert_close(actual, case.array(norms[:1] if coupled else norms))


@pytest.mark.parametrize("p", cases.P_ALL)
@small_graphs
@channel_kinds
def test_p_laplacian_energy_and_step(oracle, name, channels, coupled, p):
    """Eq. 12, 19, 20 and 25, with lam per vertex: some without data, some pinned."""
    case = literal(name)
    weighted = case.weighted(oracle, name)
    f, f0 = cases.function(case.graph, channels), cases.function(case.graph, channels, seed=13)
    lam = cases.fidelity(case.graph)
    fs, f0s, (lams,) = case.functions(f), case.functions(f0), case.functions(lam)
    norms = paper.norms(case.V, case.E, case.gamma, fs, cases.EPS, coupled)

    g = None
    if p != 2:
        g = oracle.gradient_norm(weighted, f, power=(p - 2) / 2, eps=cases.EPS, coupled=coupled)
    laplacian = [
        {u: paper.p_laplace(case.E, case.gamma, one, u, p, norm) for u in case.V}
        for one, norm in zip(fs, norms, strict=True)
    ]
    assert_close(oracle.p_laplacian(weighted, f, g), case.array(laplacian))

    energy = paper.energy(case.V, case.E, case.gamma, fs, f0s, lams, p, cases.EPS, coupled)
    actual = oracle.energy(weighted, f, f0, lam, Smoothness(p, cases.EPS, coupled))
    assert_close(actual, energy)

    for theta in (1.0, 0.625):
        stepped = paper.jacobi_step(case.V, case.E, case.gamma, fs, f0s, lams, p, cases.EPS, coupled, theta)
        assert_close(oracle.jacobi_step(weighted, f, f0, g, lam, theta=theta), case.array(stepped))


class Form:
    """A graph with gamma = sqrt(w), or with random values of gamma, one per directed edge, some of them 0."""

    def __init__(self, oracle, name, directed):
        self.case = case = literal(name)
        self.edges = sorted(case.E) if isinstance(case.graph, GridGraph) else list(self._stored(case.graph))
        if not directed:
            self.gamma, self.weighted = case.gamma, case.weighted(oracle, name)
            return
        values = cases.rng(31).random(len(self.edges))
        values[::6] = 0
        self.gamma = dict(zip(self.edges, values.tolist(), strict=True)) | dict.fromkeys(case.E - set(self.edges), 0.0)
        self.weighted = oracle.prepare_gamma(case.graph, self.to_host(values[:, None]))

    @staticmethod
    def _stored(graph):
        return zip(graph.edge_rows().tolist(), graph.indices.tolist(), strict=True)

    @property
    def E(self):
        return set(self.edges)

    def to_host(self, values):
        """One row per edge, in the form that a backend takes."""
        graph = self.case.graph
        return graph.edges.scatter(values) if isinstance(graph, GridGraph) else values

    def from_host(self, values):
        graph = self.case.graph
        return graph.edges.gather(values) if isinstance(graph, GridGraph) else values


both_forms = pytest.mark.parametrize("directed", [False, True], ids=["sqrt(w)", "gamma"])


@pytest.fixture
def form(oracle, name, directed):
    made = Form(oracle, name, directed)
    if not directed and not isinstance(made.case.graph, GridGraph):
        # stored edges of weight 0 are edges for d_w, with gamma = 0
        made.gamma = {e: made.gamma.get(e, 0.0) for e in made.edges}
    return made


@both_forms
@small_graphs
@pytest.mark.parametrize("channels", [1, 3])
def test_difference_and_adjoint(oracle, form, channels):
    """Eq. 4 and 7, and eq. 6, which makes one the adjoint of the other."""
    case = form.case
    f = cases.function(case.graph, channels)
    fs = case.functions(f)
    d = oracle.difference(form.weighted, f)
    expected = [[paper.difference(form.gamma, one, u, v) for one in fs] for u, v in form.edges]
    assert_close(form.from_host(d), np.array(expected).reshape(len(form.edges), channels))
    H = cases.rng(37).random((len(form.edges), channels)) - 0.5
    Hs = [dict(zip(form.edges, column, strict=True)) for column in H.T.tolist()]
    expected = [[paper.adjoint(form.E, form.gamma, one, u) for one in Hs] for u in case.V]
    adjoint = oracle.adjoint(form.weighted, form.to_host(H))
    assert_close(adjoint, expected)
    products = (form.from_host(d) * H).sum(), (f * adjoint).sum()
    assert_close(products[0], products[1], scale=np.abs(f).sum() * np.abs(adjoint).max(initial=0))


@pytest.mark.parametrize("p", (0.5, 1.0, 1.5, 2.0, 3.0))
@both_forms
@small_graphs
@channel_kinds
def test_both_norms_and_processes(oracle, form, channels, coupled, p):
    """Eq. 10, 12, 20, 24, 25 and 30, for gamma = sqrt(w) and for gamma as an array."""
    case, E, gamma, weighted = form.case, form.E, form.gamma, form.weighted
    f, f0 = cases.function(case.graph, channels), cases.function(case.graph, channels, seed=13)
    lam, tau = cases.fidelity(case.graph), 0.25 + cases.rng(3).random((case.graph.n_vertices, 1))
    fs, f0s = case.functions(f), case.functions(f0)
    (lams,), (taus,) = case.functions(lam), case.functions(tau)
    eps = cases.EPS

    norms = paper.norms(case.V, E, gamma, fs, eps, coupled)
    on_edges = paper.edge_norms(E, gamma, fs, 0.0, coupled)
    expected = [{u: paper.lp_norm(E, norm, u, p) for u in case.V} for norm in on_edges]
    actual = oracle.gradient_norm(weighted, f, power=1 / p, eps=0.0, coupled=coupled, edge_power=p / 2)
    assert_close(actual, case.array(expected[:1] if coupled else expected))

    for edge in (False, True):
        model = Smoothness(p, eps, coupled, edge)
        g = oracle.conductances(weighted, f, model)
        if edge:
            slopes = [
                {u: paper.edge_p_laplace(E, gamma, one, u, p, norm) for u in case.V}
                for one, norm in zip(fs, paper.edge_norms(E, gamma, fs, eps, coupled), strict=True)
            ]
        else:
            slopes = [
                {u: paper.p_laplace(E, gamma, one, u, p, norm) for u in case.V}
                for one, norm in zip(fs, norms, strict=True)
            ]
        assert_close(oracle.p_laplacian(weighted, f, g), case.array(slopes))
        energy = paper.energy(case.V, E, gamma, fs, f0s, lams, p, eps, coupled, edge)
        assert_close(oracle.energy(weighted, f, f0, lam, model), energy)
        stepped = paper.jacobi_step(case.V, E, gamma, fs, f0s, lams, p, eps, coupled, 0.625, edge)
        assert_close(oracle.jacobi_step(weighted, f, f0, g, lam, theta=0.625), case.array(stepped))
        stepped = paper.euler_step(case.V, E, gamma, fs, f0s, lams, taus, p, eps, coupled, edge)
        assert_close(oracle.euler_step(weighted, f, f0, g, lam, tau), case.array(stepped))


@small_graphs
def test_one_lam_for_all_vertices(oracle, name):
    case = literal(name)
    weighted = case.weighted(oracle, name)
    f, f0 = cases.function(case.graph), cases.function(case.graph, seed=13)
    for lam in (0.0, 0.75, math.inf):
        lams = dict.fromkeys(case.V, lam)
        fs, f0s = case.functions(f), case.functions(f0)
        expected = paper.jacobi_step(case.V, case.E, case.gamma, fs, f0s, lams, 2, cases.EPS, True)
        assert_close(oracle.jacobi_step(weighted, f, f0, None, lam), case.array(expected))
        energy = paper.energy(case.V, case.E, case.gamma, fs, f0s, lams, 2, cases.EPS, True)
        assert_close(oracle.energy(weighted, f, f0, lam, Smoothness(2, cases.EPS)), energy)


def test_a_vertex_that_nothing_reaches_keeps_its_data(oracle):
    """0/0 in eq. 25 (lam 0, no weight around the vertex) is defined as f0, not as f."""
    graph = Graph.from_edges([[0, 1], [2, 3]], [1.0, 0.0], n_vertices=5)
    f, f0 = cases.function(graph, seed=5), cases.function(graph, seed=7)
    step = oracle.jacobi_step(oracle.prepare(graph, None), f, f0, None, 0.0)
    assert_close(step, [f[1], f[0], f0[2], f0[3], f0[4]])


@pytest.mark.parametrize("block", [1, 7])
def test_blocks_of_edges_do_not_show(oracle, monkeypatch, block):
    """The oracle takes a stored graph some rows at a time; a row longer than a block is one block."""
    graph = cases.graph("small csr")
    f, f0 = cases.function(graph, 2), cases.function(graph, 2, seed=13)
    weighted = oracle.prepare(graph, None)
    whole = oracle.jacobi_step(weighted, f, f0, None, 0.0)
    form = PatchForm(np.ones(1), scale=1.0)
    whole_weights = oracle.get_weights(oracle.patch_distance(graph, f, form))
    monkeypatch.setattr("gpureg.backends.numpy.edges._BLOCK", block)
    assert_close(oracle.jacobi_step(weighted, f, f0, None, 0.0), whole)
    assert_close(oracle.get_weights(oracle.patch_distance(graph, f, form)), whole_weights)


PATCHES = [
    pytest.param(0, None, id="one pixel"),
    pytest.param(1, None, id="flat 1"),
    pytest.param(2, 0.75, id="gaussian 2"),
    pytest.param(4, None, id="wider than the image"),
]


def profile_of(radius, a):
    if a is None:
        return np.ones(2 * radius + 1)
    line = np.exp(-(np.arange(-radius, radius + 1) ** 2) / (2 * a * a))
    return line / line.sum()


def literal_patch(radius, a, ndim):
    return paper.flat_patch(radius, ndim) if a is None else paper.gaussian_patch(radius, ndim, a)


@pytest.mark.parametrize(("radius", "a"), PATCHES)
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("name", ["small grid", "small masked", "small row", "small volume"])
def test_patch_distance_and_w2(oracle, name, channels, radius, a):
    """rho_a and w_2 of section 5.2 on grids of one to three axes, patches filled by reflection."""
    case, grid = literal(name), cases.graph(name)
    if radius == 4 and grid.ndim == 3:
        radius = 3  # 343 offsets are enough for loops
    f0 = cases.function(grid, channels)
    f0s, g = case.functions(f0), literal_patch(radius, a, grid.ndim)
    h = 0.5 * math.sqrt(len(g)) if a is None else 0.5
    raw = oracle.get_weights(oracle.patch_distance(grid, f0, PatchForm(profile_of(radius, a))))
    similar = oracle.get_weights(oracle.patch_distance(grid, f0, PatchForm(profile_of(radius, a), scale=1 / h**2)))
    for expected, actual in (
        ({edge: paper.rho(*edge, f0s, grid.shape, g) for edge in case.E}, raw),
        ({edge: paper.w2(*edge, f0s, grid.shape, g, h) for edge in case.E}, similar),
    ):
        half = np.zeros((grid.half_window, *grid.shape))
        for plane, step in zip(half, grid.forward_offsets.tolist(), strict=True):
            for u in case.V:
                plane[u] = expected.get((u, tuple(a + b for a, b in zip(u, step, strict=True))), 0)
        assert_close(actual, half)


def test_the_same_patches_on_a_stored_graph(oracle):
    grid = cases.graph("small grid")
    twin, f0 = grid.to_graph(), cases.function(grid, 3)
    form = PatchForm(profile_of(2, 0.75), shift=0.125, scale=2.0)
    on_grid = oracle.get_weights(oracle.patch_distance(grid, f0, form))
    assert_close(oracle.get_weights(oracle.patch_distance(twin, f0, form)), grid.edges.gather_half(on_grid))


@pytest.mark.parametrize("channels", [1, 3])
def test_w1(oracle, channels):
    """w_1 of section 5.2 is a patch of one pixel with a factor for each step."""
    case, grid = literal("small grid"), cases.graph("small grid")
    f0 = cases.function(grid, channels)
    sigma_space, sigma_value = 1.5, 0.4
    spatial = np.exp(-(grid.forward_offsets**2).sum(axis=1) / sigma_space**2)
    form = PatchForm(np.ones(1), scale=1 / sigma_value**2, spatial=spatial)
    edges = grid.edges.gather_half(oracle.get_weights(oracle.patch_distance(grid, f0, form)))
    expected = [paper.w1(u, v, case.functions(f0), sigma_space, sigma_value) for u, v in sorted(case.E)]
    assert_close(edges, expected)


def test_noise_taken_off_the_distance_stops_at_zero(oracle):
    """exp(-max(rho - shift, 0) scale): a distance below the noise's share counts as none."""
    graph = Graph.from_edges([[0, 1], [1, 2]])
    f0 = np.array([[0.0], [1.0], [3.0]])
    form = PatchForm(np.ones(1), shift=2.0, scale=0.5, spatial=np.array([1.0, 1.0, 0.5, 0.5]))
    weights = oracle.get_weights(oracle.patch_distance(graph, f0, form))
    assert_close(weights, [1, 1, 0.5 * math.exp(-1), 0.5 * math.exp(-1)])


# Facts with a proof, about the oracle itself


@pytest.mark.parametrize("p", cases.P_ALL)
@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize("name", ["small grid", "small csr"])
def test_gradient_of_the_energy_is_the_p_laplacian(oracle, name, coupled, p):
    """Property 2 and eq. 21, by central differences.

    With eps = 1/4 and steps of h = 1e-3 the five-point formula is off by h^4/30 times a fifth derivative of the order
    of eps^-4 times the gradient, 1e-11 of it, and by the energy's rounding over h, about 1e-12: 1e-8 leaves room.
    """
    graph = cases.graph(name)
    weighted = oracle.prepare(graph, cases.weights(name))
    f, f0 = cases.function(graph, 2), cases.function(graph, 2, seed=13)
    lam, eps, h = np.where(np.isinf(cases.fidelity(graph)), 2.0, cases.fidelity(graph)), 0.25, 1e-3

    def energy_at(index, step):
        moved = f.copy()
        moved[index] += step
        return oracle.energy(weighted, moved, f0, lam, Smoothness(p, eps, coupled))

    numeric = np.empty_like(f)
    for index in np.ndindex(f.shape):
        near = energy_at(index, h) - energy_at(index, -h)
        far = energy_at(index, 2 * h) - energy_at(index, -2 * h)
        numeric[index] = (8 * near - far) / (12 * h)
    g = oracle.gradient_norm(weighted, f, power=(p - 2) / 2, eps=eps, coupled=coupled)
    analytic = oracle.p_laplacian(weighted, f, g) + lam * (f - f0)
    assert_allclose(numeric, analytic, rtol=0, atol=1e-8 * np.abs(analytic).max())


@pytest.mark.parametrize("p", cases.P)
@pytest.mark.parametrize("lam", [0.0, 0.5, 10.0])
@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize("name", ["small masked", "small csr"])
def test_a_sweep_never_raises_the_energy(oracle, name, coupled, lam, p):
    """Holds for 0 < p <= 2, eps > 0, lam >= 0: the frozen coefficients give a quadratic majoriser."""
    graph = cases.graph(name)
    weighted = oracle.prepare(graph, cases.weights(name))
    f0 = cases.function(graph, 2)
    f = f0
    energies = []
    for _ in range(40):
        energies.append(oracle.energy(weighted, f, f0, lam, Smoothness(p, cases.EPS, coupled)))
        out = np.full_like(f, np.nan)
        f = oracle.sweep(weighted, f, f0, lam, Smoothness(p, cases.EPS, coupled), theta=1.0, g=None, out=out)
    rises = np.diff(energies)
    assert rises.max() <= 1e-14 * energies[0]  # the rounding of a sum of a few dozen numbers
    assert energies[-1] < energies[0]


@pytest.mark.parametrize("p", cases.P_ALL)
@small_graphs
def test_constants_are_fixed_points(oracle, name, p):
    graph = cases.graph(name)
    weighted = oracle.prepare(graph, cases.weights(name))
    f = np.full((graph.n_vertices, 2), 0.7)
    g = oracle.gradient_norm(weighted, f, power=(p - 2) / 2, eps=cases.EPS, coupled=True)
    assert_close(g, np.full((graph.n_vertices, 1), cases.EPS ** (p - 2)))
    assert not oracle.p_laplacian(weighted, f, g).any()
    for lam in (0.0, 0.5):
        assert_close(oracle.jacobi_step(weighted, f, f, g, lam), f)


def minimise(oracle, graph, f0, lam, p, eps, sweeps):
    weighted = oracle.prepare(graph, None)
    f, out = f0.copy(), np.full_like(f0, np.nan)
    for _ in range(sweeps):
        oracle.sweep(weighted, f, f0, lam, Smoothness(p, eps), theta=1.0, g=None, out=out)
        f, out = out, f
    return f


@pytest.mark.parametrize(("w", "lam"), [*itertools.product([0.25, 1.0, 3.0], [0.5, 4.0])])
def test_one_edge(oracle, w, lam):
    """K2 with a gap d0: at p = 2 the gap becomes lam d0/(lam + 4 w), the mean stays.

    A sweep shrinks the error by 2 w/(lam + 2 w) <= 12/13: 400 sweeps leave 1e-14.
    """
    graph, d0 = Graph.from_edges([[0, 1]], [w]), 3.0
    f = minimise(oracle, graph, np.array([[1.0], [1.0 + d0]]), lam, 2, 0.0, 400)
    assert_allclose(f[1] - f[0], lam * d0 / (lam + 4 * w), rtol=1e-12)
    assert_allclose(f.mean(), 1 + d0 / 2, rtol=1e-12)


@pytest.mark.parametrize("p", [1.0, 1.5])
def test_one_edge_below_two(oracle, p):
    """K2: the gap d solves 2 w^(p/2) d^(p-1) = lam/2 (d0 - d).

    Smoothing by eps moves the minimiser by at most sqrt(2 eps^p/(p lam)) in the root mean square.
    """
    w, lam, d0, eps = 0.25, 4.0, 3.0, 1e-4
    f = minimise(oracle, Graph.from_edges([[0, 1]], [w]), np.array([[1.0], [1.0 + d0]]), lam, p, eps, 400)
    low, high = 0.0, d0
    for _ in range(100):  # bisection: the left side rises with d, the right side falls
        d = (low + high) / 2
        low, high = (low, d) if 2 * w ** (p / 2) * d ** (p - 1) > lam / 2 * (d0 - d) else (d, high)
    if p == 1:
        assert d == pytest.approx(d0 - 4 * math.sqrt(w) / lam)
    assert abs(f[1, 0] - f[0, 0] - d) <= 2 * math.sqrt(2 * eps**p / (p * lam))


@pytest.mark.parametrize(("n", "w", "lam"), [(3, 1.0, 2.0), (7, 0.5, 0.5)])
def test_star(oracle, n, w, lam):
    """A star of n leaves at 0 and a centre at d0: at p = 2, 2 n w d = lam n/(n + 1) (d0 - d).

    A sweep shrinks the error by at most 2 n w/(lam + 2 n w) <= 7/7.5: 600 sweeps leave 1e-18.
    """
    graph, d0 = Graph.from_edges([[0, k] for k in range(1, n + 1)], np.full(n, w)), 2.0
    f0 = np.zeros((n + 1, 1))
    f0[0] = d0
    f = minimise(oracle, graph, f0, lam, 2, 0.0, 600)
    share = lam / (n + 1)
    assert_allclose(f[0] - f[1:, 0], share * d0 / (share + 2 * w), rtol=1e-12)
    assert_allclose(f.sum(), d0, rtol=1e-12)
