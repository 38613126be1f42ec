"""The solvers beside peers: total variation to a tolerance, the linear systems of p = 2, accelerated sweeps."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

import gpureg as gr

from .filters import CHAMBOLLE, missing
from .model import EXTRA, HOST, NEEDS_DATA, SEED, Bar, Case, Entry, Image, Setup, data, peer, skipped

JACOBI, SCIPY, PYAMG = "gpureg Jacobi", "scipy cg", "pyamg"
# kappa of G_0: the gradient norm of both ends is that of forward differences times the square root of 2
KAPPA = math.sqrt(2)
# steps of a peer's solver, looked through for the first that is near enough
_STEPS = 10_000


def forward_tv(u: Image, f0: Image, weight: float) -> float:
    """What scikit-image's Chambolle minimises: TV of forward differences + |u - f0|^2 / (2 weight)."""
    down = np.diff(u, axis=0, append=u[-1:]).astype(np.float64)
    right = np.diff(u, axis=1, append=u[:, -1:]).astype(np.float64)
    return float(np.sqrt(down**2 + right**2).sum() + ((u - f0).astype(np.float64) ** 2).sum() / (2 * weight))


def chambolle_steps(chambolle: Any, f0: Image, weight: float, share: float, most: int) -> int:
    """Iterations after which the functional is within `share` of its minimum."""
    least = forward_tv(chambolle(f0.astype(np.float64), weight=weight, eps=0, max_num_iter=most), f0, weight)
    low, high = 1, most
    while high - low > 1:
        middle = (low + high) // 2
        value = forward_tv(chambolle(f0, weight=weight, eps=0, max_num_iter=middle), f0, weight)
        low, high = (low, middle) if value <= (1 + share) * least else (middle, high)
    return high


def total_variation(setup: Setup) -> Iterator[Case]:
    """Total variation to a certified gap beside Chambolle's projection to the same excess of its own functional."""
    side, most = setup.pick((512, 5000), (128, 2000), (37, 300))
    lam = 28.0
    _, noisy, name = setup.noisy(side)
    f0 = noisy / 255
    grid = gr.GridGraph(f0.shape, 1, "cityblock")
    restoration = peer("skimage.restoration")
    for share in (1e-3, 1e-4):
        entries = [missing(CHAMBOLLE)]
        if restoration is not None:
            chambolle, weight = restoration.denoise_tv_chambolle, KAPPA / lam
            steps = chambolle_steps(chambolle, f0, weight, share, most)
            run = functools.partial(chambolle, f0, weight=weight, eps=0, max_num_iter=steps)
            entries = [Entry(CHAMBOLLE, run, is_peer=True, note=f"{steps} iterations, one thread")]
        for device in setup.devices:
            solve = functools.partial(
                gr.regularize, f0, grid, p=1, lam=lam, solver=gr.Certified(tol=share), backend=device
            )

            def check(solve: Any = solve, share: float = share) -> tuple[bool, str]:
                result = solve()
                reached = result.gap / result.energy[-1]
                return bool(reached <= share), f"gap {reached:.1e} of the energy after {result.iterations} iterations"

            entries.append(Entry(device, solve, lambda: None, check, HOST))
        yield Case(
            "certified-tv",
            f"p = 1, eps = 0 on G_0, {side}x{side}, lam = {lam:g}, to a share of the energy",
            entries,
            [
                f"picture: {name}, noise of standard deviation 20 of 255, values of 0..1",
                "Chambolle stops where the excess of its own functional over its minimum, found by "
                f"{most} iterations, is as large; ours where the gap, which it knows, is",
            ],
            [Bar(CHAMBOLLE, 1.0, "opencl")],
            f"to {share:g}",
            grid.n_vertices,
        )


def _matrix(graph: Any, lam: float) -> Any:
    """The matrix lam I + 2 L of the vertex norm, as scipy has it."""
    from scipy import sparse

    stored = graph.to_graph() if isinstance(graph, gr.GridGraph) else graph
    A = stored.to_scipy().astype(np.float64)
    degree = np.asarray(A.sum(axis=1)).ravel()
    return (sparse.diags_array(lam + 2 * degree) - 2 * A).tocsr()


