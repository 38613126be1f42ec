"""One struct a primitive, and the one comparison that the tests hold every device to.

A row says what a primitive is called with and what it writes. It serves the tests (values within bounds, the same bits
on a second run, nothing written outside of an array; mutations must break the same comparison), the table of what each
device supports (tests/support.py) and the traffic that bench/model.py counts. tests/rows.py has the rows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from guards import guarded
from problems import oracle

from gpureg import backends
from gpureg.backends import BackendUnavailable

# What an argument or a result is: a function on the vertices of m channels, of one a gradient norm, of one, of some
# number or a number in its place; a function on the edges of m channels; a host array; a number or a setting; scratch
# memory for gradient norms.
FUNCTION, NORMS, COLUMN, EDGES, HOST, SETTING, SCRATCH = (
    "function", "norms", "column", "edges", "host", "setting", "scratch",
)  # fmt: skip
# Results alone: one number, weights, distances and labels of vertices.
NUMBER, WEIGHTS, ZONES = "number", "weights", "zones"


@dataclasses.dataclass(frozen=True, eq=False)
class Call:
    """One call of a primitive.

    Attributes
    ----------
    what : str
        What is special of it, in words.
    args : dict
        Arguments by name, on the host.
    bound : callable
        Of the exact result: how far a device may be off.
    place : str or None
        The argument that is also the output; None for an output of its own, full of NaN before.
    channels : int or None
        Of the output; None for those of the problem.
    also : callable or None
        More to hold, of a device (:class:`On`), its result on the host and the device's own result.
    """

    what: str
    args: dict[str, Any]
    bound: Callable[[Any], Any]
    place: str | None = None
    channels: int | None = None
    also: Callable[[On, Any, Any], None] | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Primitive:
    """A primitive of the protocol.

    Attributes
    ----------
    name : str
        The method of :class:`gpureg.backends.Backend`.
    args : dict
        What each argument is, by name, but the first one: weights or a graph.
    result : str
        What it gives.
    calls : callable
        The calls to make for a problem.
    weights : bool
        Whether its first argument is a graph with its weights, which it reads.
    out : bool
        Whether it takes an output.
    graphs : tuple of str
        The kinds of graph it is for: "grid", "stored".
    parts : tuple of str
        The primitives that it is made of, where it is no kernel of its own.
    """

    name: str
    args: dict[str, str]
    result: str
    calls: Callable[[Any], Iterator[Call]]
    weights: bool = True
    out: bool = True
    graphs: tuple[str, ...] = ("grid", "stored")
    parts: tuple[str, ...] = ()

    def traffic(
        self,
        neighbours: float,
        *,
        channels: int = 1,
        norms: int = 1,
        stored: bool = False,
        arrays: tuple[str, ...] = (),
        itemsize: int = 4,
    ) -> tuple[float, float]:
        """Bytes read and bytes written per vertex of so many neighbours, each array once.

        Arguments that may be numbers are, but for those named in `arrays`. A grid stores a weight once per pair; a
        stored graph has one per directed edge, and an index, and a pointer per vertex.
        """
        if self.parts:
            settings = {"channels": channels, "norms": norms, "stored": stored, "itemsize": itemsize}
            found = [ROWS[part].traffic(neighbours, arrays=arrays, **settings) for part in self.parts]
            return sum(read for read, _ in found), sum(written for _, written in found)
        sizes = {
            FUNCTION: channels, HOST: channels, NORMS: norms, EDGES: neighbours * channels, COLUMN: 1,
            WEIGHTS: neighbours * (1 if stored else 0.5), SETTING: 0, SCRATCH: 0, NUMBER: 0, ZONES: 3,
        }  # fmt: skip
        read = sum(
            sizes[kind] for name, kind in self.args.items() if kind != COLUMN or name in ("share", "centre", *arrays)
        )
        if self.weights:
            read += 2 * neighbours + 1 if stored else neighbours / 2
        return read * itemsize, sizes[self.result] * itemsize


ROWS: dict[str, Primitive] = {}
"""Every primitive by its name; tests/rows.py fills it."""


def assert_within(actual: Any, exact: Any, bound: Any, what: str) -> None:
    """NaN fails too: it is not <= anything."""
    actual, exact = np.asarray(actual, float), np.asarray(exact)
    assert actual.shape == exact.shape
    with np.errstate(invalid="ignore"):
        off = np.where(actual == exact, 0, np.abs(actual - exact))
    bad = ~(off <= bound)
    if bad.any():
        at = tuple(int(i[0]) for i in np.nonzero(np.atleast_1d(bad)))
        worst = np.nanmax(np.where(bad, off, 0), initial=0)
        raise AssertionError(
            f"{what}: {int(bad.sum())} of {bad.size} numbers are out of bounds, the first at {at}: "
            f"{np.atleast_1d(actual)[at]} for {np.atleast_1d(exact)[at]}, "
            f"allowed {np.atleast_1d(np.broadcast_to(bound, off.shape))[at]:.2g}; the worst is off by {worst:.2g}"
        )


def on(device: str, dtype: str = "float32") -> Any:
    """The backend of a device in one type; devices without float64 skip it."""
    try:
        return backends.get(device, dtype)
    except BackendUnavailable as error:
        assert dtype == "float64", error
        pytest.skip(str(error))


def nan(backend: Any, graph: Any, channels: int) -> Any:
    """An output that a kernel has to write: NaN everywhere."""
    return backend.put(graph, np.full((graph.n_vertices, channels), np.nan))


def as_gpu(device: str, dtype: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The backend as it treats a GPU: one cell a thread; numpy has no such way."""
    if device.startswith("numpy"):
        pytest.skip("numpy has no other way for a GPU")
    backend = backends.get(device, dtype)
    if backend.name == "warp":
        from gpureg.backends.warp import patches as warp_patches

        monkeypatch.setattr(warp_patches, "_STRIP_ROWS", 1)
        monkeypatch.setattr(warp_patches, "_STRIP_BYTES", backend.dtype.itemsize)
        return backend
    from gpureg.backends.opencl import primitives as opencl

    return opencl.make(dataclasses.replace(backend.device, vector_width=1, kind="gpu"), dtype)


