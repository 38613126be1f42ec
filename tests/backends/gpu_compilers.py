"""OpenCL programs compiled for GPUs that are not here: their stack, registers and local memory.

A stack on a GPU is memory, in which a private array lies whose indices are not known to the compiler, and what has no
room in registers. clang compiles for AMD's GPUs and writes the PTX of NVIDIA's, in which private arrays show; ptxas, if
there is one, tells registers and spills as well. NVIDIA's own OpenCL compiler may decide differently.

    python tests/backends/gpu_compilers.py programs.json          a list of [primitive, [option, ...]]
"""

from __future__ import annotations

import dataclasses
import functools
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from gpureg import kernels

# A data centre's GPUs of three generations; AMD's is compiled to machine code by clang alone.
TARGETS = ("sm_80", "sm_90", "gfx90a")

_CLANGS = ("clang", *(f"clang-{version}" for version in range(25, 14, -1)))
_LIBRARIES = ("/usr/lib/clc", "/usr/share/clc", "/usr/lib/llvm-*/share/clc", "/usr/lib/llvm-*/lib/clc")
_COMMON = ("-x", "cl", "-cl-std=CL1.2", "-O3", "-Xclang", "-finclude-default-header", "-Wno-everything")
# Contraction of a * b + c, which OpenCL C allows and clang does by default in OpenCL only.
_NVIDIA = ("-target", "nvptx64--nvidiacl", "-Xclang", "-target-cpu", "-Xclang", "sm_80", "-Xclang", "-target-feature",
           "-Xclang", "+ptx72", "-ffp-contract=fast", "-mllvm", "-nvptx-prec-divf32=1")  # fmt: skip
_AMD = ("-target", "amdgcn--amdhsa", "-nogpulib", "-ffp-contract=fast")


@dataclasses.dataclass(frozen=True)
class Compiled:
    """A kernel as a compiler made it.

    Attributes
    ----------
    target : str
        The GPU, as in TARGETS.
    kernel : str
        Its name.
    stack : int
        Bytes of memory per work item for private arrays and spilled registers.
    spilled : int
        Bytes (sm_80, sm_90) or registers (gfx90a) that are spilled.
    registers : int or None
        32-bit registers of a work item; None without ptxas.
    local : int
        Bytes of local memory of a work group.
    """

    target: str
    kernel: str
    stack: int
    spilled: int
    registers: int | None
    local: int


def _clang_version(name: str) -> int:
    found = re.search(r"version (\d+)", subprocess.run([name, "--version"], capture_output=True, text=True).stdout)
    return int(found[1]) if found else 0


@functools.cache
def clang() -> str | None:
    """The name of a clang of at least version 15, or None."""
    return next((name for name in _CLANGS if shutil.which(name) and _clang_version(name) >= 15), None)


@functools.cache
def _library(file: str) -> Path | None:
    """The built-in functions of OpenCL C for a target, of libclc."""
    for pattern in _LIBRARIES:
        found = sorted(Path("/").glob(f"{pattern[1:]}/{file}"))
        if found:
            return found[-1]
    return None


def missing(target: str) -> str | None:
    """What is not here to compile for this target, or None."""
    if clang() is None:
        return "no clang of version 15 or later"
    file = "nvptx64--nvidiacl.bc" if target.startswith("sm_") else "amdgcn--amdhsa.bc"
    return None if _library(file) else f"no {file} (Debian: libclc-15-dev)"


