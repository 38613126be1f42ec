"""Warp as a GPU gets it: every primitive against numpy in float64, and every kernel by NVIDIA's compiler, to PTX."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import held
import pretended
import pytest
from public_calls import DOORS
from tools import need

from gpureg import backends

pytestmark = pytest.mark.skipif("warp" in backends.absent(), reason="Warp is absent")

DEVICE = "warp:cpu"
# Doors whose kernels no primitive above builds.
WARP_DOORS = ("image", "colours", "nonlocal means, averaged", "passes", "points, p = 1")
# Kernels that have private arrays, of the patch's radius: to be mended.
PRIVATE = ("patch_distance", "similarity_step")


@pytest.fixture(autouse=True, scope="module")
def _double_alone(request: pytest.FixtureRequest) -> None:
    if request.config.getoption("as_gpu") == "single":
        pytest.skip("for Warp nothing changes: CUDA has float64 and subnormal numbers")


@pytest.mark.parametrize(("kind", "name"), held.PAIRS, ids=held.IDS)
def test_primitive(kind: held.Kind | held.PatchKind, name: str) -> None:
    held.hold(DEVICE, kind, name)


@pytest.mark.parametrize("name", WARP_DOORS)
def test_door(name: str) -> None:
    DOORS[name](DEVICE)


def private_bytes(module: Any, folder: Path) -> tuple[str, int]:
    """A module's kernels, and the bytes of private arrays in the PTX of one of them."""
    import warp as wp

    wp.compile_aot_module(module, arch=80, module_dir=folder, use_ptx=True)
    (file,) = folder.glob("*.ptx")
    ptx = file.read_text("utf-8")
    file.unlink()
    return ", ".join(module.kernels), sum(map(int, re.findall(r"__local_depot\d+\[(\d+)\]", ptx)))


def test_kernels_compile_for_cuda(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To PTX, which needs no device, and without private arrays, which lie in a GPU's memory."""
    import warp as wp

    need("nvrtc", "Warp for macOS has no compiler for CUDA" if sys.platform == "darwin" else None)
    from gpureg.kernels.warp import total

    assert len(pretended.modules) > 60
    modules = [module for module in pretended.modules.values() if "total" not in module.kernels]
    # with all of its threads, which a CPU does not run; the threads of groups: tests/backends/test_warp_groups.py
    monkeypatch.setattr(total, "GROUP", 256)
    modules += [total.make.__wrapped__(real, maximum).module for real in (wp.float32, wp.float64) for maximum in (0, 1)]
    found = [private_bytes(module, tmp_path) for module in modules]
    assert not [
        f"{kernels}: {nbytes} bytes"
        for kernels, nbytes in found
        if nbytes and not any(kernels.endswith(known) for known in PRIVATE)
    ]