def linear(setup: Setup) -> Iterator[Case]:
    """Small lam at p = 2: a grid whose eigenvectors are cosines, one with other edges, the bunny's positions."""
    side = setup.pick(1024, 128, 24)
    _, noisy, name = setup.noisy(side)
    problems: list[tuple[str, Any, Image]] = [
        (f"G_0, {side}x{side}", gr.GridGraph((side, side), 1, "cityblock"), noisy.reshape(-1, 1) / 255),
        (f"8 neighbours, {side}x{side}", gr.GridGraph((side, side)), noisy.reshape(-1, 1) / 255),
    ]
    bunny = data("meshes", "stanford_bunny.ply")
    trimesh = peer("trimesh")
    if setup.size != "tiny" and bunny is not None and trimesh is not None:
        mesh = trimesh.load(bunny, process=False)
        edge = float(mesh.edges_unique_length.mean())
        noise = np.random.default_rng(SEED).standard_normal(mesh.vertices.shape)
        positions = np.asarray(mesh.vertices) / edge + 0.2 * noise
        graph = gr.Graph.from_edges(mesh.edges_unique, n_vertices=len(mesh.vertices))
        problems.append((f"bunny, {len(positions)} vertices", graph, positions))
    elif setup.size != "tiny":
        yield Case("certified-linear", "bunny", [skipped(JACOBI, NEEDS_DATA if bunny is None else EXTRA)])
    for label, graph, f0 in problems:
        yield _linear(setup, label, graph, f0, name)


def _linear(setup: Setup, label: str, graph: Any, f0: Image, name: str) -> Case:
    lam, share, device = 0.001, 1e-4, setup.devices[0]
    exact = gr.regularize(f0, graph, p=2, lam=lam, solver=gr.Certified(tol=1e-9), backend=device, dtype=np.float64)
    least = exact.lower_bound
    assert least is not None
    solve = functools.partial(gr.regularize, f0, graph, p=2, lam=lam)
    timed, sweeps = setup.pick((300, 100_000), (200, 3000), (50, 500))
    needed = _sweeps(functools.partial(solve, backend=device), least, share, sweeps)
    entries = []
    run = functools.partial(solve, solver=gr.Jacobi(damping=1, check_every=timed), max_iter=timed, backend=device)
    note = f"{needed} sweeps, of which {timed} are timed" + (", not there yet" if needed == sweeps else "")
    entries.append(Entry(f"{JACOBI} on {device}", run, is_peer=True, times=needed / timed, note=note))
    for one in setup.best_of_each():
        for method in ("auto", "linear", "newton") if one == device else ("auto",):
            run = functools.partial(solve, solver=gr.Certified(tol=share, method=method), backend=one)

            def check(run: Any = run, method: str = method) -> tuple[bool, str]:
                result = run()
                off = float(np.abs(result.value - exact.value).max())
                said = f"gap {result.gap / result.energy[-1]:.1e} after {result.iterations}, {off:.1e} off at most"
                return bool(result.gap <= share * result.energy[-1]), f"{method}: {said}"

            entries.append(Entry(one if method == "auto" else f"{one} by {method}", run, lambda: None, check, HOST))
    entries += _peers(_System(_matrix(graph, lam), lam * f0.astype(np.float64), f0, exact.value, share * least))
    return Case(
        "certified-linear",
        f"p = 2, lam = {lam:g}, to a gap of {share:g} of the energy",
        entries,
        [
            f"{JACOBI}: the sweeps after which the energy is as near to its minimum",
            "scipy and pyamg: float64, one thread, the matrix is there; they take the steps that bring the energy as "
            "near to its minimum, found beforehand, and know of no gap",
        ],
        [Bar(f"{JACOBI} on {device}", 0.1)],
        label,
        graph.n_vertices,
    )


def _sweeps(solve: Any, least: float, share: float, most: int) -> int:
    """Plain Jacobi sweeps to this share of the minimum."""

    def near(check: gr.Check) -> bool:
        return check.energy - least <= share * check.energy

    # energies in float64, whose differences say something
    return int(
        solve(solver=gr.Jacobi(damping=1, check_every=250), max_iter=most, callback=near, dtype=np.float64).iterations
    )


@dataclass(frozen=True)
class _System:
    """A f = b for every channel, its solution, and how far above the minimum the energy may stay."""

    A: Any
    b: Image
    f0: Image
    exact: Image
    excess: float

    def fewest(self, solve: Callable[..., Any]) -> int:
        """Steps of solve(channel, callback) after which the energies of all channels are near enough, in sum."""
        left = np.zeros(_STEPS)
        for c in range(self.b.shape[1]):
            seen: list[float] = []

            def note(f: Image, c: int = c, seen: list[float] = seen) -> None:
                e = np.ravel(f) - self.exact[:, c]
                seen.append(float(e @ (self.A @ e)) / 2)

            solve(c, note)
            left += np.pad(seen, (0, _STEPS - len(seen)), mode="edge")
        return int(np.flatnonzero(left <= self.excess)[0]) + 1


