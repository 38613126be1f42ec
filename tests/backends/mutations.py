"""Wrong kernels on purpose: one change in a source that the tests must notice.

OpenCL C is changed as text before it is compiled. A Warp kernel is a Python module, loaded again from a changed copy;
a method of the numpy backend is a function, compiled again from its changed source. What is changed is there once.
"""

from __future__ import annotations

import copy
import dataclasses
import importlib.util
import inspect
import itertools
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

from gpureg import backends, kernels

_count = itertools.count()


@dataclasses.dataclass(frozen=True)
class Mutation:
    """A change of a source file, or for numpy of a function, from what is right to what is wrong."""

    primitive: str
    where: str
    right: str
    wrong: str

    @property
    def id(self) -> str:
        """A name for pytest."""
        return f"{self.primitive}-{self.where}-{self.right}".replace("\n", " ")[:60]


def _changed(source: str, mutation: Mutation) -> str:
    assert source.count(mutation.right) == 1, f"{mutation.right} is {source.count(mutation.right)} times there"
    return source.replace(mutation.right, mutation.wrong)


def opencl(mutation: Mutation, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The first OpenCL device, with one of its kernel files changed."""
    if "opencl" in backends.absent():
        pytest.skip(backends.absent()["opencl"])
    backend = copy.copy(backends.get("opencl"))
    own = (kernels.folder / "opencl" / f"{mutation.where}.cl").read_text("utf-8")
    _changed(own, mutation)
    original = kernels.opencl_source
    # a store of compiled kernels of its own, so that the broken one stays here
    backend._shared = dataclasses.replace(backend._shared, kernels={})
    monkeypatch.setattr(kernels, "opencl_source", lambda stem: original(stem).replace(mutation.right, mutation.wrong))
    return backend


def warp(mutation: Mutation, monkeypatch: pytest.MonkeyPatch, folder: Path) -> Any:
    """Warp on the CPU, with one of its kernel files changed, and the primitive's own file made with that."""
    if "warp" in backends.absent():
        pytest.skip(backends.absent()["warp"])
    package = importlib.import_module("gpureg.kernels.warp")
    for stem in dict.fromkeys((mutation.where, mutation.primitive)):
        if not (kernels.folder / "warp" / f"{stem}.py").exists():
            continue  # made of several primitives, of which one is changed
        source = (kernels.folder / "warp" / f"{stem}.py").read_text("utf-8")
        if stem == mutation.where:
            source = _changed(source, mutation)
        path = folder / f"{stem}.py"
        path.write_text(source, "utf-8")
        spec = importlib.util.spec_from_file_location(f"gpureg.kernels.warp.{stem}_broken_{next(_count)}", path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, spec.name, module)  # where Warp looks for the source
        spec.loader.exec_module(module)
        for user in ("layout", "primitives", "duality", "patches", "sums", "zones"):
            used = importlib.import_module(f"gpureg.backends.warp.{user}")
            if hasattr(used, stem):
                monkeypatch.setattr(used, stem, module)
        if stem != mutation.primitive:
            monkeypatch.setattr(package, stem, module)
    return copy.copy(backends.get("warp:cpu"))


def numpy(mutation: Mutation, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The oracle with a method changed, or a function "module:name" of `gpureg.backends.numpy`."""
    from gpureg.backends import get

    oracle = copy.copy(get("numpy", "float64"))
    name = mutation.where.rpartition(":")[2]
    module, _, _ = mutation.where.rpartition(":")
    owner: Any = importlib.import_module(f"gpureg.backends.numpy.{module}") if module else type(oracle)
    original = getattr(owner, name)
    source = _changed(textwrap.dedent(inspect.getsource(original)), mutation)
    found: dict[str, Any] = {}
    exec(compile(source, "<mutation>", "exec"), original.__globals__, found)
    if module:
        monkeypatch.setattr(owner, name, found[name])
        return oracle
    oracle.__class__ = type("Broken", (type(oracle),), {name: found[name]})
    return oracle
