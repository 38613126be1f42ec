"""What the tests of a pretended GPU have in common."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from gpureg import backends


@pytest.fixture(scope="module")
def quickly_built() -> Iterator[None]:
    """Builds without optimisation: a driver for CPUs takes 10 seconds for the loops between two barriers of a group."""
    device = "opencl:0"
    with pytest.MonkeyPatch.context() as patch:
        for dtype in ("float32", "float64") if backends.get(device).device.float64 else ("float32",):
            backend = backends.get(device, dtype)
            patch.setattr(backend, "_options", (*backend._options, "-cl-opt-disable"))
        yield
