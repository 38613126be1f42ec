"""The process through its front door: what it reaches, why it stops, what it refuses."""

from __future__ import annotations

import functools
import gc
import math
import multiprocessing
import subprocess
import sys
import weakref

import numpy as np
import pytest
from cases import TOLERANCES, function, graph, irregular, rng, weights
from scipy import sparse
from scipy.sparse.linalg import spsolve

import gpureg as gr
from gpureg import backends
from gpureg.solvers import Jacobi


def run(f0, on, **settings):
    return gr.regularize(f0, on, **{"backend": "numpy", "dtype": np.float64, **settings})


@pytest.mark.parametrize("name", ["small grid", "small csr"])
def test_p2_reaches_the_sparse_solution(device: str, name: str) -> None:
    """(lam I + 2L) f = lam f0 (erratum E9), on every device, in float32."""
    made, f0 = graph(name), function(graph(name), 3)
    stored = made.to_graph(weights(name)) if isinstance(made, gr.GridGraph) else made
    W = stored.to_scipy()
    lam = 0.8
    A = lam * sparse.eye_array(len(f0)) + 2 * (sparse.diags_array(W.sum(axis=1)) - W)
    exact = spsolve(A.tocsc(), lam * f0)
    given = stored.weights if isinstance(made, gr.GridGraph) else None
    result = gr.regularize(f0, made, p=2, lam=lam, weights=given, max_iter=1000, tol=0, backend=device)
    # Rounding of one sweep (TOLERANCES), amplified by at most (lam + 2 deg)/lam as errors of sweeps add up.
    reach = (lam + 2 * stored.degree().max()) / lam
    assert np.abs(result.value - exact).max() <= TOLERANCES["float32"] * reach * np.abs(exact).max()


@pytest.mark.parametrize("gamma", ["sqrt", "combinatorial", "normalized", "degree"])
@pytest.mark.parametrize("p", [1.0, 2.0])
def test_gamma_minimises_the_energy_it_names(gamma: str, p: float) -> None:
    """The change of variable behind gamma against eq. 19 and 20 written with gamma(u, v) itself."""
    made = irregular(13, 40, isolated=5)
    f0, lam, eps = function(made, 2), 0.7, 0.05
    W = made.to_scipy().toarray().astype(np.float64)
    degree = W.sum(axis=1)
    inverse = np.divide(1, degree, out=np.zeros_like(degree), where=degree > 0)[:, None]
    G = np.sqrt({"sqrt": W, "combinatorial": W / 2, "normalized": W * inverse / 2, "degree": W * inverse}[gamma])

    def energy(f: np.ndarray) -> float:
        d = G.T[:, :, None] * f[None] - G[:, :, None] * f[:, None]  # gamma_vu f(v) - gamma_uv f(u)
        return ((d**2).sum(axis=(1, 2)) + eps**2) ** (p / 2) @ np.ones(len(f)) / p + lam / 2 * ((f - f0) ** 2).sum()

    result = run(f0, made, p=p, lam=lam, gamma=gamma, eps=eps, max_iter=20000, tol=1e-13)
    # With p = 2 the given eps only adds a constant to the energy.
    assert result.energy[-1] == pytest.approx(energy(result.value), rel=1e-12)
    step, slopes = 1e-6, np.empty(len(f0))
    for u in range(len(f0)):
        moved = np.zeros_like(f0)
        moved[u, 1] = step
        slopes[u] = (energy(result.value + moved) - energy(result.value - moved)) / (2 * step)
    # central differences: rounding of the energy (1e-16 * 10 / 1e-6), curvature step^2 / eps^2
    assert np.abs(slopes).max() < 1e-7


def test_the_data_is_not_written_over(device: str) -> None:
    """Sweeps alternate between two buffers; neither may be the data's (fidelity would be lost after two)."""
    made = graph("grid")
    f0 = function(made)
    kept = f0.copy()
    many = gr.regularize(f0, made, p=1, lam=1e9, max_iter=9, backend=device)
    assert np.array_equal(f0, kept)
    assert np.abs(many.value - f0).max() < 1e-5  # lam -> infinity leaves the data


SWEEPS = {"p": 0.7, "lam": 2.0, "eps": 0.05, "max_iter": 25, "weights": gr.weights.bilateral(2.0, 0.5)}


@functools.cache
def swept() -> gr.Result:
    return run(function(graph("grid"), 3), graph("grid"), **SWEEPS)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_devices_agree_after_many_sweeps(device: str, dtype: str) -> None:
    made, f0, oracle = graph("grid"), function(graph("grid"), 3), swept()
    try:
        result = gr.regularize(f0.astype(dtype), made, backend=device, dtype=dtype, **SWEEPS)
    except gr.BackendUnavailable:
        assert dtype == "float64"  # a device may lack it, and then says so
        return
    assert result.value.dtype == dtype
    assert np.abs(result.value - oracle.value).max() <= TOLERANCES[dtype] * np.abs(f0).max()
    assert result.energy == pytest.approx(oracle.energy, rel=10 * TOLERANCES[dtype])
    assert device in result.backend


