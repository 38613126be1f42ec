"""Computations with a few numbers on the device: every task, against numpy in float64."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from gpureg import backends
from gpureg.backends import scalars
from gpureg.graphs.grid import GridGraph

GRAPH = GridGraph((6, 8))


def put(backend: Any, numbers: Any, at: int, value: float) -> None:
    """Write a number to its place: the sum of a function and 1."""
    ones, f = np.ones((48, 1)), np.zeros((48, 1))
    f[7] = value
    backend.dot_into(numbers[at], GRAPH, backend.put(GRAPH, f), backend.put(GRAPH, ones))


@pytest.mark.one_driver
def test_a_rise_of_the_energy_is_seen(device: str) -> None:
    """The largest quotient stays; an energy that is not a number, or above 0, is infinitely above."""
    backend = backends.get(device)
    numbers = backend.scalars()
    old, new = scalars.ENERGIES, scalars.ENERGIES + 1
    for pair, worst in [
        ((2, 1), 0.0), ((1, 1), 0.0), ((4, 5), 1.25), ((4, 4.5), 1.25), ((0, 0), 1.25), ((4, math.nan), math.inf),
    ]:  # fmt: skip
        put(backend, numbers, old, pair[0])
        put(backend, numbers, new, pair[1])
        backend.watch(numbers, new, old)
        assert backend.read(numbers)[scalars.WORST] == worst
    backend.begin_scalars(numbers)
    assert backend.read(numbers)[scalars.WORST] == 0
    put(backend, numbers, old, 0)
    put(backend, numbers, new, 1e-3)
    backend.watch(numbers, new, old)
    assert backend.read(numbers)[scalars.WORST] == math.inf


def test_coefficients_minimise_the_residual(device: str) -> None:
    """Differences come one by one, more of them than there are places; one is 0 and one is there twice.

    The sums are exact to 1e-7 in float32, and the ridge is 1e-12: what is left of the residual is that of numpy's least
    squares up to 1e-5 of it.
    """
    backend, rng = backends.get(device), np.random.default_rng(3)
    numbers, columns, residual = backend.scalars(), {}, rng.standard_normal((48, 1)).astype(np.float32)
    for step in range(15):
        column = rng.standard_normal((48, 1)).astype(np.float32)
        column = 0 * column if step == 3 else columns[(step - 1) % scalars.PLACES] if step == 6 else column
        place = step % scalars.PLACES
        columns[place] = column
        residual = residual + column
        on = {k: backend.put(GRAPH, x) for k, x in columns.items()}
        for k, x in on.items():
            backend.dot_into(numbers[scalars.ROW + k], GRAPH, on[place], x)
        backend.dot_into(numbers[scalars.PRODUCT], GRAPH, on[place], backend.put(GRAPH, residual))
        backend.mix_coefficients(numbers, place)
        if step == 8:  # half of them go
            put(backend, numbers, scalars.MIXED, 2.0)
            put(backend, numbers, scalars.BEFORE, 1.0)
            backend.judge_mix(numbers)
    values = backend.read(numbers)
    # 9 differences, 4 of them dropped, 6 more
    assert values[scalars.COUNT] == scalars.MEMORY
    assert values[scalars.REJECTED] == 1 and values[scalars.ACCEPTED] == 0
    used = [step % scalars.PLACES for step in range(5, 15)]
    c = values[scalars.COEFFICIENTS :][: scalars.PLACES]
    assert np.flatnonzero(c == 0).tolist() == [4 % scalars.PLACES]
    R = np.hstack([columns[k] for k in used]).astype(np.float64)
    exact = np.linalg.lstsq(R, residual[:, 0], rcond=None)[0]
    left = np.linalg.norm(residual[:, 0] - R @ c[used])
    assert left <= (1 + 1e-5) * np.linalg.norm(residual[:, 0] - R @ exact)


@pytest.mark.one_driver
@pytest.mark.parametrize(("mixed", "taken"), [(1.0, 1), (1.0 + 1e-6, 0), (math.nan, 0)])
def test_a_mix_is_taken_if_its_energy_is_not_above(device: str, mixed: float, taken: int) -> None:
    backend = backends.get(device, "float64")
    numbers = backend.scalars()
    put(backend, numbers, scalars.MIXED, mixed)
    put(backend, numbers, scalars.BEFORE, 1.0)
    backend.judge_mix(numbers)
    values = backend.read(numbers)
    assert (values[scalars.TAKEN], values[scalars.LEFT], values[scalars.ACCEPTED]) == (taken, 1 - taken, taken)