def _run(command: Sequence[str | Path]) -> str:
    """What a compiler prints; an error that shows it if it fails."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(" ".join(str(part) for part in command) + "\n" + done.stdout + done.stderr)
    return done.stdout + done.stderr


def _clang(options: Sequence[str], library: str, source: str, to: Path) -> str:
    """The assembly that clang makes of a source."""
    own = to.with_suffix(".cl")
    own.write_text(source, "utf-8")
    bitcode = ("-Xclang", "-mlink-builtin-bitcode", "-Xclang", _library(library))
    _run([clang(), *_COMMON, *options, *bitcode, "-S", "-o", to, own])
    return to.read_text("utf-8")


def _of_ptx(target: str, ptx: str, at: Path) -> list[Compiled]:
    """The kernels of a PTX file: as ptxas makes them, or without it their private arrays."""
    local = {name: 0 for name in re.findall(r"\.entry (\w+)\(", ptx)}
    depots = [int(size) for size in re.findall(r"__local_depot\d+\[(\d+)\]", ptx)]
    if shutil.which("ptxas") is None:
        # a function that was not inlined has a depot of its own: its kernel is not known
        return [Compiled(target, name, sum(depots), 0, None, 0) for name in local]
    report = _run(["ptxas", "-v", f"-arch={target}", "-o", at.with_suffix(".cubin"), at])
    found = []
    # what is printed of functions that are not inlined counts for the kernel after which it stands
    for part in report.split("Compiling entry function ")[1:]:
        name, usage = part.split("'")[1], re.search(r"Used (\d+) registers", part)
        frames = re.findall(r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads", part)
        shared = re.search(r"(\d+) bytes smem", part)
        stack, spilled = (sum(int(frame[i]) for frame in frames) for i in (0, 1))
        assert usage and frames, report
        found.append(Compiled(target, name, stack, spilled, int(usage[1]), int(shared[1]) if shared else 0))
    return found


def _of_amd(target: str, assembly: str) -> list[Compiled]:
    """The kernels of an assembly file for an AMD GPU, by the metadata at its end."""

    def each(field: str) -> list[str]:
        return re.findall(rf"^ +(?:- )?\.{field}: +(\S+)$", assembly, re.M)

    # arguments have names, too: the name of a kernel is one of the symbols
    names = [symbol.removesuffix(".kd") for symbol in each("symbol")]
    numbers = ("private_segment_fixed_size", "vgpr_spill_count", "vgpr_count", "group_segment_fixed_size")
    rows = zip(names, *(map(int, each(field)) for field in numbers), strict=True)
    return [Compiled(target, *row) for row in rows]


def compiled(source: str, options: Sequence[str], targets: Sequence[str] = TARGETS) -> list[Compiled]:
    """Compile a program, the text of :func:`gpureg.kernels.opencl_source`, with its build options for each target.

    Options that are no definitions ("-cl-opt-disable") are left out.
    """
    defined = [option for option in options if option.startswith("-D")]
    found, ptx = [], ""
    with tempfile.TemporaryDirectory() as folder:
        at = Path(folder) / "program.ptx"
        for target in targets:
            if target.startswith("sm_"):
                ptx = ptx or _clang([*_NVIDIA, *defined], "nvptx64--nvidiacl.bc", source, at)
                found += _of_ptx(target, ptx, at)
            else:
                made = [*_AMD, f"-mcpu={target}", *defined]
                found += _of_amd(target, _clang(made, "amdgcn--amdhsa.bc", source, at.with_suffix(".s")))
    assert found, f"no kernel in\n{source}"
    return found


def compiled_primitive(primitive: str, options: Sequence[str], targets: Sequence[str] = TARGETS) -> list[Compiled]:
    """Compile a file of ``kernels/opencl`` with the build options of a backend for each target."""
    return compiled(kernels.opencl_source(primitive), options, targets)


def main(path: str) -> None:
    """Print the figures of all programs of a file; exit with 1 if one of them has a stack."""
    targets = [target for target in TARGETS if not missing(target)]
    for target in set(TARGETS) - set(targets):
        print(f"{target}: {missing(target)}")
    stacks = 0
    for primitive, options, *_ in json.loads(Path(path).read_text("utf-8")):
        for one in compiled_primitive(primitive, options, targets):
            stacks += one.stack > 0
            figures = f"{one.registers} registers, {one.local} B local, {one.stack} B stack, {one.spilled} spilled"
            print(f"{primitive:18}{one.target:8}{figures}   {' '.join(options)}", flush=True)
    print(f"{stacks} with a stack")
    sys.exit(bool(stacks))


if __name__ == "__main__":
    main(*sys.argv[1:])
