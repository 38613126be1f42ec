"""Every primitive on every device against the numpy backend in float64, within the bounds of tests/bounds.py."""

from __future__ import annotations

import copy
import dataclasses
import functools

import bounds
import cases
import numpy as np
import pytest
from conftest import device_params
from numpy.testing import assert_array_equal

from gpureg import backends, kernels
from gpureg.backends import BackendUnavailable, PatchForm, Smoothness
from gpureg.graphs.csr import Graph
from gpureg.graphs.edges import opposite_edges
from gpureg.graphs.grid import GridGraph

DTYPES = ("float32", "float64")

every_setup = pytest.mark.parametrize(
    ("setup", "dtype"),
    [
        pytest.param(setup, dtype, id=f"{setup.id}-{dtype}")
        for dtype in DTYPES
        for setup in cases.SETUPS
        if dtype == "float32" or setup.wide
    ],
)
every_dtype = pytest.mark.parametrize("dtype", DTYPES)


@pytest.fixture
def backend(device, dtype):
    """A device computing in one type; devices without float64 skip it."""
    try:
        return backends.get(device, dtype)
    except BackendUnavailable as error:
        assert dtype == "float64", error
        pytest.skip(str(error))


@functools.cache
def oracle():
    return backends.get("numpy", "float64")


def rounded(x):
    """To float32 and back, so that both types hold it exactly."""
    return None if x is None else x.astype(np.float32).astype(np.float64)


class Problem:
    """A setup's functions and weights on the host, the same for the oracle and the devices."""

    def __init__(self, setup, dtype):
        self.setup = setup
        self.graph, self.weights = cases.graph(setup.graph), cases.weights(setup.graph)
        self.f = cases.function(self.graph, setup.channels)
        self.f0 = cases.function(self.graph, setup.channels, seed=13)
        self.lam = cases.fidelity(self.graph)
        self.exact = oracle().prepare(self.graph, self.weights)
        self.bounds = bounds.Bounds(self.graph, self.weights, dtype)

    @functools.cached_property
    def q(self):
        """|grad f|^2 + eps^2."""
        return oracle().gradient_norm(self.exact, self.f, power=1, eps=cases.EPS, coupled=self.setup.coupled)

    def conductances(self, p):
        """What every p but 2 needs, exact in both types: a primitive is held to its own errors alone."""
        return None if p == 2 else rounded(self.q ** ((p - 2) / 2))


@functools.cache
def problem(setup, dtype):
    return Problem(setup, dtype)


def nan(backend, graph, channels):
    """An output that a kernel has to write: NaN everywhere."""
    return backend.put(graph, np.full((graph.n_vertices, channels), np.nan))


def as_gpu(device, dtype, monkeypatch):
    """The backend as it treats a GPU: one cell a thread; numpy has no such way."""
    backend = backends.get(device, dtype)
    if backend.name == "warp":
        from gpureg.backends.warp import patches as warp_patches

        monkeypatch.setattr(warp_patches, "_STRIP_ROWS", 1)
        monkeypatch.setattr(warp_patches, "_STRIP_BYTES", backend.dtype.itemsize)
        return backend
    from gpureg.backends.opencl import primitives as opencl

    return opencl.make(dataclasses.replace(backend.device, vector_width=1, kind="gpu"), dtype)


def assert_within(actual, exact, bound, what):
    """NaN fails too: it is not <= anything."""
    actual, exact = np.asarray(actual, float), np.asarray(exact)
    assert actual.shape == exact.shape
    off = np.abs(actual - exact)
    bad = ~(off <= bound)
    if bad.any():
        at = tuple(int(i[0]) for i in np.nonzero(np.atleast_1d(bad)))
        worst = np.nanmax(np.where(bad, off, 0), initial=0)
        raise AssertionError(
            f"{what}: {int(bad.sum())} of {bad.size} numbers are out of bounds, the first at {at}: "
            f"{np.atleast_1d(actual)[at]} for {np.atleast_1d(exact)[at]}, "
            f"allowed {np.atleast_1d(np.broadcast_to(bound, off.shape))[at]:.2g}; the worst is off by {worst:.2g}"
        )


def ps(setup):
    """p = 2 is a variant of its own, without conductances."""
    return cases.P_ALL if setup.full else tuple(p for p in cases.P_ALL if p != 2)


# Data


