"""Tiles are done in halves where memory runs out, and by several devices at a time, with the same bits."""

from __future__ import annotations

import threading
import warnings
import weakref
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from cases import rng

import gpureg as gr
from gpureg import backends
from gpureg.backends import Device, dispatch, failures
from gpureg.model.memory import Budget, Need, budget_of
from gpureg.regularization import sharing
from gpureg.regularization.tiling import Tile, Tiling, cut

SHAPE = (67, 53)
GRID = gr.GridGraph(SHAPE)
BILATERAL = gr.weights.bilateral(2.0, 0.4)
F0 = rng(3).random((*SHAPE, 1), dtype=np.float32)
# OpenCL on a CPU has steps for parts that begin at multiples of 32 rows alone
IMAGE = rng(5).random((260, 20), dtype=np.float32)

JOBS: dict[str, Callable[..., np.ndarray]] = {
    "sweeps": lambda **run: gr.regularize(F0, GRID, p=1, lam=0.5, weights=BILATERAL, max_iter=5, **run).value,
    "until a tolerance": lambda **run: gr.regularize(F0, GRID, p=1, lam=3.0, max_iter=60, tol=2e-2, **run).value,
    "one step": lambda **run: gr.denoise_nl_means(IMAGE, h=0.4, radius=2, patch_radius=1, **run),
}


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch):
    """Let a device have memory for functions on so many vertices only; the sizes that were refused."""

    def limited(device: str, vertices: int) -> list[int]:
        backend, refused = backends.get(device), []

        def checked(make):
            def call(graph, *args, **options):
                if graph.n_vertices > vertices:
                    refused.append(graph.n_vertices)
                    raise failures.out_of_memory("it", "no room")
                return make(graph, *args, **options)

            return call

        for name in ("put", "put_cells"):
            monkeypatch.setattr(backend, name, checked(getattr(backend, name)))
        return refused

    return limited


@pytest.mark.one_driver
@pytest.mark.parametrize("job", JOBS)
def test_tiles_are_halved_where_memory_runs_out(device: str, job: str, room) -> None:
    whole = JOBS[job](backend=device)
    cells = IMAGE.size if job == "one step" else GRID.n_vertices
    refused = room(device, int(0.7 * cells))
    with pytest.warns(UserWarning, match=r"memory of .* ran out: .* in halves, \d time\(s\)"):
        found = JOBS[job](backend=device)
    assert refused and refused[0] == cells
    assert sorted(set(refused), reverse=True) == refused, "a size that was refused is not tried again"
    assert found.tobytes() == whole.tobytes()


def test_the_result_says_that_memory_ran_out(room) -> None:
    room("numpy", 1500)
    with pytest.warns(UserWarning, match="memory=... or GPUREG_MEMORY"):
        result = gr.regularize(F0, GRID, p=2, max_iter=4, backend="numpy")
    assert "as the memory of numpy ran out." in result.method


def test_a_job_without_tiles_says_what_it_needs(room) -> None:
    room("numpy", 100)
    with pytest.raises(
        MemoryError, match=r"needs .* on numpy, .* GiB are free now \(.*no room\).*cut into tiles: the step"
    ):
        gr.regularize(F0, GRID, solver="euler", backend="numpy")
    with pytest.raises(MemoryError, match=r"needs .* on numpy for a part of .* cells, .* are free \(.*no room\)"):
        gr.regularize(F0, GRID, max_iter=4, backend="numpy")


