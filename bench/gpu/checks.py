"""Every primitive of a device against numpy in float64: the problems and bounds of the tests."""

from __future__ import annotations

import time
from typing import Any

from gpureg import backends
from gpureg.backends import BackendUnavailable

from ..model import of_tests


def every_primitive(device: str, until: float, quick: bool) -> dict[str, Any]:
    """How many primitives on how many problems were compared, and what was wrong.

    Parameters
    ----------
    device : str
    until : float
        The monotonic time after which no comparison begins: a GPU's driver builds each kernel.
    quick : bool
        The smallest problems alone.
    """
    of_tests("cases")
    of_tests("rows", "backends")
    held, checking = of_tests("held", "gpu"), of_tests("checking", "backends")
    rows = of_tests("primitives", "backends").ROWS
    smallest = list(held.smallest())
    pairs = smallest if quick else [*smallest, *(pair for pair in held.PAIRS if pair not in smallest)]
    wrong, left_out, compared, unable = [], 0, set(), []
    for kind, name in pairs:
        if time.monotonic() > until:
            left_out += 1
            continue
        try:
            checking.check(backends.get(device, kind.dtype), rows[name], kind.make())
            compared.add((name, kind.id))
        except BackendUnavailable as error:
            unable.append(f"{name}, {kind.id}: {error}")
        except Exception as error:  # a driver's error is a wrong result too
            wrong.append(f"{name}, {kind.id}: {type(error).__name__}: {error}"[:1000])
    primitives = {name for name, _ in compared}
    return {
        "comparisons": len(compared),
        "primitives": len(primitives),
        "not compared": sorted(set(rows) - primitives),
        "left out": left_out,
        "unable": unable,
        "wrong": wrong,
    }