def test_same_bits_twice(device: str) -> None:
    made, f0 = graph("masked"), function(graph("masked"), 3)
    settings = {"p": 1, "lam": 3, "max_iter": 12, "backend": device, "weights": gr.weights.patch(1, 0.5, sigma=0.1)}
    first, second = (gr.regularize(f0, made, **settings) for _ in range(2))
    assert first.value.tobytes() == second.value.tobytes()
    assert first.energy.tobytes() == second.energy.tobytes()


@pytest.mark.parametrize("p", [0.3, 1.0, 2.0, 3.0, 6.0])
def test_energy_falls_and_is_checked_where_it_says(p: float) -> None:
    made, f0 = graph("small grid"), function(graph("small grid"))
    result = run(f0, made, p=p, lam=0.5, max_iter=25, solver=Jacobi(check_every=4))
    assert result.checks.tolist() == [0, 4, 8, 12, 16, 20, 24, 25]
    assert len(result.energy) == len(result.checks)
    assert (np.diff(result.energy) <= 1e-12 * result.energy[0]).all()
    assert result.iterations == 25
    assert result.stop is gr.Stop.MAX_ITER
    assert result.gap is None


def test_uncoupled_channels_do_not_see_each_other() -> None:
    made, f0 = graph("small csr"), function(graph("small csr"), 3)
    settings = {"p": 1.0, "lam": 2.0, "eps": 0.01, "max_iter": 30}
    apart = run(f0, made, coupled=False, **settings).value
    alone = np.stack([run(f0[:, c], made, **settings).value for c in range(3)], axis=1)
    assert np.abs(apart - alone).max() < 1e-12
    assert np.abs(run(f0, made, **settings).value - alone).max() > 1e-3  # coupling makes a difference


def test_tolerance_stops() -> None:
    made, f0 = graph("small grid"), 255 * function(graph("small grid"))
    result = run(f0, made, lam=1, max_iter=10_000, tol=1e-6, solver=Jacobi(check_every=1))
    again = run(f0, made, lam=1, max_iter=result.iterations - 1)
    assert result.stop is gr.Stop.TOLERANCE
    assert result.iterations < 10_000
    # a share of the spread, which is at most twice the range
    assert np.abs(result.value - again.value).max() <= 1e-6 * 2 * np.ptp(f0)
    assert "tolerance" in str(result.stop)


def test_callback_sees_each_check_and_can_stop() -> None:
    made, f0 = graph("small csr"), function(graph("small csr"))
    seen = []

    def watch(check: gr.Check) -> bool:
        seen.append((check.iteration, check.energy, check.change, check.value()))
        return check.iteration >= 6

    result = run(f0, made, p=1, lam=1, max_iter=50, solver=Jacobi(check_every=3), callback=watch)
    assert result.stop is gr.Stop.CALLBACK
    assert [row[0] for row in seen] == [0, 3, 6]
    assert [row[1] for row in seen] == result.energy.tolist()
    assert seen[0][2] == math.inf
    assert np.array_equal(seen[0][3], f0)
    assert np.array_equal(seen[-1][3], result.value)