def _peers(system: _System) -> list[Entry]:
    """Conjugate gradients by scipy and multigrid by pyamg, every channel by itself."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.linalg import cg

    A, b, start, channels = system.A, system.b, system.f0.astype(np.float64), range(system.b.shape[1])

    def by_cg(c: int, callback: Any = None, rtol: float = 1e-4, most: int = _STEPS) -> Image:
        found: Image = cg(A, b[:, c], x0=start[:, c], rtol=rtol, maxiter=most, callback=callback)[0]
        return found

    steps = system.fewest(by_cg)
    entries = [
        Entry(
            SCIPY,
            lambda: [by_cg(c, None, 0.0, steps) for c in channels],
            is_peer=True,
            note=f"{steps} steps a channel",
        )
    ]
    pyamg = peer("pyamg")
    if pyamg is None:
        return [*entries, missing(PYAMG)]

    def by_cycles(levels: Any, c: int, callback: Any = None, tol: float = 1e-6, most: int = _STEPS) -> Image:
        found: Image = levels.solve(b[:, c], x0=start[:, c], tol=tol, maxiter=most, accel="cg", callback=callback)
        return found

    def setup() -> Any:
        return pyamg.ruge_stuben_solver(csr_matrix(A))

    cycles = system.fewest(functools.partial(by_cycles, setup()))

    def multigrid() -> list[Image]:
        levels = setup()
        return [by_cycles(levels, c, None, 1e-300, cycles) for c in channels]

    return [*entries, Entry(PYAMG, multigrid, is_peer=True, note=f"its setup, {cycles} cycles a channel")]


def acceleration(setup: Setup) -> Iterator[Case]:
    """Accelerated sweeps beside plain ones, to a distance from the minimiser: total variation with eps = 1e-3."""
    side = setup.pick(128, 64, 40)
    clean, name = setup.picture(512)
    part = clean[200 : 200 + side, 180 : 180 + side].astype(np.float64) / 255
    f0 = part + 0.1 * np.random.default_rng(SEED).standard_normal(part.shape)
    # the graph, the fidelity that takes the noise away, and how many times fewer iterations are expected
    for label, grid, lam, expected in (
        ("4 neighbours", gr.GridGraph(f0.shape, 1, "cityblock"), 14.0, 5),
        ("24 neighbours", gr.GridGraph(f0.shape, 2), 60.0, 2),
    ):
        yield _acceleration(setup, f"{label}, lam = {lam:g}, {side}x{side}", grid, f0, lam, expected, name)


def _acceleration(
    setup: Setup, label: str, grid: gr.GridGraph, f0: Image, lam: float, expected: int, name: str
) -> Case:
    share, most = 1e-4, 20_000
    model: dict[str, Any] = {"p": 1, "lam": lam, "eps": 1e-3}
    exact = gr.regularize(
        f0, grid, solver=gr.Certified(tol=1e-11), backend=setup.devices[0], dtype=np.float64, **model
    ).value
    distance = share * float(np.linalg.norm(f0 - exact))
    entries = []
    for device in setup.best_of_each():
        solve = functools.partial(gr.regularize, f0, grid, backend=device, **model)

        def near(check: gr.Check) -> bool:
            return bool(np.linalg.norm(check.value() - exact.reshape(-1, 1)) <= distance)

        counts = [
            solve(solver=gr.Jacobi(accelerate=accelerate, check_every=4), max_iter=most, callback=near).iterations
            for accelerate in (False, True)
        ]
        for accelerate, sweeps in zip((False, True), counts, strict=True):
            settings = gr.Jacobi(accelerate=accelerate, check_every=sweeps)
            run = functools.partial(solve, solver=settings, max_iter=sweeps)
            if not accelerate:
                entries.append(Entry(f"plain on {device}", run, is_peer=True, note=f"{sweeps} sweeps"))
                continue

            def check(solve: Any = solve, counts: list[int] = counts) -> tuple[bool, str]:
                result = solve(solver=gr.Jacobi(accelerate=True, check_every=1), max_iter=counts[1])
                # an energy is rounded, and so is the sum
                rise = float((np.diff(result.energy) / result.energy[1:]).max())
                fewer = counts[0] / counts[1]
                said = (
                    f"{counts[1]} iterations, {fewer:.1f} times fewer; the energy rises by {max(rise, 0):.1e} at most"
                )
                return rise <= 8 * float(np.finfo(np.float32).eps) and fewer >= expected, said

            entries.append(Entry(device, run, lambda: None, check, HOST))
    return Case(
        "accelerated-sweeps",
        f"p = 1, eps = 1e-3, to {share:g} of the way from the data to the minimiser",
        entries,
        [
            f"picture: a part of {name}, noise of standard deviation 0.1 on values of 0..1",
            f"a row is wrong if it needs more than 1/{expected} of the plain iterations, or if the energy rises",
        ],
        label=label,
        vertices=grid.n_vertices,
    )
