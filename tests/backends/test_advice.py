"""What a slow machine is told: once, with what can really be installed on it."""

from __future__ import annotations

import platform
import warnings
from types import SimpleNamespace

import numpy as np
import pytest

import gpureg as gr
from gpureg.backends import advice, dispatch

GLIBC, OLD, MUSL = ("glibc", "2.36"), ("glibc", "2.31"), ("", "")
# system, processor, C library: the extras whose wheels are on PyPI (pocl 3.0, warp 1.19, pyopencl 2026.1)
MACHINES = [
    ("Linux", "x86_64", GLIBC, {"pocl", "warp", "opencl"}),
    ("Linux", "x86_64", MUSL, {"opencl"}),
    ("Linux", "aarch64", GLIBC, {"warp", "opencl"}),
    ("Linux", "aarch64", OLD, {"opencl"}),
    ("Linux", "riscv64", GLIBC, set()),
    ("Darwin", "arm64", MUSL, {"warp", "opencl"}),
    ("Darwin", "x86_64", MUSL, {"opencl"}),
    ("Windows", "AMD64", MUSL, {"warp", "opencl"}),
    ("Windows", "ARM64", MUSL, {"warp"}),
]


@pytest.mark.parametrize(("system", "machine", "libc", "extras"), MACHINES)
def test_only_what_exists_is_advised(monkeypatch, system, machine, libc, extras):
    monkeypatch.setattr(platform, "system", lambda: system)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    monkeypatch.setattr(platform, "libc_ver", lambda: libc)
    told = f"{advice.install_opencl()} {advice.driver()} {advice.faster()}"
    assert ("gpureg[pocl]" in told) == ("pocl" in extras)
    assert ("pip install 'gpureg[warp]'" == advice.install_warp()) == ("warp" in extras)
    assert ("gpureg[warp]" in told) == ("warp" in extras and "pocl" not in extras)
    assert ("compiles pyopencl" in advice.install_opencl()) == ("opencl" not in extras)
    if system == "Linux" and "pocl" not in extras:
        assert "pocl-opencl-icd" in told, "a driver of the system"


@pytest.fixture
def alone(monkeypatch):
    """A machine where only numpy computes, in a process that was told nothing."""
    monkeypatch.setattr(advice, "_state", {"fallen back": False, "told": False})
    monkeypatch.setattr(advice, "SLOW", 100)
    missing = dispatch._Probe((), "not installed")
    probes = {"numpy": dispatch._probe("numpy"), "warp": missing, "opencl": missing}
    monkeypatch.setattr(dispatch, "_probes", probes)
    monkeypatch.delenv("GPUREG_BACKEND", raising=False)
    return SimpleNamespace(large=np.eye(11), small=np.eye(10))


def test_a_slow_backend_is_said_once(alone):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gr.denoise_tv(alone.small, lam=1.0, max_iter=1)
    with pytest.warns(UserWarning, match=r"only numpy computes here, .* 121 vertices or pixels: ") as caught:
        gr.denoise_tv(alone.large, lam=1.0, max_iter=1)
    assert [each.filename for each in caught] == [__file__]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gr.denoise_tv(alone.large, lam=1.0, max_iter=1)


def test_numpy_by_name_is_no_surprise(alone):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gr.denoise_tv(alone.large, lam=1.0, max_iter=1, backend="numpy")