class On:
    """A problem on a device: every array that it puts there lies between guards."""

    def __init__(self, backend: Any, problem: Any) -> None:
        self.backend, self.problem, self.graph = guarded(backend), problem, problem.graph
        self._there: dict[tuple[int, str], tuple[Any, Any]] = {}
        with self.backend.framing():
            self.weighted = problem.on(self.backend)

    def put(self, kind: str, value: Any) -> Any:
        """An argument on the device, put there once."""
        if kind == SCRATCH:
            return None if value is None else nan(self.backend, self.graph, value)
        if kind in (HOST, SETTING) or not isinstance(value, np.ndarray):
            return value
        key = id(value), kind
        if key not in self._there:
            self._there[key] = value, self.copy(kind, value)  # with the host's array: no other one gets its number
        return self._there[key][1]

    def copy(self, kind: str, value: Any) -> Any:
        """An argument on the device, of its own."""
        if kind == EDGES:
            return self.backend.put_edges(self.graph, self.problem.host(value))
        return self.backend.put(self.graph, value)

    def output(self, row: Primitive, channels: int) -> Any:
        """An output full of NaN."""
        if row.result == EDGES:
            # NaN where there is no edge, too
            host = self.problem.host(np.zeros((len(self.problem.rows), channels)))
            return self.backend.put_edges(self.graph, np.full_like(host, np.nan))
        return nan(self.backend, self.graph, channels)

    def get(self, kind: str, x: Any) -> Any:
        """A result on the host."""
        if kind == NUMBER:
            assert isinstance(x, float)
            return np.array(x)
        if kind == ZONES:
            return np.stack(x).astype(float) if isinstance(x, tuple) else np.asarray(x, float)
        if kind == WEIGHTS:
            return self.backend.get_weights(x)
        return (self.backend.get_edges if kind == EDGES else self.backend.get)(self.graph, x)

    def run(self, row: Primitive, call: Call) -> tuple[Any, Any]:
        """The result on the host, and as the device gave it."""
        args = {name: self.put(row.args[name], value) for name, value in call.args.items()}
        if call.place is not None:
            args[call.place] = self.copy(row.args[call.place], call.args[call.place])
        out = args.get(call.place) if call.place else None
        if row.out and row.args.get(call.place or "") != EDGES:
            if out is None:
                out = self.output(row, call.channels or self.problem.channels)
            args["out"] = out
        with self.backend.framing():
            found = getattr(self.backend, row.name)(self.weighted if row.weights else self.graph, **args)
        assert out is None or found is out
        return self.get(row.result, found), found


def exact(row: Primitive, problem: Any, call: Call) -> Any:
    """The oracle's result and how far a device may be from it, computed once."""
    key = row.name, call.what
    if key not in problem.exact:
        args = {
            name: problem.host(value).copy() if row.args[name] == EDGES else value for name, value in call.args.items()
        }
        for name, kind in row.args.items():
            if kind == SCRATCH:
                args[name] = None
        if row.out and row.parts:  # a sweep is not without an output
            args["out"] = np.full_like(problem.f, np.nan)
        found = getattr(oracle(), row.name)(problem.on_oracle if row.weights else problem.graph, **args)
        if row.result == WEIGHTS:
            found = oracle().get_weights(found)
        elif row.result == ZONES:
            found = np.stack(found).astype(float) if isinstance(found, tuple) else np.asarray(found, float)
        problem.exact[key] = found, call.bound(found)
    return problem.exact[key]


def check_call(device: On, row: Primitive, call: Call) -> None:
    """One call: within the bound, and the same bits on a second run."""
    expected, bound = exact(row, device.problem, call)
    found, there = device.run(row, call)
    if row.result in (FUNCTION, NORMS, COLUMN, EDGES, WEIGHTS):
        assert found.dtype == device.backend.dtype
    assert_within(found, expected, bound, f"{row.name}, {call.what}")
    again, _ = device.run(row, call)
    assert found.tobytes() == again.tobytes(), f"{row.name}, {call.what}: other bits on the second run"
    if call.also is not None:
        call.also(device, found, there)


def check(backend: Any, row: Primitive, problem: Any, *, first: bool = False) -> None:
    """Every call of a primitive on a problem, and the guards; all that failed is told, or with `first` that alone."""
    device, failed, count = On(backend, problem), [], 0
    for call in row.calls(problem):
        count += 1
        try:
            check_call(device, row, call)
        except AssertionError as error:
            failed.append(str(error))
            if first:
                break
    assert count, f"{row.name} is not called"
    try:
        device.backend.check_guards()
    except AssertionError as error:
        failed.append(f"{row.name}: {error}")
    assert not failed, "\n".join(failed)
