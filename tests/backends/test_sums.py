"""Long sums: numbers that stay on the device, and how a GPU adds, tried on the CPU drivers that are here."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import cases
import numpy as np
import pytest

from gpureg import backends
from gpureg.backends import Smoothness

MODEL = Smoothness(1.0, cases.EPS)


def put(backend: Any, name: str) -> tuple[Any, ...]:
    """A graph with its weights, two functions and a divisor that is infinite at some vertices."""
    graph = cases.graph(name)
    f, f0 = (backend.put(graph, cases.function(graph, seed=seed)) for seed in (11, 13))
    return graph, backend.prepare(graph, cases.weights(name)), f, f0, backend.put(graph, cases.fidelity(graph) + 1)


def test_numbers_stay_on_the_device(device: str) -> None:
    """Each sum has its own number, the others are as they were; the values are those of the methods that wait."""
    backend = backends.get(device)
    graph, weighted, f, f0, over = put(backend, "grid")
    numbers = backend.numbers(5)
    backend.dot_into(numbers[3], graph, f, f0, over=over)
    backend.max_change_into(numbers[1], graph, f, f0)
    backend.energy_into(numbers[4], weighted, f, f0, over, MODEL)
    found = backend.read(numbers)
    assert found.dtype == np.float64
    waited = backend.max_change(graph, f, f0), backend.dot(graph, f, f0, over=over)
    assert found.tolist() == [0.0, waited[0], 0.0, waited[1], backend.energy(weighted, f, f0, over, MODEL)]
    with pytest.raises(IndexError, match="number 5 of 5"):
        numbers[5]


@pytest.mark.one_driver
def test_threads_do_not_share_a_number(device: str) -> None:
    """Each thread waits for its own sums: parts of one must not become those of another."""
    backend = backends.get(device)
    graph, _, f, f0, _ = put(backend, "grid")
    expected = backend.dot(graph, f, f0), backend.dot(graph, f, f)
    wrong: list[tuple[float, float]] = []

    def work(other: Any, value: float) -> None:
        found = [backend.dot(graph, f, other) for _ in range(50)]
        wrong.extend((x, value) for x in found if x != value)

    threads = [threading.Thread(target=work, args=pair) for pair in zip((f0, f), expected, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


@pytest.mark.parametrize(("name", "float64"), [("packs", False), ("csr", True)])
def test_a_gpu_adds_with_a_stride(oracle: Any, name: str, float64: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """More vertices than work items, and aligned rows, which have packs; without float64 pairs of float32 are as good.

    Bound: a product and a division of float32 per term (2 u and 3 u of the compiler's division), 4 u for the rest.
    """
    drivers = [device for device in backends.devices() if device.backend == "opencl"]
    if not drivers:
        pytest.skip(backends.absent()["opencl"])
    from gpureg.backends.opencl import primitives, sums

    monkeypatch.setattr(sums, "_GROUPS", 3)
    monkeypatch.setattr(sums, "_GROUP", 16)
    given = replace(drivers[0], vector_width=1, kind="gpu", float64=float64 and drivers[0].float64)
    backend = primitives.make(given, "float32")
    graph, weighted, f, f0, over = put(backend, name)
    numbers = backend.numbers(3)
    backend.dot_into(numbers[0], graph, f, f0, over=over)
    backend.max_change_into(numbers[1], graph, f, f0)
    backend.energy_into(numbers[2], weighted, f, f0, over, MODEL)
    exact_graph, exact_weighted, a, b, divisor = put(oracle, name)
    sizes = np.abs(a * b / divisor).sum()
    energy = oracle.energy(exact_weighted, a, b, divisor, MODEL)
    exact = [oracle.dot(exact_graph, a, b, over=divisor), oracle.max_change(exact_graph, a, b), energy]
    off = np.abs(backend.read(numbers) - exact)
    u = cases.UNIT_ROUNDOFF["float32"]
    assert off[0] <= 9 * u * sizes
    assert off[1] <= 2 * u * exact[1]
    assert off[2] <= cases.TOLERANCES["float32"] * energy
    assert graph.n_vertices > 3 * 16
    mixed, exact_mix = (
        one.get(graph, one.combine(graph, 2.0, x, -0.5, y, over=z))
        for one, x, y, z in ((backend, f, f0, over), (oracle, a, b, divisor))
    )
    assert np.abs(mixed - exact_mix).max() <= 5 * u * (2 * np.abs(a) + np.abs(b / divisor)).max()