def test_buffers_are_free_before_the_next_try(monkeypatch: pytest.MonkeyPatch) -> None:
    """A driver with a fixed number of bytes: the halves fit only if all buffers of the first try are gone."""
    pytest.importorskip("pyopencl", reason="OpenCL is not installed")
    from gpureg.backends.opencl import buffers

    if "opencl" in backends.absent():
        pytest.skip("no OpenCL device")
    cl, backend = buffers.cl, backends.get("opencl")
    live = {"bytes": 0, "most": 0}
    limit = 0

    class Counted(cl.Buffer):
        def __init__(self, context, flags, size):
            if limit and live["bytes"] + size > limit:
                raise cl.MemoryError(cl._cl._ErrorRecord(msg="", code=-4, routine="clCreateBuffer"))
            super().__init__(context, flags, size)
            live["bytes"] += size
            live["most"] = max(live["most"], live["bytes"])
            weakref.finalize(self, lambda: live.update(bytes=live["bytes"] - size))

    # buffers of a CPU above some size are made otherwise
    monkeypatch.setattr(buffers, "cl", SimpleNamespace(**{**vars(cl), "Buffer": Counted}))
    backend.release()
    whole = JOBS["sweeps"](backend=backend.device.id)
    limit = int(0.7 * live["most"])
    with pytest.warns(UserWarning, match="ran out"):
        halved = JOBS["sweeps"](backend=backend.device.id)
    assert halved.tobytes() == whole.tobytes()
    assert 0 < live["most"]
    limit = 2000
    with pytest.raises(MemoryError, match=r"the memory of .* has run out \(clCreateBuffer failed: MEM_OBJECT"):
        gr.operators.laplacian(F0, GRID, backend=backend.device.id)


def test_warp_without_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("warp", reason="Warp is not installed")
    from gpureg.backends.warp import memory

    def full(*args, **given):
        raise RuntimeError("Failed to allocate 8 bytes on device 'cpu'")

    monkeypatch.setattr(memory.wp, "zeros", full)
    with pytest.raises(MemoryError, match=r"the memory of cpu has run out \(Failed to allocate 8 bytes"):
        gr.operators.laplacian(F0, GRID, backend="warp:cpu")


@pytest.mark.parametrize("job", JOBS)
@pytest.mark.parametrize("times", [2, 3])
def test_a_device_several_times(times: int, job: str) -> None:
    whole = JOBS[job](backend="numpy")
    assert JOBS[job](backend=["numpy"] * times).tobytes() == whole.tobytes()


def opencl_cpus() -> list[str]:
    return [one.id for one in backends.devices() if one.backend == "opencl" and one.kind == "cpu"]


@pytest.mark.parametrize("other", [0, 1], ids=["the same driver twice", "two drivers"])
def test_opencl_drivers_share_a_job(other: int) -> None:
    """PoCL 3.0 computes packs of 8 and 3.1 of 16: a sweep has the same bits, as no sum crosses vertices."""
    names = opencl_cpus()
    if len(names) <= other:
        pytest.skip("no such driver")
    pair = [names[0], names[other]]
    call = {"p": 1, "lam": 0.5, "weights": BILATERAL, "max_iter": 5}
    whole = gr.regularize(F0, GRID, backend=names[0], **call)
    shared = gr.regularize(F0, GRID, backend=pair, **call)
    assert shared.value.tobytes() == whole.value.tobytes()
    assert "tiles" in shared.method
    assert ("may round differently" in shared.backend) == bool(other)
    assert shared.backend.startswith("2 times opencl" if not other else names[0])


def tiles(count: int) -> Tiling:
    return Tiling(1, cut((8 * count,), (8,), (1,), (1,)), (8 * count,), (1,), (1,))


NEED = Need(1000, 1000)


def test_devices_take_from_one_queue() -> None:
    """Two threads meet in their first tiles; all tiles are done once, whichever device is faster."""
    one = backends.get("numpy")
    both, seen = threading.Barrier(2, timeout=20), []

    def work(device: backends.Backend, tile: Tile) -> int:
        if len(seen) < 2:
            seen.append(threading.get_ident())
            both.wait()
        return int(tile.own[0].start)

    told: list[tuple[int, int]] = []
    shared: sharing.Shared[int] = sharing.Shared([one, one], tiles(7), lambda tile: NEED)
    assert sorted(shared.run(work, lambda *now: told.append(now))) == list(range(0, 56, 8))
    assert len(set(seen)) == 2 and threading.get_ident() not in seen
    assert [done for done, _ in told] == list(range(1, 8))
    assert told[-1] == (7, 7)


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_an_error_of_one_device_ends_the_job(error: type[BaseException]) -> None:
    done = []

    def work(device: backends.Backend, tile: Tile) -> None:
        done.append(tile)
        raise error("this one")

    one = backends.get("numpy")
    with pytest.raises(error, match="this one"):
        sharing.Shared([one, one], tiles(9), lambda tile: NEED).run(work)
    assert len(done) <= 2


