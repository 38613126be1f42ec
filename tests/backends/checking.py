"""The one comparison that the tests hold every device to."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
from guards import guarded
from primitives import (
    COLUMN,
    EDGES,
    FUNCTION,
    GUIDE,
    HOST,
    LABELS,
    LENGTHS,
    NORMS,
    NUMBER,
    SCRATCH,
    SETTING,
    WEIGHTS,
    ZONES,
    Call,
    Primitive,
    assert_within,
)
from problems import oracle

from gpureg import backends
from gpureg.backends import BackendUnavailable, Box

if TYPE_CHECKING:
    import pytest


def _skip(reason: str) -> None:
    import pytest  # here, as the benchmark compares without it

    pytest.skip(reason)


def on(device: str, dtype: str = "float32") -> Any:
    """The backend of a device in one type; devices without float64 skip it."""
    try:
        return backends.get(device, dtype)
    except BackendUnavailable as error:
        assert dtype == "float64", error
        _skip(str(error))


def nan(backend: Any, graph: Any, channels: int) -> Any:
    """An output that a kernel has to write: NaN everywhere."""
    return backend.put(graph, np.full((graph.n_vertices, channels), np.nan))


def as_gpu(device: str, dtype: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The backend as it treats a GPU: one cell a thread; numpy has no such way."""
    if device.startswith("numpy"):
        _skip("numpy has no other way for a GPU")
    backend = backends.get(device, dtype)
    if backend.name == "warp":
        from gpureg.backends.warp import primitives as warp

        return warp.make(dataclasses.replace(backend.device, kind="gpu"), dtype)
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
        if isinstance(value, Box):
            return Box(self.put(FUNCTION, value.low), self.put(FUNCTION, value.high))
        if kind in (HOST, GUIDE, LENGTHS, LABELS, SETTING) or not isinstance(value, np.ndarray):
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
        if kind in (ZONES, LABELS):
            return np.asarray(x, float)
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
        elif row.result in (ZONES, LABELS):
            found = np.asarray(found, float)
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
    device, failed, seen = On(backend, problem), [], set()
    for call in row.calls(problem):
        assert call.what not in seen, f"two calls of {row.name} are {call.what!r}"  # the oracle's results go by it
        seen.add(call.what)
        try:
            check_call(device, row, call)
        except AssertionError as error:
            failed.append(str(error))
            if first:
                break
    assert seen, f"{row.name} is not called"
    try:
        device.backend.check_guards()
    except AssertionError as error:
        failed.append(f"{row.name}: {error}")
    assert not failed, "\n".join(failed)
