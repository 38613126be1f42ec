"""OpenCL as a GPU gets it: every primitive against numpy in float64, every door once, every program for other GPUs."""

from __future__ import annotations

import os
import shutil
import subprocess
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import gpu_compilers
import held
import pretended
import pytest
from primitives import ROWS
from public_calls import DOORS
from tools import need

from gpureg import backends

pytestmark = pytest.mark.skipif("opencl" in backends.absent(), reason="OpenCL is absent")

DEVICE = "opencl:0"
# Of a work item at most, and of a work group: what every GPU has.
REGISTERS, LOCAL_BYTES = {"sm_80": 255, "sm_90": 255, "gfx90a": 512}, 48 << 10


def test_every_primitive_is_held() -> None:
    assert {name for _, name in held.PAIRS} == set(ROWS)


@pytest.mark.parametrize(("kind", "name"), held.PAIRS, ids=held.IDS)
def test_primitive(kind: held.Kind | held.PatchKind, name: str) -> None:
    held.hold(DEVICE, kind, name)


@pytest.mark.parametrize("name", DOORS)
def test_door(name: str, quickly_built: None) -> None:
    """Each public call runs; what it computes is held elsewhere."""
    if "float64" in name and not backends.get(DEVICE).device.float64:
        pytest.skip("no float64")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of tiny data
        DOORS[name](DEVICE)


def found_wrong(program: pretended.Program) -> list[str]:
    """What other compilers say against a program, sentence by sentence."""
    wrong = []
    what = f"{program.kernel} {' '.join(program.options)}"
    try:
        for one in gpu_compilers.compiled(program.source, program.options):
            private = one.stack or one.spilled or (one.registers or 0) > REGISTERS[one.target]
            if private or one.local > LOCAL_BYTES:
                wrong.append(f"{what}: {one}")
    except RuntimeError as error:
        wrong.append(f"{what}: {error}")
    return wrong


def parsed(program: pretended.Program) -> list[str]:
    """What clang says against a program for any device, without the extensions that the device did not have."""
    command = [gpu_compilers.clang() or "", "-x", "cl", "-cl-std=CL1.2", "-target", "spir64", "-fsyntax-only"]
    command += ["-Xclang", "-finclude-default-header"]
    command += ["-Wall", "-Wextra", "-Wno-unused", "-Wno-unused-parameter"]
    if not backends.get(DEVICE).device.float64:
        command += ["-Xclang", "-cl-ext=-cl_khr_fp64,-cl_khr_fp16"]
    command += [option for option in program.options if option.startswith("-D")]
    done = subprocess.run([*command, "-"], input=program.source, capture_output=True, text=True)
    # a constant such as (real)0.5 is meant to be one of float32 there
    meant = "casting to single precision"
    said = [line for line in done.stderr.splitlines() if ("warning:" in line or "error:" in line) and meant not in line]
    return [f"{program.kernel} {' '.join(program.options)}: {line}" for line in said]


def all_wrong(look: Callable[[pretended.Program], list[str]], programs: list[pretended.Program]) -> list[str]:
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return [sentence for found in pool.map(look, programs) for sentence in found]


def test_programs_compile_for_any_device() -> None:
    """For spir64; under `--as-gpu single` without float64 and float16."""
    need("clang", None if gpu_compilers.clang() else "no clang of version 15 or later")
    assert len(pretended.programs) > 60
    assert all_wrong(parsed, list(pretended.programs)) == []


def test_programs_for_gpus(request: pytest.FixtureRequest) -> None:
    """For two of NVIDIA's and one of AMD's: no stack, nothing spilled, few enough registers, 48 KiB of local memory."""
    if request.config.getoption("as_gpu") == "single":
        pytest.skip("the programs with float64 are the larger ones")
    need("clang", next(filter(None, map(gpu_compilers.missing, gpu_compilers.TARGETS)), None))
    doors = [program for program in pretended.programs if "-cl-opt-disable" in program.options]
    assert len(doors) > 60
    assert all_wrong(found_wrong, doors) == []


def test_registers_are_known() -> None:
    """Without ptxas, the programs for NVIDIA are compiled to PTX alone, which does not tell registers and spills."""
    need("ptxas", None if shutil.which("ptxas") else "not on the path")
