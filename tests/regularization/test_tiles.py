"""Memory as a budget: what a job needs is known before, and in tiles its result is that of the whole, to the bit."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
import pytest
from cases import function, graph, irregular, rng

import gpureg as gr
from gpureg import backends
from gpureg.backends import PatchForm
from gpureg.model import memory
from gpureg.regularization import one_sweep as sweep
from gpureg.regularization import tiled as cutting
from gpureg.regularization import tiling as tiling_room

SHAPE = (67, 53)
BILATERAL = gr.weights.bilateral(2.0, 0.4)


def picture(channels: int = 1, shape: tuple[int, ...] = SHAPE) -> np.ndarray:
    return rng(3).random((*shape, channels), dtype=np.float32)


def room(shape: tuple[int, ...], channels: int, settings: dict, device: str, **grid) -> int:
    """Bytes for a part of the job of this shape."""
    known = {k: v for k, v in settings.items() if k in ("p", "weights", "coupled", "norm")}
    return gr.memory_needed(gr.GridGraph(shape, **grid), channels=channels, backend=device, **known)


@pytest.fixture
def pieces(monkeypatch: pytest.MonkeyPatch) -> list:
    """The tilings that were chosen."""
    found: list = []
    tiling = tiling_room.tiling
    for room in (cutting, sweep):
        monkeypatch.setattr(room, "tiling", lambda *a: found.append(tiling(*a)) or found[-1])
    return found


JOBS = {
    "p = 2": {"p": 2, "weights": BILATERAL, "max_iter": 5},
    "p = 1": {"p": 1, "weights": BILATERAL, "max_iter": 5},
    "patches": {"p": 1, "weights": gr.weights.patch(1, 0.8), "max_iter": 3},
    "until a tolerance": {"p": 1, "lam": 3.0, "max_iter": 60, "tol": 2e-2, "solver": gr.Jacobi(check_every=3)},
}


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("name", JOBS)
def test_tiles_give_the_whole(device: str, name: str, channels: int, pieces: list) -> None:
    f0, settings = picture(channels), {"lam": 0.5, **JOBS[name]}
    grid = gr.GridGraph(SHAPE, 1)
    whole = gr.regularize(f0, grid, backend=device, **settings)
    assert not pieces
    least = room((34, 53), channels, settings, device, radius=1)
    tiled = gr.regularize(f0, grid, backend=device, memory=least, **settings)
    assert len(pieces[0].tiles) > 1
    assert tiled.value.tobytes() == whole.value.tobytes()
    assert (tiled.iterations, tiled.stop) == (whole.iterations, whole.stop)
    assert len(tiled.energy) == len(tiled.checks) == 0
    assert "tiles" in tiled.method


OTHERS = {
    "both axes": ({"p": 2, "weights": BILATERAL, "max_iter": 2}, {"radius": 3}, (27, 23)),
    "a map of lam, pinned": ({"p": 1, "max_iter": 6, "solver": gr.Jacobi(damping=0.5), "lam": "map"}, {}, (30, 53)),
    "masked": ({"p": 2, "weights": BILATERAL, "max_iter": 4, "mask": True}, {"radius": 2}, (40, 53)),
    "degree": ({"p": 1, "gamma": "degree", "weights": BILATERAL, "max_iter": 4}, {}, (34, 53)),
    "edge norm": ({"p": 1, "norm": "edge", "max_iter": 4}, {}, (30, 53)),
    "channels alone": ({"p": 1, "coupled": False, "max_iter": 4}, {}, (30, 53)),
    "stored weights": ({"p": 1, "weights": "array", "max_iter": 4}, {}, (34, 53)),
    "features": ({"p": 2, "weights": "features", "max_iter": 3}, {}, (34, 53)),
    "guided": ({"p": 2, "weights": "guide", "max_iter": 3}, {}, (34, 53)),
    "weights anew": ({"p": 1, "weights": BILATERAL, "max_iter": 7, "update_weights": 3}, {}, (40, 53)),
    "weights anew to a tolerance": (
        {"p": 2, "lam": 5.0, "weights": BILATERAL, "max_iter": 30, "update_weights": 12, "tol": 0.05},
        {},
        (40, 53),
    ),
    "another start": ({"p": 1, "max_iter": 4, "initial": "start"}, {}, (30, 53)),
    "damped": ({"p": 3, "max_iter": 4, "solver": gr.Jacobi(damping=0.4)}, {}, (30, 53)),
}


@pytest.mark.parametrize("name", OTHERS)
def test_every_kind_of_job_in_tiles(name: str, pieces: list) -> None:
    settings, window, part = OTHERS[name]
    settings = {"lam": 0.5, **settings}
    f0, mask = picture(2), None
    if settings.pop("mask", False):
        mask = rng(5).random(SHAPE) < 0.8
    grid = gr.GridGraph(SHAPE, mask=mask, **window)
    if isinstance(settings["lam"], str):
        settings["lam"] = np.where(rng(7).random(SHAPE) < 0.2, np.inf, 2 * (rng(9).random(SHAPE) < 0.9))
    kind = settings.get("weights")
    if kind == "array":
        settings["weights"] = grid.edges.gather_half(grid.edges.unit_half() * rng(11).random(SHAPE, dtype=np.float32))
    elif kind == "features":
        settings["weights"] = gr.weights.gaussian(rng(11).random((grid.n_vertices, 2)), 0.5)
    elif kind == "guide":
        settings["weights"] = gr.weights.guided(gr.weights.patch(1, 0.8), rng(11).random((grid.n_vertices, 3)))
    if "initial" in settings:
        settings["initial"] = picture(2)[::-1]
    whole = gr.regularize(f0, grid, backend="numpy", **settings)
    job = {**settings, "weights": BILATERAL} if isinstance(kind, str) else settings
    allowed = room(part, 2, job, "numpy", mask=None if mask is None else np.ones(part, bool), **window)
    tiled = gr.regularize(f0, grid, backend="numpy", memory=allowed, **settings)
    assert len(pieces[0].tiles) > 1
    if name == "both axes":
        assert any(tile.own[1] != slice(0, SHAPE[1]) for tile in pieces[0].tiles)
    assert tiled.value.tobytes() == whole.value.tobytes()


@pytest.mark.parametrize("channels", [None, -1])
@pytest.mark.parametrize(
    "settings", [{"weights": BILATERAL, "radius": 3}, {"weights": gr.weights.patch(2, 0.9), "radius": 2}, {}]
)
def test_a_step_without_stored_weights_in_tiles(
    device: str, settings: dict, channels: int | None, pieces: list, monkeypatch: pytest.MonkeyPatch
) -> None:
    # 150 rows: a device whose sums come in blocks of rows has some
    image = picture(1 if channels is None else 3, (150, 53))
    # a scene that the channels have in common, so that they are denoised together
    image = image[..., 0] if channels is None else image + 9 * (np.indices((150, 53)).sum(axis=0) // 26 % 2)[..., None]
    call = {**settings, "lam": 2 + rng(5).random((150, 53)), "p": 2, "max_iter": 1, "channel_axis": channels}
    call |= {"backend": device, "sigma": 0.1}
    whole = gr.denoise_image(image, **call)
    assert not pieces
    plan = gr.plan_denoising(image, **{k: v for k, v in call.items() if k != "backend"})
    part, m = gr.GridGraph((110, 53), plan.radius), 1 if channels is None else 3
    # averaged patches may need stored weights, and one channel more
    stored = bool(plan.average_patches) and not backends.get(device).averages
    job = {"channels": m + stored, "lam": np.ones(2), "weights": plan.weights, "stored": stored}
    allowed = gr.memory_needed(part, backend=device, **job)
    tiled = gr.denoise_image(image, **call, memory=allowed)
    assert len(pieces[0].tiles) > 1
    assert tiled.tobytes() == whole.tobytes()


def test_backends_tell_the_sizes_of_their_arrays(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against what is asked of the device for each of them."""
    backend = backends.get(device)
    if device == "numpy":
        made = function(graph("grid"), 3)
        assert backend.function_bytes(graph("grid"), 3) == backend.put(graph("grid"), made).nbytes
        weights = BILATERAL.prepare(backend, graph("disk"), function(graph("disk"))).weights
        assert backend.edge_bytes(graph("disk")) == weights.nbytes
        return
    taken: list[int] = []
    if device.startswith("opencl"):
        allocate = backend._allocate
        monkeypatch.setattr(backend, "_allocate", lambda nbytes: taken.append(nbytes) or allocate(nbytes))
    else:
        from gpureg.backends.warp import primitives as warp

        def counted(make):
            def call(*args, **kwargs):
                made = make(*args, **kwargs)
                taken.append(made.size * warp.wp.types.type_size_in_bytes(made.dtype))
                return made

            return call

        monkeypatch.setattr(warp.wp, "zeros", counted(warp.wp.zeros))
        monkeypatch.setattr(warp.wp, "empty", counted(warp.wp.empty))
        monkeypatch.setattr(backend, "upload", counted(backend.upload))

    def asked(work) -> list[int]:
        taken.clear()
        work()
        return sorted(taken)

    said, found, wrong = {}, {}, []
    for name in ("grid", "masked", "volume", "csr of disk"):
        made, m = graph(name), 3
        f, form = function(made, m), PatchForm(np.ones(3), 0.0, 1.0)
        backend.put(made, f)  # so that its layout is there
        said[name] = [[backend.function_bytes(made, m)]] * 2
        found[name] = [
            asked(lambda made=made, f=f: backend.put(made, f)),
            asked(lambda made=made, m=m: backend.empty(made, m)),
        ]
        edges = backend.edge_bytes(made)
        took = sum(asked(lambda made=made, f=f, form=form: backend.patch_distance(made, f, form)))
        least = sum(backend.patch_bytes(made, m, 1)) + edges
        # besides offsets, profiles and the like
        most = least + 8192 + (16 * made.n_vertices if "csr" in name else 0)
        if not least <= took <= most:
            wrong.append((name, least, took, most))
    assert found == said
    assert wrong == []
    taken.clear()
    job = gr.memory_needed(gr.GridGraph((301, 203), 3), weights=BILATERAL, p=1, backend=device)
    assert not taken
    taken.clear()
    gr.regularize(
        picture(1, (301, 203)), gr.GridGraph((301, 203), 3), weights=BILATERAL, p=1, max_iter=1, backend=device
    )
    assert 0.8 * sum(taken) <= job <= 1.1 * sum(taken)


