"""Systems whose eigenvectors are cosines, and coefficients that the device computes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gpureg import backends
from gpureg.backends import Ratio
from gpureg.backends.cosines import Lines, radices
from gpureg.graphs.grid import GridGraph

# A prime number of cells, powers of 2 and of other primes, axes of one cell, an odd number of lines, three axes.
SHAPES = [((16, 12), 1), ((17, 15), 3), ((1, 13), 2), ((40,), 1), ((3, 5, 6), 2)]


@pytest.mark.parametrize("n", [1, 2, 12, 64, 97, 360])
def test_radices_give_the_size(n: int) -> None:
    assert np.prod(radices(n)) == n


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_lines_cover_a_grid_once(axis: int) -> None:
    """The first cells of all lines, and the steps along them, as the kernels compute them."""
    shape = (3, 4, 5)
    lines = Lines.of(shape, axis)
    line = np.arange(lines.count)
    row = line // lines.columns
    first = (row // lines.inner * lines.block + row % lines.inner) * shape[-1] + line % lines.columns
    cells = first[:, None] + np.arange(lines.n) * (lines.rows_along * shape[-1] or 1)
    assert sorted(cells.ravel()) == list(range(60))
    assert np.array_equal(cells, np.moveaxis(np.arange(60).reshape(shape), axis, -1).reshape(-1, lines.n))


@pytest.mark.one_driver
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_device_solves_as_scipy(device: str, dtype: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The transforms of a GPU, on the devices that are here, against the host's in float64.

    A number is at most the root mean square of the function times sqrt(n): an error of 8 roundings of that, measured
    2, for 5 steps of each of the 2 transforms.
    """
    backend, rng = backends.get(device, dtype), np.random.default_rng(5)
    for shape, channels in SHAPES:
        graph = GridGraph(shape)
        f, eigenvalues = rng.standard_normal((graph.n_vertices, channels)), 0.5 + rng.random((*shape, 1))
        given = backend.put(graph, f)
        host = backends.get("numpy", "float64")
        exact = host.cosine_solve(
            host.cosines(graph, eigenvalues, channels),
            backend.get(graph, given).astype(np.float64),
            out=np.empty_like(f),
        )
        if backend.name != "numpy":
            monkeypatch.setattr(type(backend), "transforms", True)
        cosines = backend.cosines(graph, eigenvalues, channels)
        assert (cosines.place is None) == (backend.name == "numpy")
        out = backend.put(graph, np.full_like(f, np.nan))
        found = backend.get(graph, backend.cosine_solve(cosines, given, out=out))
        off = np.abs(found - exact).max()
        assert off <= 8 * np.finfo(dtype).eps / 2 * np.sqrt((exact**2).mean() * graph.n_vertices), (shape, off)
        again = backend.get(graph, backend.cosine_solve(cosines, given, out=given))
        assert again.tobytes() == found.tobytes()


@pytest.mark.parametrize("above", [0, 2])
def test_coefficients_of_the_device(device: str, above: int) -> None:
    """A quotient of two sums; a term with the coefficient 0 is left out, whatever its function is."""
    backend, graph = backends.get(device, "float32"), GridGraph((5, 7))

    def put(values: Any) -> Any:
        return backend.put(graph, np.broadcast_to(np.asarray(values, float).reshape(-1, 1), (35, 1)))

    x, ones, lost, numbers = put(np.arange(35)), put(1), put(np.inf), backend.numbers(3)
    backend.dot_into(numbers[0], graph, x, ones)
    backend.dot_into(numbers[1], graph, ones, ones)
    out = backend.empty(graph, 1)
    found = [
        backend.get(graph, backend.combine(graph, Ratio(numbers, above, 1, -1.0), x, 0.5, ones, out=out)),
        backend.get(graph, backend.combine(graph, Ratio(numbers, 1, 2), lost, Ratio(numbers, above, 1), x, out=out)),
    ]
    quotient = 17.0 if above == 0 else 0.0
    assert np.array_equal(found[0][:, 0], 0.5 - quotient * np.arange(35))
    assert np.array_equal(found[1][:, 0], quotient * np.arange(35))