@every_setup
def test_functions_and_weights_come_back(backend, setup):
    """Bit by bit: both types hold the values exactly."""
    one = problem(setup, backend.dtype.name)
    returned = backend.get(one.graph, backend.put(one.graph, one.f))
    assert returned.dtype == backend.dtype
    assert_array_equal(returned, one.f)
    weighted = backend.prepare(one.graph, one.weights)
    expected = oracle().get_weights(one.exact)
    returned = backend.get_weights(weighted)
    if expected is None:
        assert returned is None
    else:
        assert returned.dtype == backend.dtype
        assert_array_equal(returned, expected)


@every_dtype
def test_put_rounds_and_takes_any_layout(backend, dtype):
    grid = cases.graph("narrow")
    values = cases.rng(3).random((3, grid.n_vertices))  # float64, not exact in float32
    returned = backend.get(grid, backend.put(grid, values.T))
    assert_array_equal(returned, values.T.astype(dtype))
    empty = backend.get(grid, backend.empty(grid, 2))
    assert empty.shape == (grid.n_vertices, 2)


# Primitives


def check_degree(backend, one):
    weighted = backend.prepare(one.graph, one.weights)
    actual = backend.get(one.graph, backend.degree(weighted))
    assert_within(actual, oracle().degree(one.exact), one.bounds.degree(), "degree")
    return [actual]


def check_gradient_norm(backend, one):
    setup, results = one.setup, []
    weighted, f = backend.prepare(one.graph, one.weights), backend.put(one.graph, one.f)
    for power in (1.0, 0.5, *(p / 2 for p in cases.P_ALL), *((p - 2) / 2 for p in cases.P_ALL)):
        out = nan(backend, one.graph, 1 if setup.coupled else setup.channels)
        back = backend.gradient_norm(weighted, f, power=power, eps=cases.EPS, coupled=setup.coupled, out=out)
        assert back is out
        actual = backend.get(one.graph, out)
        bound = one.bounds.gradient_norm(one.q, power, setup.channels, setup.coupled)
        assert_within(actual, one.q**power, bound, f"gradient_norm, power {power}")
        results.append(actual)
    return results


def check_p_laplacian(backend, one):
    results = []
    weighted, f = backend.prepare(one.graph, one.weights), backend.put(one.graph, one.f)
    for p in ps(one.setup):
        g = one.conductances(p)
        out = nan(backend, one.graph, one.setup.channels)
        back = backend.p_laplacian(weighted, f, None if g is None else backend.put(one.graph, g), out=out)
        assert back is out
        actual = backend.get(one.graph, out)
        exact = oracle().p_laplacian(one.exact, one.f, g)
        assert_within(actual, exact, one.bounds.p_laplacian(one.f, g), f"p_laplacian, p = {p}")
        results.append(actual)
    return results


def check_jacobi_step(backend, one):
    results = []
    graph = one.graph
    weighted, f, f0 = backend.prepare(graph, one.weights), backend.put(graph, one.f), backend.put(graph, one.f0)
    for p in ps(one.setup):
        g = one.conductances(p)
        device_g = None if g is None else backend.put(graph, g)
        lams = (one.lam, 0.75, 0.0, float("inf")) if one.setup.full else (one.lam,)
        for lam in lams:
            for theta in (1.0, 0.625):
                out = nan(backend, graph, one.setup.channels)
                device_lam = lam if isinstance(lam, float) else backend.put(graph, lam)
                assert backend.jacobi_step(weighted, f, f0, device_g, device_lam, theta=theta, out=out) is out
                actual = backend.get(graph, out)
                exact = oracle().jacobi_step(one.exact, one.f, one.f0, g, lam, theta=theta)
                bound = one.bounds.jacobi_step(one.f, one.f0, g, lam, theta)
                assert_within(actual, exact, bound, f"jacobi_step, p = {p}, theta = {theta}")
                results.append(actual)
    return results


def check_energy(backend, one):
    setup, graph, results = one.setup, one.graph, []
    weighted, f, f0 = backend.prepare(graph, one.weights), backend.put(graph, one.f), backend.put(graph, one.f0)
    for p in cases.P_ALL:
        for lam in (one.lam, 0.75, float("inf")) if setup.full else (one.lam,):
            device_lam = lam if isinstance(lam, float) else backend.put(graph, lam)
            actual = backend.energy(weighted, f, f0, device_lam, Smoothness(p, cases.EPS, setup.coupled))
            assert isinstance(actual, float)
            exact = oracle().energy(one.exact, one.f, one.f0, lam, Smoothness(p, cases.EPS, setup.coupled))
            bound = one.bounds.energy(one.q, one.f, one.f0, lam, p, setup.coupled)
            assert_within(actual, exact, bound, f"energy, p = {p}")
            results.append(np.array(actual))
    return results


