"""No data races, and nothing read or written outside of a buffer: tiny calls under Oclgrind, a simulator of a GPU."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tools import need

HERE = Path(__file__).resolve().parent
# What Oclgrind says, once a finding.
FINDINGS = ("data race", "Invalid read", "Invalid write", "divergence", "Misaligned")

RACE = """
import numpy as np, pyopencl as cl
context = cl.create_some_context(interactive=False)
queue = cl.CommandQueue(context)
source = '''__kernel void race(__global float *x) {
    __local float y[4];
    y[get_local_id(0)] = get_local_id(0);
    x[get_global_id(0)] = y[(get_local_id(0) + 1) % 4];
}'''
x = cl.Buffer(context, cl.mem_flags.READ_WRITE, 16)
cl.Kernel(cl.Program(context, source).build(), "race")(queue, (4,), (4,), x)
queue.finish()
"""


def under_oclgrind(tmp_path: Path, *command: str) -> tuple[str, str]:
    """What a Python command writes to stdout and stderr; with caches of its own, as its programs are not a driver's."""
    here = {"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": os.pathsep.join([str(HERE.parents[1]), *sys.path])}
    done = subprocess.run(
        ["oclgrind", "--data-races", sys.executable, *command], capture_output=True, text=True, env=os.environ | here
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout, done.stderr


def found(text: str) -> list[str]:
    return [line for line in text.splitlines() if any(one.lower() in line.lower() for one in FINDINGS)]


@pytest.fixture(autouse=True)
def _there(request: pytest.FixtureRequest) -> None:
    if request.config.getoption("as_gpu") == "single":
        pytest.skip("Oclgrind has float64")
    need("oclgrind", None if shutil.which("oclgrind") else "not on the path (Debian: oclgrind)")


def test_a_race_is_found(tmp_path: Path) -> None:
    _, said = under_oclgrind(tmp_path, "-c", RACE)
    assert found(said)


def test_no_primitive_has_one(tmp_path: Path) -> None:
    printed, said = under_oclgrind(tmp_path, str(HERE / "races.py"))
    assert printed.splitlines()[0] == "Oclgrind Simulator" and printed.endswith("finished\n")
    assert found(said) == []