def test_halves_of_a_tile() -> None:
    tiling = Tiling.whole((100, 40), (4, 4), (8, 1))
    [tile] = tiling.tiles
    upper, lower = tiling.halves(tile)
    assert (upper.own[0], lower.own[0]) == (slice(0, 50), slice(50, 100))
    # with its halo a tile begins at a multiple of 8 rows
    assert (upper.wide[0], lower.wide[0]) == (slice(0, 54), slice(40, 100))
    assert tiling.halves(Tile((slice(52, 56), slice(18, 22)), (slice(48, 60), slice(14, 26)))) == ()
    wide = Tiling.whole((10, 400), (4, 4), (1, 1))
    assert [half.own[1] for half in wide.halves(wide.tiles[0])] == [slice(0, 200), slice(200, 400)]


def test_a_job_too_small_to_share() -> None:
    """Where halos cost all the gain one device does the work, and the result says so."""
    small = gr.regularize(F0[:9, :9], gr.GridGraph((9, 9)), p=1, max_iter=50, backend=["numpy", "numpy"])
    assert "tiles" not in small.method
    assert small.backend == repr(backends.get("numpy"))
    assert sharing.shares(2, NEED, Budget(1000, 1000, False), lambda within: tiles(4)) is not None

    def refuse(within: Budget) -> Tiling:
        raise MemoryError

    assert sharing.shares(2, NEED, Budget(1000, 1000, False), refuse) is None


def test_a_budget_is_that_of_the_least_device() -> None:
    one = backends.get("numpy")
    alone = budget_of([one], None)
    assert budget_of([one, one], None).total == alone.total // 2
    assert budget_of([one, one], 1000) == Budget(500, 500, True)


def test_names_of_several_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    def gpu(i: int, tier: int, shared: bool, float64: bool = True) -> Device:
        return Device("opencl", f"opencl:{i}", f"GPU {i}", "1", "gpu", 0, 1, float64, (tier, shared, -i))

    found = [gpu(0, 1, True), gpu(1, 1, False), gpu(2, 1, False), gpu(3, 1, False, float64=False), gpu(4, 2, False)]

    numpy = backends.get("numpy").device

    def probe(name: str) -> dispatch._Probe:
        mine = {"opencl": tuple(found), "numpy": (numpy,)}.get(name, ())
        return dispatch._Probe(mine, None if mine else "absent")

    monkeypatch.setattr(dispatch, "_probe", probe)
    monkeypatch.setattr(dispatch, "_make", lambda device, dtype: SimpleNamespace(device=device, dtype=np.dtype(dtype)))

    def named(names: backends.Chosen, dtype: type = np.float32) -> list[str]:
        return [one.device.id for one in backends.several(names, dtype)]

    assert named("all") == ["opencl:3", "opencl:2", "opencl:1"]
    assert named("all", np.float64) == ["opencl:2", "opencl:1"]
    assert named(["opencl:0", "numpy", "opencl:0"]) == ["opencl:0", "numpy", "opencl:0"]
    assert named("opencl:0, numpy") == ["opencl:0", "numpy"]
    assert backends.get("all").device.id == backends.get(["opencl:3", "numpy"]).device.id == "opencl:3"
    del found[:4]
    found.append(gpu(0, 2, False))
    found[:] = [Device(**{**vars(one), "kind": "cpu"}) for one in found]
    assert named("all") == ["opencl:4"], "the drivers of one CPU"
    monkeypatch.setenv("GPUREG_BACKEND", "numpy")
    assert named("all") == ["numpy"]
    monkeypatch.setenv("GPUREG_BACKEND", "numpy,numpy")
    assert named("auto") == ["numpy", "numpy"]
    for wrong in ([], 3, ["numpy", 1], None):
        with pytest.raises(TypeError, match="backend must be a name, or a list of names"):
            backends.several(wrong)


def test_a_shared_job_is_quiet() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        JOBS["one step"](backend=["numpy", "numpy"])