def test_interruption_keeps_the_last_whole_iterate(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    made, f0 = graph("grid"), function(graph("grid"))
    settings = {"p": 1, "lam": 1, "backend": device}
    done, step = [], Jacobi.advance

    def pressed(self, problem, state):
        if len(done) == 7:
            raise KeyboardInterrupt
        done.append(1)
        return step(self, problem, state)

    seven = gr.regularize(f0, made, max_iter=7, **settings).value
    monkeypatch.setattr(Jacobi, "advance", pressed)
    with pytest.raises(KeyboardInterrupt) as caught:
        gr.regularize(f0, made, max_iter=100, **settings)
    assert isinstance(caught.value, gr.Interrupted)
    assert caught.value.result.iterations == 7
    assert caught.value.result.stop is gr.Stop.INTERRUPTED
    assert np.array_equal(caught.value.result.value, seven)


def test_progress_writes_nothing_to_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    run(function(graph("small grid")), graph("small grid"), max_iter=30, progress=True)
    assert capsys.readouterr().out == ""


def test_start_and_shapes() -> None:
    grid = graph("small volume")
    f0 = function(grid, 3)
    flat = run(f0, grid, p=1, lam=1, max_iter=5)
    shaped = run(f0.reshape(*grid.shape, 3), grid, p=1, lam=1, max_iter=5)
    assert shaped.value.shape == (*grid.shape, 3)
    assert np.array_equal(shaped.value.reshape(-1, 3), flat.value)
    scalar = run(f0[:, 0].reshape(grid.shape), grid, max_iter=2)
    assert scalar.value.shape == grid.shape
    assert np.array_equal(scalar.value.ravel(), run(f0[:, 0], grid, max_iter=2).value)
    # five sweeps, then five from there, are ten
    ten = run(f0, grid, p=1, lam=1, max_iter=10)
    assert np.array_equal(run(f0, grid, p=1, lam=1, max_iter=5, initial=flat.value).value, ten.value)
    assert np.array_equal(run(f0, grid, max_iter=0).value, f0)


def test_integers_are_data_too() -> None:
    made = graph("small csr")
    f0 = rng(5).integers(0, 255, made.n_vertices)
    assert np.array_equal(run(f0, made).value, run(f0.astype(float), made).value)


@pytest.mark.parametrize("p", [0.5, 1.0, 2.0, 3.0])
def test_lam_per_vertex_pins_and_frees(device: str, p: float) -> None:
    """lam = infinity keeps the data to the bit; lam = 0 there ignores it."""
    grid = graph("small grid")
    f0 = function(grid).astype(np.float32)
    lam = np.full(grid.n_vertices, np.inf)
    lam[5:20] = 0
    wild = f0.copy()
    wild[5:20] = 99.0
    settings = {"p": p, "lam": lam, "eps": 0.01, "backend": device}
    result = gr.regularize(f0, grid, max_iter=50, **settings)
    assert np.array_equal(result.value[lam == np.inf], f0[lam == np.inf])
    # Dirichlet's problem: without data inside, the answer lies between the values given around it.
    free = gr.regularize(f0, grid, max_iter=50, initial=wild, **{**settings, "lam": lam})
    again = gr.regularize(wild, grid, max_iter=50, initial=wild, **settings)
    assert np.array_equal(free.value, again.value)


def test_lam_of_zero_leaves_a_lone_vertex_as_it_is(device: str) -> None:
    made = graph("csr")
    f0 = function(made).astype(np.float32)
    result = gr.regularize(f0, made, p=1, lam=0, max_iter=11, backend=device)
    assert np.isfinite(result.value).all()
    assert result.value[311] == f0[311]


def test_weights_that_underflow_leave_the_data(device: str) -> None:
    grid = graph("small grid")
    f0 = (1e3 * function(grid)).astype(np.float32)
    f0[:] = np.arange(len(f0))[:, None] * 100.0
    result = gr.regularize(f0, grid, p=1, lam=0, max_iter=3, backend=device, weights=gr.weights.patch(0, 0.1))
    assert np.array_equal(result.value, f0)


def test_eps_is_chosen_from_the_middle_of_the_values_and_told() -> None:
    made, f0 = graph("small csr"), function(graph("small csr"))
    low, high = np.quantile(f0, [0.05, 0.95])
    found = run(f0, made, p=1, max_iter=1).eps
    # rounded to 4 bits: by a sixteenth at most; a quantile between two values is interpolated here
    assert found == pytest.approx(2e-3 * (high - low), rel=0.07)
    assert run(256 * f0 + 2.0**20, made, p=1, max_iter=1).eps == 256 * found
    hot = f0.copy()
    hot[3] = 1e6
    assert run(hot, made, p=1, max_iter=1).eps == pytest.approx(found, rel=0.08)
    assert run(np.full(len(f0), 5.0), made, p=1, max_iter=1).eps > 0  # a constant has no range
    assert run(f0, made, p=1, eps=0.25, max_iter=1).eps == 0.25
    assert run(f0, made, p=2, max_iter=1).eps == 0


def test_mask_leaves_vertices_out() -> None:
    grid = graph("small masked")
    assert isinstance(grid, gr.GridGraph)
    f0 = function(grid).reshape(grid.shape)
    outside = ~grid.mask
    marked = np.where(outside, np.nan, f0)
    result = run(marked, grid, p=1, lam=1, max_iter=20)
    assert np.isnan(result.value[outside]).all()
    other = run(np.where(outside, 77.0, f0), grid, p=1, lam=1, max_iter=20, eps=result.eps)
    assert np.array_equal(result.value[grid.mask], other.value[grid.mask])
    assert (other.value[outside] == 77.0).all()


@pytest.mark.parametrize(
    "make", [lambda: gr.GridGraph((9, 8), 2), lambda: gr.GridGraph((9, 8), 2).to_graph()], ids=["grid", "stored"]
)
def test_graphs_are_released(device: str, make) -> None:
    """Devices keep what they made of a graph for as long as the graph lives, and no longer."""
    made = make()
    gone = weakref.ref(made)
    gr.regularize(np.arange(72.0), made, p=1, max_iter=2, backend=device, weights=gr.weights.patch(0, 9.0))
    del made
    gc.collect()
    assert gone() is None


def test_values_outside_the_mask_decide_nothing() -> None:
    image = 1000 + rng(7).random((16, 17))
    mask = np.ones(image.shape, bool)
    mask[:4] = False
    grid = gr.GridGraph(image.shape, 1, "cityblock", mask=mask)
    results = [run(np.where(mask, image, out), grid, p=1, lam=2, tol=1e-4) for out in (-9999.0, 0.0, np.nan, 1000.5)]
    assert [result.eps for result in results] == pytest.approx([1.8e-3] * 4, rel=0.1)
    assert [result.iterations for result in results] == [results[0].iterations] * 4
    assert np.array_equal([result.value[mask] for result in results], [results[0].value[mask]] * 4)


@pytest.mark.parametrize("gamma", ["combinatorial", "normalized", "degree"])
def test_tolerance_is_in_the_units_of_the_data(gamma: str) -> None:
    """The device iterates on s f for these gammas; tol and Check.change speak of f."""
    grid, f0 = gr.GridGraph((16, 16), 4), rng(9).random((16, 16))
    last = []
    settings = {"gamma": gamma, "lam": 0.01, "solver": Jacobi(check_every=1)}
    result = run(f0, grid, tol=1e-3, callback=lambda check: last.append(check.change), max_iter=500, **settings)
    before = run(f0, grid, max_iter=result.iterations - 1, **settings)
    change = np.abs(result.value - before.value).max()
    assert last[-1] == pytest.approx(change, rel=1e-9)
    assert change <= 1e-3 * 2 * np.ptp(f0)


@pytest.mark.parametrize("h", [1.0, 0.99, 0.98, 0.97, 0.9])
def test_weights_near_underflow_give_no_garbage(device: str, h: float) -> None:
    """A quotient of denormal numbers has few digits: the result stays in the hull of the data or is the data."""
    f = np.linspace(0.31, 0.39, 40)
    f[20] = 10.37
    settings = {"weights": gr.weights.patch(0, h), "backend": device}
    value = gr.regularize(f, gr.GridGraph(40, 3), lam=0, max_iter=1, **settings).value[20]
    assert 0.34 <= value <= 0.36 or value == np.float32(10.37)


@pytest.mark.parametrize(
    "extreme", [gr.weights.patch(0, 1e-200), gr.weights.patch(0, 1e-25), gr.weights.bilateral(np.inf, 1e-200)], ids=repr
)
def test_extreme_parameters_of_weights(device: str, extreme) -> None:
    """1/h^2 beyond the type's range: equal values still have weight 1, others 0, on every device."""
    f0 = np.array([1.0, 1.0, 2.0, 2.0, 3.0])
    result = gr.regularize(f0, gr.GridGraph(5), lam=0, max_iter=1, weights=extreme, backend=device)
    assert np.array_equal(result.value, f0)


def test_a_check_is_read_inside_the_callback() -> None:
    checks = []
    run(np.arange(9.0), gr.GridGraph(9), max_iter=20, callback=lambda check: checks.append(check))
    assert np.isfinite(checks[-1].value()).all()  # nothing came after it
    with pytest.raises(RuntimeError, match="inside the callback"):
        checks[0].value()


def test_forked_process_gets_a_sentence() -> None:
    """OpenCL's threads do not survive a fork: a wait in the child would never end."""
    if "fork" not in multiprocessing.get_all_start_methods() or "opencl" in backends.absent():
        pytest.skip("needs fork and OpenCL")
    gr.regularize(np.arange(9.0), gr.GridGraph(9), max_iter=1, backend="opencl")
    script = (
        "import multiprocessing, numpy as np, gpureg as gr\n"
        "job = lambda *_: gr.regularize(np.arange(9.0), gr.GridGraph(9), backend='opencl')\n"
        "job()\n"
        "def child(q):\n"
        "    try: job(); q.put('no error')\n"
        "    except gr.BackendUnavailable as error: q.put(str(error))\n"
        "context = multiprocessing.get_context('fork')\n"
        "q = context.Queue()\n"
        "context.Process(target=child, args=(q,), daemon=True).start()\n"
        "print(q.get(timeout=60))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=True)
    assert "does not survive a fork" in done.stdout


def test_values_out_of_range_of_the_type_are_an_error() -> None:
    # the scale of all values is taken out, but not that of one among many
    f0 = np.linspace(0, 1, 20)
    f0[7] = 3e38
    with np.errstate(over="ignore", invalid="ignore"), pytest.raises(FloatingPointError, match="not finite"):
        gr.regularize(f0, gr.GridGraph(20), p=1, lam=1, backend="numpy", dtype=np.float32)
