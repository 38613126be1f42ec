"""Launches are cut on devices that draw the screen, without another bit in any result."""

from __future__ import annotations

import copy
import dataclasses
import itertools

import numpy as np
import pytest
from cases import rng

import gpureg as gr
from gpureg import backends
from gpureg.backends import Backend, bands, dispatch
from gpureg.backends.bands import Bands


class Machine:
    """A device that does so many work items per second, after 0.1 ms for each launch; it counts its time."""

    def __init__(self, speed: float) -> None:
        self.speed, self.now = speed, 0.0
        self.launches: list[tuple[int, int]] = []
        self.seconds: list[float] = []
        self.bands = Bands(lambda: self.now)

    def run(self, count: int, items: int) -> list[tuple[int, int]]:
        """Run a launch, and return its bands."""
        self.launches, self.seconds = [], []

        def launch(first: int, last: int) -> None:
            took = 1e-4 + (last - first) * items / self.speed
            self.now += took
            self.launches.append((first, last))
            self.seconds.append(took)

        self.bands.run("kernel", count, items, launch, lambda: None)
        edges = [first for first, _ in self.launches] + [count]
        assert self.launches == list(itertools.pairwise(edges)) and edges[0] == 0
        return self.launches


def test_a_short_launch_stays_whole() -> None:
    machine = Machine(1e9)
    machine.run(100, 100)
    assert machine.run(100, 100) == [(0, 100)]
    assert machine.bands.known("kernel", 100, 100) == [(0, 100)]
    assert machine.bands.known("another", 10**6, 100) == [(0, 10**6)]


@pytest.mark.parametrize("speed", [1e5, 1e7, 1e9, 1e11])
def test_no_band_of_a_long_launch_is_long(speed: float) -> None:
    """2 s of work, of a kernel that was never timed: a band is never longer than twice 50 ms, once it can be shorter.

    A device that needs 0.16 s for the first band of 16384 items cannot have a shorter one.
    """
    machine, items = Machine(speed), 1000
    count = int(2 * speed / items)
    machine.run(count, items)
    assert max(machine.seconds) <= max(2 * 0.05, 1e-4 + 16384 / speed)
    assert len(machine.launches) >= 2 / max(2 * 0.05, 16384 / speed)
    machine.run(count, items)
    assert max(machine.seconds) <= max(0.06, 1000 / speed + 1e-4)
    # hardly more launches than needed
    assert len(machine.launches) <= max(2 / 0.05 * 1.5, count)
    assert len(machine.bands.known("kernel", count, items)) <= max(2 / 0.05 * 1.5, count)


def test_a_kernel_that_becomes_slower() -> None:
    """A larger window: the next launch of the same kernel takes 20 times as long for an item."""
    machine = Machine(1e9)
    machine.run(10**6, 1000)
    machine.speed /= 20
    machine.run(10**6, 1000)
    assert sorted(machine.seconds)[-2] <= 0.06 and max(machine.seconds) <= 0.25
    machine.run(10**6, 1000)
    assert max(machine.seconds) <= 0.06


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch):
    """A device of which the driver ends long launches, and on which a band is one row."""

    def made(name: str) -> tuple[Backend, list[int]]:
        found = backends.get(name)
        if name == "numpy":
            pytest.skip("numpy launches nothing")
        backend = copy.copy(found)
        backend.device = dataclasses.replace(found.device, watched=True)
        used, one = Bands(), []
        monkeypatch.setattr(bands, "_FIRST", 1)
        monkeypatch.setattr(bands, "_SHORT", 1e9)
        monkeypatch.setattr(Bands, "_units", staticmethod(lambda *args: 1))
        run = used.run
        monkeypatch.setattr(used, "run", lambda *args: (one.append(args[1]), run(*args)))
        used._speeds.clear()
        if hasattr(backend, "_shared"):
            backend._shared = dataclasses.replace(backend._shared, bands=used)
        else:
            from gpureg.backends.warp import pool

            backend._bands = used
            monkeypatch.setattr(pool, "cores", lambda: 1)
        return backend, one

    return made


@pytest.mark.one_driver
def test_bands_have_the_bits_of_the_whole(device: str, watched, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every launch of a filter and of sweeps, row by row."""
    image, grid = rng(3).random((40, 33), dtype=np.float32), gr.GridGraph((40, 33))

    def results() -> list[np.ndarray]:
        return [
            gr.denoise_nl_means(image, h=0.4, radius=2, patch_radius=1, backend=device),
            gr.regularize(image, grid, p=1, weights=gr.weights.bilateral(2.0, 0.4), max_iter=3, backend=device).value,
        ]

    expected = results()
    backend, counts = watched(device)
    monkeypatch.setattr(dispatch, "_make", lambda found, dtype: backend)
    assert [x.tobytes() for x in results()] == [x.tobytes() for x in expected]
    assert max(counts) > 1


def test_groups_are_counted_from_the_first_work_item_of_all() -> None:
    """OpenCL counts groups from the first one of a launch: a kernel by groups would do the first band again."""
    cl = pytest.importorskip("pyopencl", reason="OpenCL is not installed")
    from gpureg.backends.opencl import failing, launching

    if "opencl" in backends.absent():
        pytest.skip("no OpenCL device")
    shared = backends.get("opencl")._shared  # type: ignore[attr-defined]
    kernel = "kernel void a(global int *out) { out[get_global_id(0)] = (int)get_group_id(0); }"
    found = cl.Kernel(failing.built(shared.context, launching._GROUPS_FROM_ITEMS + kernel, []), "a")
    out = np.full(12, -1, np.int32)
    buffer = cl.Buffer(shared.context, cl.mem_flags.COPY_HOST_PTR, hostbuf=out)
    for first, last in ((0, 4), (4, 12)):
        size, offset = launching._band((12,), 0, first, last)
        found(shared.queue, size, (2,), buffer, global_offset=offset)
    cl.enqueue_copy(shared.queue, out, buffer)
    assert out.tolist() == [i // 2 for i in range(12)]
    assert launching._last_axis((64, 8, 1), (64, 1, 1)) == (1, 1)
    assert launching._last_axis((128,), (64,)) == (0, 64)
    assert launching._band((64, 8, 1), 1, 2, 8) == ((64, 6, 1), (0, 2, 0))