CHECKS = {
    "degree": check_degree,
    "gradient_norm": check_gradient_norm,
    "p_laplacian": check_p_laplacian,
    "jacobi_step": check_jacobi_step,
    "energy": check_energy,
}


@pytest.mark.parametrize("primitive", CHECKS)
@every_setup
def test_primitive(backend, setup, primitive):
    """Within the bound, and the same bits on a second run."""
    one = problem(setup, backend.dtype.name)
    first = CHECKS[primitive](backend, one)
    again = CHECKS[primitive](backend, one)
    assert first
    assert all(a.tobytes() == b.tobytes() for a, b in zip(first, again, strict=True))


@pytest.mark.parametrize("dtype", ["float32"])
@pytest.mark.parametrize("setup", cases.LONG, ids=lambda setup: setup.id)
def test_sums_over_long_segments(backend, setup):
    """A work item adds several vertices here, on the smaller graphs one at most."""
    one = problem(setup, "float32")
    first, again = check_energy(backend, one), check_energy(backend, one)
    assert first == again
    weighted, a = backend.prepare(one.graph, one.weights), backend.put(one.graph, one.f)
    n = one.graph.n_vertices
    for u in (*range(0, n, n // 7), n - 2, n - 1):
        moved = one.f.copy()
        moved[u] += 8
        assert backend.max_change(weighted.graph, a, backend.put(one.graph, moved)) == pytest.approx(8)
        moved[u] = np.nan
        assert backend.max_change(weighted.graph, a, backend.put(one.graph, moved)) == np.inf


@pytest.mark.parametrize("setup", [cases.SETUPS[0], *cases.LONG], ids=lambda setup: setup.id)
def test_long_sums_without_float64(setup):
    """The compensated sum of an OpenCL device that has float32 alone, on one that has both."""
    if "opencl" in backends.absent():
        pytest.skip(backends.absent()["opencl"])
    backend = copy.copy(backends.get("opencl"))
    backend._options, backend._sum_type = (), np.dtype(np.float32)
    assert check_energy(backend, problem(setup, "float32"))


@every_setup
def test_max_change(backend, setup):
    one = problem(setup, backend.dtype.name)
    graph, weighted = one.graph, backend.prepare(one.graph, one.weights)
    a = backend.put(graph, one.f)
    exact = float(np.abs(one.f - one.f0).max())
    change = backend.max_change(weighted.graph, a, backend.put(graph, one.f0))
    assert_within(change, exact, one.bounds.max_change(exact), "max_change")
    assert backend.max_change(weighted.graph, a, a) == 0
    # The largest change may sit anywhere, the last vertex and the last channel included.
    for u in {0, graph.n_vertices // 2, graph.n_vertices - 1}:
        for c in {0, setup.channels - 1}:
            moved = one.f.copy()
            moved[u, c] -= 8
            assert backend.max_change(weighted.graph, a, backend.put(graph, moved)) == pytest.approx(8)
            for broken in (np.nan, np.inf):
                moved[u, c] = broken
                assert backend.max_change(weighted.graph, a, backend.put(graph, moved)) == np.inf
                assert backend.max_change(weighted.graph, backend.put(graph, moved), a) == np.inf


@every_setup
def test_sweep_is_its_two_primitives(backend, setup):
    """A backend may fuse them, and then round otherwise; from NaN scratch and output."""
    one = problem(setup, backend.dtype.name)
    graph, m, G = one.graph, setup.channels, 1 if setup.coupled else setup.channels
    weighted, f, f0 = backend.prepare(graph, one.weights), backend.put(graph, one.f), backend.put(graph, one.f0)
    lam = backend.put(graph, one.lam)
    for p in ps(setup):
        g = None
        if p != 2:
            g = backend.gradient_norm(weighted, f, power=(p - 2) / 2, eps=cases.EPS, coupled=setup.coupled)
        expected = backend.get(graph, backend.jacobi_step(weighted, f, f0, g, lam, theta=0.625))
        scratch, out = None if p == 2 else nan(backend, graph, G), nan(backend, graph, m)
        back = backend.sweep(
            weighted, f, f0, lam, Smoothness(p, cases.EPS, setup.coupled), theta=0.625, g=scratch, out=out
        )
        assert back is out
        largest = np.abs(expected).max()
        assert_within(backend.get(graph, out), expected, cases.TOLERANCES[backend.dtype.name] * largest, f"p = {p}")


@every_setup
def test_sweeps_in_a_row(backend, setup):
    """A kernel's output is another one's input: what it leaves in padding must do no harm.

    eps = 1/4 keeps the conductances from magnifying the first sweeps' rounding (by 1/eps at most), so that four sweeps
    stay within the tolerance of one.
    """
    one = problem(setup, backend.dtype.name)
    p, eps, tolerance = 1.0, 0.25, cases.TOLERANCES[backend.dtype.name]

    def four(on, weighted):
        a, f0 = on.put(one.graph, one.f), on.put(one.graph, one.f0)
        b, lam = nan(on, one.graph, setup.channels), on.put(one.graph, one.lam)
        g = nan(on, one.graph, 1 if setup.coupled else setup.channels)
        for _ in range(4):
            on.sweep(weighted, a, f0, lam, Smoothness(p, eps, setup.coupled), theta=1.0, g=g, out=b)
            a, b = b, a
        return on.get(one.graph, a)

    exact = four(oracle(), one.exact)
    actual = four(backend, backend.prepare(one.graph, one.weights))
    assert_within(actual, exact, tolerance * np.abs(exact).max(), "four sweeps")


# Both forms of gamma, both norms, both processes, functions on the edges


class Forms:
    """A setup with gamma = sqrt(w) or with one value of gamma per directed edge, and how large its sums can get."""

    def __init__(self, setup, directed):
        self.setup, self.directed, self.graph = setup, directed, cases.graph(setup.graph)
        self.csr = self.graph if isinstance(self.graph, Graph) else self.graph.to_graph(cases.weights(setup.graph))
        self.rows, self.columns = self.csr.edge_rows(), self.csr.indices
        random = cases.rng(53).random((len(self.rows), 1), dtype=np.float32).astype(np.float64)
        random[::9] = 0
        self.host_gamma = self.host(random)
        opposite = opposite_edges(self.csr.indptr, self.csr.indices)
        w = np.ones(len(self.rows)) if self.csr.weights is None else self.csr.weights.astype(np.float64)
        self.own = random if directed else np.sqrt(w)[:, None]
        self.other = self.own[opposite]
        self.f = cases.function(self.graph, setup.channels)
        self.f0 = cases.function(self.graph, setup.channels, seed=13)
        self.H = cases.rng(59).random((len(self.rows), setup.channels), dtype=np.float32).astype(np.float64) - 0.5
        self.lam = cases.fidelity(self.graph)
        self.tau = 0.125 * cases.rng(61).random((self.graph.n_vertices, 1), dtype=np.float32).astype(np.float64)

    def host(self, edges):
        """A function on the edges as a backend takes it."""
        return self.graph.edges.scatter(edges) if isinstance(self.graph, GridGraph) else edges

    def on(self, backend):
        if self.directed:
            return backend.prepare_gamma(self.graph, self.host_gamma)
        return backend.prepare(self.graph, cases.weights(self.setup.graph))

    def around(self, edges):
        """Sums over the edges of each vertex, (n, m)."""
        n = self.graph.n_vertices
        return np.stack([np.bincount(self.rows, column, minlength=n) for column in edges.T], axis=1)

    @functools.cached_property
    def sizes(self):
        """|gamma_vu f(v)| + |gamma_uv f(u)|, what the two terms of a difference can be, (n_edges, m)."""
        return self.other * np.abs(self.f[self.columns]) + self.own * np.abs(self.f[self.rows])

    def conductance(self, p):
        """A bound on the conductances."""
        largest = (self.around(self.sizes**2).sum(axis=1).max(initial=0) + cases.EPS**2) ** 0.5
        return 2 * max(cases.EPS ** (p - 2), largest ** (p - 2))


@functools.cache
def forms(setup, directed):
    return Forms(setup, directed)


FORM_SETUPS = [
    pytest.param(cases.Setup("grid"), "float32", id="grid"),
    pytest.param(cases.Setup("grid"), "float64", id="grid-float64"),
    pytest.param(cases.Setup("masked", 3), "float32", id="masked, 3"),
    pytest.param(cases.Setup("volume"), "float32", id="volume"),
    pytest.param(cases.Setup("csr", 3, coupled=False), "float32", id="csr, 3 uncoupled"),
    pytest.param(cases.Setup("csr", 3, coupled=False), "float64", id="csr, 3 uncoupled-float64"),
    pytest.param(cases.Setup("pixel"), "float32", id="pixel"),
]
every_form = pytest.mark.parametrize(("setup", "dtype"), FORM_SETUPS)
# Each is a dozen kernels that every device compiles, so not all of them.
some_forms = pytest.mark.parametrize(
    ("setup", "dtype"), [param for param in FORM_SETUPS if param.id not in ("volume", "grid-float64")]
)
both_forms = pytest.mark.parametrize("directed", [False, True], ids=["sqrt(w)", "gamma"])


@both_forms
@every_form
def test_functions_on_the_edges(backend, setup, dtype, directed):
    """There and back to the bit; the difference and its adjoint from outputs full of NaN, within a few roundings."""
    one, u = forms(setup, directed), cases.UNIT_ROUNDOFF[dtype]
    graph, H = one.graph, one.host(one.H)
    assert_array_equal(backend.get_edges(graph, backend.put_edges(graph, H)), H)
    weighted, exact = one.on(backend), one.on(oracle())
    nans = backend.put_edges(graph, np.full_like(H, np.nan))
    assert backend.difference(weighted, backend.put(graph, one.f), out=nans) is nans
    # 2 products and a difference, or a root (6 u), a difference and a product: 8 u of the terms' sizes, twice
    bound = 16 * u * one.host(one.sizes)
    assert_within(backend.get_edges(graph, nans), oracle().difference(exact, one.f), bound, "difference")
    out = nan(backend, graph, setup.channels)
    assert backend.adjoint(weighted, backend.put_edges(graph, H), out=out) is out
    # a root, a difference and a product (8 u), then the additions, at most one per neighbour
    count = np.bincount(one.rows, minlength=graph.n_vertices)[:, None]
    opposite = one.H[opposite_edges(one.csr.indptr, one.csr.indices)]
    bound = 2 * (8 + count) * u * one.around(one.own * (np.abs(opposite) + np.abs(one.H)))
    assert_within(backend.get(graph, out), oracle().adjoint(exact, H), bound, "adjoint")


@both_forms
@some_forms
def test_both_norms_and_processes(backend, setup, dtype, directed):
    """Each primitive in the forms that the tests above leave out, and the same bits on a second run.

    The counting of cases.TOLERANCES, relative to the sum of the sizes of the terms: with gamma as an array, or from the
    differences of single edges, terms cancel before they are raised to a power.
    """
    one, tolerance = forms(setup, directed), cases.TOLERANCES[dtype]
    graph, m, coupled = one.graph, setup.channels, setup.coupled
    exact, weighted = one.on(oracle()), one.on(backend)
    f, f0, lam, tau = (backend.put(graph, x) for x in (one.f, one.f0, one.lam, one.tau))
    flow = one.around(one.own * one.sizes)
    finite = np.where(np.isinf(one.lam), 0, one.lam)

    def check(actual, expected, scale, what):
        assert_within(backend.get(graph, actual), expected, tolerance * (scale + 1e-30), what)

    degree = one.around(one.own**2)
    check(backend.degree(weighted), oracle().degree(exact), degree, "degree")
    for p in (0.7, 3.0):
        for eps in (cases.EPS, 0.0):  # the root and the powers of 0 too
            settings = {"power": 1 / p, "eps": eps, "coupled": coupled, "edge_power": p / 2}
            out = nan(backend, graph, 1 if coupled else m)
            assert backend.gradient_norm(weighted, f, out=out, **settings) is out
            expected = oracle().gradient_norm(exact, one.f, **settings)
            check(out, expected, expected.max(initial=0), f"L^p norm, p = {p}, eps = {eps}")
        for edge_norm in (False, True):
            model = Smoothness(p, cases.EPS, coupled, edge_norm)
            what = f"p = {p}, edge norm {edge_norm}"
            g, exact_g = None, None
            if edge_norm:
                g = exact_g = model
            else:
                exact_g = rounded(oracle().conductances(exact, one.f, model))
                g = backend.put(graph, exact_g)
            results = []
            for _ in range(2):
                slope, step, moved = (nan(backend, graph, m) for _ in range(3))
                assert backend.p_laplacian(weighted, f, g, out=slope) is slope
                assert backend.jacobi_step(weighted, f, f0, g, lam, theta=0.625, out=step) is step
                assert backend.euler_step(weighted, f, f0, g, lam, tau, out=moved) is moved
                energy = backend.energy(weighted, f, f0, lam, model)
                results.append([*(backend.get(graph, x).tobytes() for x in (slope, step, moved)), energy])
            assert results[0] == results[1]
            push = one.conductance(p) * flow.max(initial=0)
            check(slope, oracle().p_laplacian(exact, one.f, exact_g), push, f"p_laplacian, {what}")
            expected = oracle().jacobi_step(exact, one.f, one.f0, exact_g, one.lam, theta=0.625)
            # with gamma that is not symmetric a step is no mean: sums of pulls over sums of holds, vertex by vertex
            check(step, expected, 1 + np.abs(expected), f"jacobi_step, {what}")
            expected = oracle().euler_step(exact, one.f, one.f0, exact_g, one.lam, one.tau)
            check(moved, expected, 1 + one.tau * (push + finite), f"euler_step, {what}")
            expected = oracle().energy(exact, one.f, one.f0, one.lam, model)
            assert energy == pytest.approx(expected, rel=tolerance, abs=1e-30), what
    for number in (0.5, float("inf")):
        moved = backend.euler_step(weighted, f, f0, None, number, 0.0625)
        expected = oracle().euler_step(exact, one.f, one.f0, None, number, 0.0625)
        check(moved, expected, 1 + flow.max(initial=0), f"euler_step, lam = {number}")


# Patches


@dataclasses.dataclass(frozen=True)
class PatchCase:
    """Weights from patches: the patch, similarity or bare distance, with a spatial factor or not."""

    graph: str
    channels: int = 1
    radius: int = 1
    gaussian: bool = False
    shift: float = 0.0
    scale: float | None = None
    spatial: bool = False
    wide: bool = False
    maps: bool = False
    cut: float = 0.0

    @property
    def id(self):
        kind = "distance" if self.scale is None else "similarity"
        extras = [name for name in ("gaussian", "spatial", "maps", "shift", "cut") if getattr(self, name)]
        return f"{self.graph}, {self.channels}, radius {self.radius}, {' '.join([kind, *extras])}"

    def form(self, graph):
        r = self.radius
        profile = np.ones(2 * r + 1)
        if self.gaussian:
            profile = np.exp(-(np.arange(-r, r + 1) ** 2) / 2)
            profile /= profile.sum()
        spatial = None
        if self.spatial and isinstance(graph, GridGraph):
            spatial = np.exp(-(graph.forward_offsets**2).sum(axis=1) / 4)
        elif self.spatial:
            spatial = np.exp(-np.abs(graph.edge_rows() - graph.indices) / 64)
        maps = None
        if self.maps:
            # exact in both types: what is taken off, and strengths that differ by a factor of 8 at most
            a = cases.rng(31).integers(0, 16, graph.n_vertices) / 64
            maps = np.stack([a, 2.0 ** cases.rng(37).integers(-1, 3, graph.n_vertices)], axis=-1)
        return PatchForm(profile, self.shift, self.scale, spatial, maps, self.cut)


# Seven compilations a device and type. A radius of 4 reaches over both ends of a row of 3.
PATCHES = (
    PatchCase("grid", radius=2),
    PatchCase("grid", scale=0.5, spatial=True, shift=0.125, wide=True),
    PatchCase("grid", channels=3, radius=3, gaussian=True, shift=0.03, scale=8.0),
    PatchCase("narrow", radius=4, scale=0.01),
    PatchCase("masked", radius=1, scale=0.5),
    PatchCase("row", radius=2, scale=1.0, wide=True),
    PatchCase("volume", radius=1, gaussian=True, scale=4.0),
    PatchCase("pixel", radius=2, scale=1.0),
    PatchCase("csr", channels=3, radius=0, scale=2.0, spatial=True, wide=True),
    PatchCase("csr of grid", radius=2),
    PatchCase("csr of grid", radius=1, shift=0.125, scale=0.5),
    PatchCase("masked", channels=2, radius=1, shift=0.125, scale=0.5, spatial=True, maps=True, wide=True),
    PatchCase("volume", radius=1, gaussian=True, scale=0.5, maps=True),
    PatchCase("csr of grid", radius=1, shift=0.125, scale=0.5, maps=True, cut=0.5, wide=True),
    PatchCase("grid", scale=0.5, spatial=True, cut=0.75),
)


def at_both_ends(graph, form):
    """a(u) + a(v) and q(u) q(v) per weight, of a form with maps."""
    if form.maps is None:
        return ()
    a, q = form.maps.T
    if isinstance(graph, Graph):
        return a[graph.edge_rows()] + a[graph.indices], q[graph.edge_rows()] * q[graph.indices]
    taken, strength = np.zeros((2, graph.half_window, *graph.shape))
    a, q = a.reshape(graph.shape), q.reshape(graph.shape)
    for h, step in enumerate(graph.forward_offsets):
        u, v = graph.ends(step)
        taken[h][u], strength[h][u] = a[u] + a[v], q[u] * q[v]
    return taken, strength


@pytest.mark.parametrize(
    ("case", "dtype"),
    [
        pytest.param(case, dtype, id=f"{case.id}-{dtype}")
        for dtype in DTYPES
        for case in PATCHES
        if dtype == "float32" or case.wide
    ],
)
def test_patch_distance(backend, case, dtype):
    graph = cases.graph(case.graph)
    f, form = cases.function(graph, case.channels), case.form(graph)
    exact = oracle().get_weights(oracle().patch_distance(graph, f, form))
    rho = oracle().get_weights(oracle().patch_distance(graph, f, dataclasses.replace(form, scale=None)))
    if isinstance(graph, GridGraph):
        ndim, inside = graph.ndim, graph.edges.unit_half()
        spatial = inside if form.spatial is None else inside * form.spatial.reshape(-1, *(1,) * ndim)
    else:
        ndim = 1 if graph.grid is None else graph.grid.ndim
        spatial = np.ones(graph.n_edges) if form.spatial is None else form.spatial
    limit = bounds.Bounds(graph, cases.weights(case.graph), dtype)
    bound = limit.patch_distance(rho, form, spatial, case.channels, ndim, *at_both_ends(graph, form))

    weighted = backend.patch_distance(graph, f, form)
    actual = backend.get_weights(weighted)
    if form.cut:  # next to the cut either side is right
        uncut = oracle().get_weights(oracle().patch_distance(graph, f, dataclasses.replace(form, cut=0.0)))
        near = np.divide(uncut, spatial, out=np.zeros_like(uncut), where=spatial > 0)
        assert ((near < form.cut) & (near > 0)).any()
        bound = np.where(np.abs(uncut - form.cut * spatial) <= 2 * bound, uncut + bound, bound)
    assert_within(actual, exact, bound, "patch_distance")
    assert backend.get_weights(backend.patch_distance(graph, f, form)).tobytes() == actual.tobytes()
    if isinstance(graph, GridGraph):  # what leads out of the grid or the mask is 0, not just small
        assert not actual[inside == 0].any()
    # The weights must be where the other primitives look for them.
    degree = backend.get(graph, backend.degree(weighted))
    csr = graph.to_graph(exact) if isinstance(graph, GridGraph) else Graph(graph.indptr, graph.indices, exact)
    largest = np.bincount(csr.edge_rows(), minlength=graph.n_vertices).max(initial=0)
    allowed = largest * (bound.max(initial=0) + float(limit.gamma(largest)) * exact.max(initial=0))
    assert_within(degree[:, 0], csr.degree(), allowed, "degree")


def test_data_under_the_mask_do_not_spread(device):
    """Weights of vertices inside the mask do not depend on the values outside it when patches are single pixels."""
    grid = cases.graph("masked")
    f = cases.function(grid)
    changed = np.where(grid.mask.reshape(-1, 1), f, 99.0)
    backend = backends.get(device)
    form = PatchForm(np.ones(1), scale=1.0)
    plain, other = (backend.get_weights(backend.patch_distance(grid, x, form)) for x in (f, changed))
    assert plain.any()
    assert_array_equal(plain, other)


# The checks can fail

MUTATIONS = [
    ("jacobi_step", "total[c] += HOLD", "total[c] -= HOLD"),
    ("jacobi_step", "LOAD(g, AT(u, c, G)) + LOAD(g, AT(v, c, G))", "LOAD(g, AT(u, c, G)) + LOAD(g, AT(u, c, G))"),
    ("jacobi_step", "isinf(lam) || !(denominator > SMALLEST)", "!(denominator > SMALLEST)"),
    ("jacobi_step", "here[c] + theta *", "here[c] + (real)1.00001f * theta *"),
    ("gradient_norm", "sum[c] += eps2", "sum[c] += 0"),
    ("p_laplacian", "k < WINDOW; ++k) {", "k < WINDOW - 1; ++k) {"),
    ("degree", "used = (x) + LANES < width", "used = (x) + LANES < width - 1"),
    ("energy", "fidelity += d * d", "fidelity += d"),
]


@pytest.mark.parametrize(("primitive", "right", "wrong"), MUTATIONS)
def test_a_broken_kernel_is_noticed(monkeypatch, primitive, right, wrong):
    """On purpose: one wrong character in a kernel must break the comparison that passes without it."""
    if "opencl" in backends.absent():
        pytest.skip(backends.absent()["opencl"])
    backend = copy.copy(backends.get("opencl"))
    one = problem(cases.SETUPS[0], "float32")
    CHECKS[primitive](backend, one)
    source = kernels.opencl_source(primitive)
    assert source.count(right) == 1
    # a store of compiled kernels of its own, so that the broken one stays here
    backend._shared = dataclasses.replace(backend._shared, kernels={})
    monkeypatch.setattr(kernels, "opencl_source", lambda stem: source.replace(right, wrong))
    with pytest.raises(AssertionError, match="out of bounds"):
        CHECKS[primitive](backend, one)


FORM_MUTATIONS = [
    (test_functions_on_the_edges, "difference", "USED(DERIVED(d))", "USED(d)"),
    (test_functions_on_the_edges, "difference", "CLEAR_EDGES(out, M)\n", "\n"),
    (test_functions_on_the_edges, "adjoint", "OWN *", "PULL *"),
    (test_both_norms_and_processes, "euler_step", "lam * (data - here[c])", "lam * (data + here[c])"),
    (test_both_norms_and_processes, "jacobi_step", "raise(conductance[c], power)", "raise(conductance[c], -power)"),
    (test_both_norms_and_processes, "energy", "WHERE(PRESENT, raise", "WHERE(true, raise"),
]


@pytest.mark.parametrize(
    ("check", "primitive", "right", "wrong"), FORM_MUTATIONS, ids=[f"{m[1]}-{m[2]}" for m in FORM_MUTATIONS]
)
def test_a_broken_form_is_noticed(monkeypatch, check, primitive, right, wrong):
    """The same for the forms of gamma, the edge norm and the functions on the edges."""
    if "opencl" in backends.absent():
        pytest.skip(backends.absent()["opencl"])
    backend = copy.copy(backends.get("opencl"))
    original = kernels.opencl_source
    assert original(primitive).count(right) == 1
    backend._shared = dataclasses.replace(backend._shared, kernels={})

    def broken(stem):
        return original(stem).replace(right, wrong) if stem == primitive else original(stem)

    monkeypatch.setattr(kernels, "opencl_source", broken)
    with pytest.raises(AssertionError):
        check(backend, cases.Setup("grid"), "float32", False)


def test_an_output_left_unwritten_is_noticed():
    with pytest.raises(AssertionError, match="1 of 2 numbers are out of bounds"):
        assert_within([1.0, np.nan], [1.0, 1.0], np.inf, "a primitive")


def test_an_absent_backend_skips_or_fails():
    """The `device` fixture: narrowed by GPUREG_TEST_DEVICES, made strict by GPUREG_REQUIRE."""

    def verdicts(wanted=(), required=()):
        params = device_params(
            ["opencl:0", "opencl:1", "numpy"], {"warp": "not installed"}, list(wanted), list(required)
        )
        return [param.values[0] if isinstance(param.values[0], str) else param.values[0][:2] for param in params]

    assert verdicts() == ["opencl:0", "opencl:1", "numpy", ("skip", "warp")]
    assert verdicts(required=["warp"])[-1] == ("fail", "warp")
    assert verdicts(wanted=["numpy"]) == ["numpy"]
    assert verdicts(wanted=["opencl"]) == ["opencl:0", "opencl:1"]
    assert verdicts(wanted=["numpy", "warp:cuda:0"]) == ["numpy", ("fail", "warp:cuda:0")]
    assert verdicts(wanted=["numpy"], required=["warp"]) == ["numpy", ("fail", "warp")]
    assert verdicts(wanted=["numpy"], required=["opencl", "vulkan"]) == ["numpy", ("fail", "vulkan")]
