"""A device that cannot build its kernels, or talks while it does: with failures that are made here."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Iterator

import numpy as np
import pytest

import gpureg as gr
from gpureg import backends
from gpureg.backends import dispatch, failures

F0 = np.array([0.0, 1.0, 0.0, 2.0, 1.0])
GRID = gr.GridGraph(5)


@pytest.fixture
def nothing_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget failures before and after a test."""
    for name, fresh in (("_failed", {}), ("_chosen", set()), ("_told", set())):
        monkeypatch.setattr(failures, name, fresh)


@pytest.fixture
def broken(monkeypatch: pytest.MonkeyPatch, nothing_failed: None) -> Iterator[list[str]]:
    """Every OpenCL driver refuses every program, and there is no Warp; the programs that were tried."""
    pytest.importorskip("pyopencl", reason="OpenCL is not installed")
    from gpureg.backends.opencl import failing, launching
    from gpureg.backends.opencl.queue import queue

    devices = [device for device in backends.devices() if device.backend == "opencl"]
    if not devices:
        pytest.skip("no OpenCL device")
    tried: list[str] = []

    def refused(context, source, options):
        tried.append(context.devices[0].name)
        return failing.built(context, "kernel void f() { missing = 1; }", options)

    monkeypatch.setattr(launching, "built", refused)
    # another dictionary: an item put back would be the last one, and messages name them in order
    monkeypatch.setattr(dispatch, "_BACKENDS", {k: v for k, v in dispatch._BACKENDS.items() if k != "warp"})
    built = [(queue(device.handle).kernels, dict(queue(device.handle).kernels)) for device in devices]
    for kernels, _ in built:
        kernels.clear()
    yield tried
    for kernels, before in built:
        kernels.update(before)


def test_auto_goes_on_after_a_failed_build(broken: list[str]) -> None:
    drivers = [device for device in backends.devices() if device.backend == "opencl"]
    with pytest.warns(UserWarning, match="cannot build the kernel") as told:
        result = gr.regularize(F0, GRID, p=1, max_iter=3)
    assert result.backend.startswith("numpy")
    assert np.array_equal(result.value, gr.regularize(F0, GRID, p=1, max_iter=3, backend="numpy").value)
    assert broken == [device.name for device in drivers]
    # each device is told of once, with what the compiler said and what is used instead
    assert [device.id in str(one.message) for one, device in zip(told, drivers, strict=True)] == [True] * len(drivers)
    assert all("undeclared" in str(one.message) for one in told)
    assert "goes on with numpy" in str(told[-1].message)
    assert "left out: it cannot build" in backends.why_auto()
    broken.clear()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gr.denoise_tv(np.eye(4), lam=2.0)
    assert broken == []


def test_a_build_that_fails_late(broken: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """After the first look at the energy the program of a sweep fails: the call begins again, on another device."""
    from gpureg.backends.opencl import failing, launching

    def sweep_refused(context, source, options):
        bad = "void sweep" in source
        broken.extend([context.devices[0].name] * bad)
        return failing.built(context, "kernel void f() { missing = 1; }" if bad else source, options)

    monkeypatch.setattr(launching, "built", sweep_refused)
    checks: list[int] = []
    with pytest.warns(UserWarning, match="cannot build the kernel"):
        result = gr.regularize(F0, GRID, p=1, max_iter=1, callback=lambda check: checks.append(check.iteration))
    assert result.backend.startswith("numpy")
    assert checks == [0] * len(broken) + [0, 1]
    assert broken == [device.name for device in backends.devices() if device.backend == "opencl"]


def test_two_calls_meet_the_same_failure(broken: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """While one call builds, another one has already told of the device: both go on with the next one."""
    from gpureg.backends.opencl import launching

    refused = launching.built

    def told_of(context, source, options):
        for device in backends.devices():
            if device.handle == context.devices[0]:
                failures.build_failed(device, "float64", "other", "error: the other call")
        return refused(context, source, options)

    monkeypatch.setattr(launching, "built", told_of)
    with pytest.warns(UserWarning, match="the other call"):
        assert gr.regularize(F0, GRID, p=1, max_iter=3, dtype="float64").backend.startswith("numpy")


def test_a_device_that_auto_had_chosen_is_named(broken: list[str], nothing_failed: None) -> None:
    """The call does not go on for ever: a device that is named fails again."""
    device = next(one for one in backends.devices() if one.backend == "opencl")
    failures.chosen(device, "float64", [])
    with pytest.raises(gr.BackendUnavailable, match="cannot build the kernel"):
        gr.regularize(F0, GRID, backend=device.id, dtype="float64")


def test_the_error_of_a_build_is_pickled() -> None:
    """As by a process of a pool that hands it to the one that waits."""
    error = pickle.loads(pickle.dumps(failures.BuildFailed("why", ("opencl:0", "float32"))))
    assert isinstance(error, gr.BackendUnavailable)
    assert (str(error), error.again) == ("why", ("opencl:0", "float32"))


def test_a_named_device_says_what_its_compiler_said(broken: list[str]) -> None:
    with pytest.raises(gr.BackendUnavailable, match=r"opencl:0 .*cannot build the kernel \w+: .*undeclared.*missing"):
        gr.regularize(F0, GRID, backend="opencl:0")
    assert len(broken) == 1
    assert backends.why_auto().count("left out") == 1


def test_the_first_lines_of_a_log() -> None:
    said = "clBuildProgram failed: BUILD_PROGRAM_FAILURE - x\n\nBuild on <pyopencl.Device 'a GPU'>:\n\n"
    assert failures.first_lines(said) == "clBuildProgram failed: BUILD_PROGRAM_FAILURE - x"
    log = said + "warning: no matter\na.cl:1:3: error: no such type\n  float5 x;\n  ^\nfurther\n"
    assert failures.first_lines(log) == "a.cl:1:3: error: no such type; float5 x;; ^"
    assert failures.first_lines(said + "the driver has no compiler") == "the driver has no compiler"
    assert failures.first_lines("\n") == "the compiler says nothing"


def test_warp_cannot_compile(monkeypatch: pytest.MonkeyPatch, nothing_failed: None) -> None:
    pytest.importorskip("warp", reason="Warp is not installed")
    from gpureg.backends.warp import pool

    def refuse(*args, **options):
        raise RuntimeError("NVRTC: error: no room")

    pool.compiled.cache_clear()
    monkeypatch.setattr(pool.wp, "load_module", refuse)
    with pytest.raises(gr.BackendUnavailable, match=r"warp:cpu .*cannot build the kernel \w+: .*no room"):
        gr.regularize(F0, GRID, backend="warp:cpu")


@pytest.mark.parametrize("asked", ["", "1"])
def test_compilers_are_quiet(asked: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A driver's remarks on a build that succeeds are for who asks for them."""
    cl = pytest.importorskip("pyopencl", reason="OpenCL is not installed")
    from gpureg.backends.opencl import failing

    class Program:
        def __init__(self, *args):
            pass

        def build(self, options):
            warnings.warn("Build succeeded, but said: remark", cl.CompilerWarning, stacklevel=1)
            return options

    monkeypatch.setattr(failing.cl, "Program", Program)
    monkeypatch.setenv("PYOPENCL_COMPILER_OUTPUT", asked)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        assert failing.built(None, "", ["-DM=1"]) == ["-DM=1"]
    assert len(said) == bool(asked)