def test_halo_and_tiles() -> None:
    blocks = tiling_room.cut((100, 50), (30, 50), (4, 4), (32, 1))
    assert [tile.own[0] for tile in blocks] == [slice(a, a + 25) for a in (0, 25, 50, 75)]
    assert [tile.wide[0] for tile in blocks] == [slice(0, 29), slice(0, 54), slice(32, 79), slice(64, 100)]
    assert all(tile.wide[1] == slice(0, 50) for tile in blocks)
    assert blocks[2].inner == (slice(18, 43), slice(0, 50))


def test_budget_is_the_least_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    backend = backends.get("numpy")
    share = memory.budget(backend, None)
    assert not share.asked and 0 < share.total < backend.device.memory
    assert memory.budget(backend, 1000) == memory.Budget(1000, 1000, True)
    assert memory.budget(backend, 2**60).total == share.total
    monkeypatch.setenv("GPUREG_MEMORY", "2KiB")
    assert memory.budget(backend, None).total == 2048
    assert memory.budget(backend, 1000).total == 1000
    monkeypatch.setenv("GPUREG_MEMORY", "lots")
    with pytest.raises(ValueError, match="GPUREG_MEMORY: memory must be a number of bytes"):
        memory.budget(backend, None)


@pytest.mark.parametrize("kind", ["cpu", "gpu"])
def test_a_gpu_counts_what_is_free(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    backend = copy.copy(backends.get("numpy"))
    backend.device = dataclasses.replace(backend.device, kind=kind, memory=8000)
    monkeypatch.setattr(type(backend), "free_memory", property(lambda self: 3000))
    assert memory.budget(backend, None).total == {"cpu": 4000, "gpu": 2700}[kind]


@pytest.mark.parametrize(("wrong", "error"), [(0, ValueError), ("4GiB", TypeError), (True, TypeError)])
def test_a_wrong_budget_is_refused(wrong, error: type) -> None:
    with pytest.raises(error, match="memory must be"):
        gr.regularize(picture(), gr.GridGraph(SHAPE), memory=wrong, backend="numpy")


@pytest.mark.parametrize(
    ("wish", "says"),
    [
        ({"callback": lambda check: None}, "a callback is shown the energy"),
        ({"solver": "euler"}, "depends on the whole graph"),
        ({"p": 3}, "whether a sweep raised the energy"),
        ({"lam": 0}, "where lam is 0"),
        ({"gamma": "array"}, "gamma is given per directed edge"),
        ({"gamma": "degree", "weights": BILATERAL, "update_weights": 2}, "changes with weights"),
    ],
)
def test_what_cannot_be_cut_is_refused(wish: dict, says: str) -> None:
    grid = gr.GridGraph((20, 20))
    if isinstance(wish.get("gamma"), str) and wish["gamma"] == "array":
        wish = {"gamma": np.ones(grid.n_edges)}
    with pytest.raises(MemoryError, match=f"cannot be cut into tiles: .*{says}"):
        gr.regularize(picture(1, (20, 20)), grid, memory=10_000, backend="numpy", **wish)
    with pytest.raises(MemoryError, match="only a GridGraph"):
        gr.regularize(np.ones(50), irregular(50, 200, isolated=7), memory=1000, backend="numpy")
    with pytest.raises(MemoryError, match="even a tile of one row"):
        gr.regularize(picture(1, (20, 20)), grid, memory=100, backend="numpy")


def test_an_interruption_leaves_the_last_whole_iterate(monkeypatch: pytest.MonkeyPatch) -> None:
    f0, grid = picture(), gr.GridGraph(SHAPE)
    settings = {"p": 1, "lam": 0.5, "backend": "numpy", "tol": 0.0, "solver": gr.Jacobi(check_every=2)}
    done = []
    sweeps = cutting._sweeps

    def press(*args, **kwargs):
        done.append(1)
        if len(done) == 8:
            raise KeyboardInterrupt
        return sweeps(*args, **kwargs)

    monkeypatch.setattr(cutting, "_sweeps", press)
    with pytest.raises(gr.Interrupted) as caught:
        gr.regularize(f0, grid, max_iter=40, memory=room((34, 53), 1, settings, "numpy"), **settings)
    result = caught.value.result
    assert 0 < result.iterations < 40
    assert result.stop is gr.Stop.INTERRUPTED
    known = gr.regularize(f0, grid, max_iter=result.iterations, **{**settings, "tol": None})
    assert np.array_equal(result.value, known.value)


def test_a_window_as_wide_as_the_grid_takes_what_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small tiles with their halos are the whole: then the step takes more than it usually would."""
    image = picture(1, (7, 6, 5))[..., 0]
    call = {"sigma_value": 0.3, "radius": 6, "border": "nearest", "backend": "numpy"}
    whole = gr.denoise_bilateral(image, **call)
    monkeypatch.setattr(sweep, "_STEP_BYTES", 1 << 16)
    assert np.array_equal(gr.denoise_bilateral(image, **call), whole)
    with pytest.raises(MemoryError, match="even a tile of one row"):
        gr.denoise_bilateral(image, memory=1 << 16, **call)
