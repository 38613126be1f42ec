"""OpenCL's own concerns: pack widths, and the launches a GPU gets, tried on the CPU drivers that are here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import EPS, fidelity, function, graph, weights

from gpureg import backends

ORACLE = backends.get("numpy", np.float64)


def drivers() -> list[backends.Device]:
    return [device for device in backends.devices() if device.backend == "opencl"]


@pytest.mark.parametrize(("width", "kind"), [(1, "gpu"), (2, "cpu"), (4, "cpu")])
@pytest.mark.parametrize("name", ["grid", "volume", "csr"])
def test_every_pack_width_computes_the_same(width: int, kind: str, name: str) -> None:
    """A GPU takes packs of 1 and rounds its launches up to whole work groups: both must leave no trace."""
    if not drivers():
        pytest.skip(backends.absent()["opencl"])
    from gpureg.backends import opencl

    backend = opencl.make(replace(drivers()[0], vector_width=width, kind=kind), np.float32)
    made, f, f0 = graph(name), function(graph(name)), function(graph(name), seed=13)
    lam = fidelity(made)
    form = backends.PatchForm(np.ones(1), shift=0.01, scale=2.0)

    def results(b: backends.Backend) -> dict[str, np.ndarray | float]:
        weighted = b.prepare(made, weights(name))
        F, F0, L = b.put(made, f), b.put(made, f0), b.put(made, lam)
        g = b.gradient_norm(weighted, F, power=-0.5, eps=EPS, coupled=True)
        return {
            "put": b.get(made, F),
            "degree": b.get(made, b.degree(weighted)),
            "gradient_norm": b.get(made, g),
            "p_laplacian": b.get(made, b.p_laplacian(weighted, F, g)),
            "jacobi_step": b.get(made, b.jacobi_step(weighted, F, F0, g, L)),
            "energy": b.energy(weighted, F, F0, L, p=1, eps=EPS, coupled=True),
            "max_change": b.max_change(weighted, F, F0),
            "patch_distance": b.get_weights(b.patch_distance(made, f, form)),
        }

    for (primitive, found), expected in zip(results(backend).items(), results(ORACLE).values(), strict=True):
        # The sharp bounds are test_backends.py's; a lane in the wrong place is off by the size of the values.
        assert np.abs(found - expected).max() <= 1e-5 * np.abs(expected).max(), primitive


def test_a_job_too_large_for_the_device_says_so() -> None:
    if not drivers():
        pytest.skip(backends.absent()["opencl"])
    backend = backends.get(drivers()[0].id)
    with pytest.raises(MemoryError, match="GiB at most"):
        backend._allocate(1 << 50)
