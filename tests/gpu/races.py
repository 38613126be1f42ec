"""Tiny calls of every primitive on the first OpenCL device, to be run under Oclgrind, which is a GPU of its own kind:

    oclgrind --data-races python tests/gpu/races.py

Oclgrind says on stderr where two work items use the same memory without a barrier between, and what reads or writes
outside of a buffer. A CPU driver runs the work items of a group in a fixed order, and hides both.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

if __name__ == "__main__":
    tests = Path(__file__).resolve().parents[1]
    sys.path[:0] = [str(tests), str(tests / "backends"), str(tests / "gpu"), str(tests.parent)]

import cases
import held
from checking import On, check_call
from primitives import ROWS
from problems import Kind, oracle
from test_groups_of_patches import Case, check

from gpureg import backends
from gpureg.backends.groups import GroupForm

DEVICE = "opencl"
GROUPS = [
    Case((11, 9), GroupForm((1, 1), (2, 3), (4, 4), 6, 10, 0.5), channels=3, masked=True),
    Case((4, 6, 5), GroupForm((1, 1, 1), (1, 2, 2), (3, 3, 3), 6, 10, 0.5)),
]
# Longer than a work group and than a row's tile.
LARGER = [(Kind(cases.Setup("grid")), "sweep"), (Kind(cases.Setup("csr")), "sweep")]
# The second call of these is another kernel.
CALLS = {"gradient_norm": 2, "jacobi_step": 2, "energy": 2, "dual_step": 2, "duality_gap": 2}


def calls() -> Iterator[tuple[str, Callable[[], None]]]:
    """What to run, and its name."""
    for kind, name in [*held.smallest(), *LARGER]:

        def call(kind=kind, name=name) -> None:
            problem, row = kind.make(), ROWS[name]
            device = On(backends.get(DEVICE, kind.dtype), problem)
            for _, one in zip(range(CALLS.get(name, 1)), row.calls(problem), strict=False):
                check_call(device, row, one)
            device.backend.check_guards()

        yield f"{name} {kind.id}", call
    for case in GROUPS:
        yield f"groups {case.id}", lambda case=case: check(case, _guarded(case.dtype), oracle())


def _guarded(dtype: str):
    from guards import guarded

    return guarded(backends.get(DEVICE, dtype))


def main() -> None:
    """Run all calls, and say so on stdout."""
    print(backends.get(DEVICE).device.name, flush=True)
    for name, call in calls():
        begin = time.perf_counter()
        call()
        print(f"{time.perf_counter() - begin:6.2f} s {name}", flush=True)
    print("finished", flush=True)


if __name__ == "__main__":
    main()
