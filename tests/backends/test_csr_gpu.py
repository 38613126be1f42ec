"""Stored graphs as a GPU takes them, in slices of rows or by teams of work items, on one OpenCL driver."""

from __future__ import annotations

import time
from typing import Any

import cases
import pytest
import rows as _  # fills ROWS
from checking import as_gpu, check
from primitives import ROWS
from problems import GENERAL, Kind

pytestmark = pytest.mark.one_driver

VERTEX = ("degree", "largest_weight", "gradient_norm", "p_laplacian", "jacobi_step", "euler_step", "gradient")
EDGES = ("difference", "adjoint", "primal", "dual_step")


@pytest.mark.parametrize("team,piece,graph", [(1, 4, "csr"), (8, 8, "csr"), (32, 64, "csr"), (0, 0, "csr of grid")])
@pytest.mark.parametrize("name", VERTEX + EDGES + ("energy", "duality_gap", "patch_distance"))
def test_one(device, monkeypatch, team, piece, graph, name):
    if not device.startswith("opencl"):
        pytest.skip()
    if name == "patch_distance":
        return
    from gpureg.backends.opencl import rows as r

    if team:
        monkeypatch.setattr(r, "_TEAMS", ((0, team),))
        monkeypatch.setattr(r, "_TRIPS", 0)
        monkeypatch.setattr(r, "_LEAST_PIECE", piece)
        monkeypatch.setattr(r, "_ROOM", 0)
    backend = as_gpu(device, "float32", monkeypatch)
    backend._options += ("-cl-opt-disable",)
    for kind in (Kind(cases.Setup(graph, 3, coupled=False), classes=GENERAL), Kind(cases.Setup(graph), directed=True, classes=GENERAL)):
        t = time.time()
        check(backend, ROWS[name], kind.make())
        print(name, kind.id, time.time() - t, len(backend._shared.kernels))
    print({k[0]: [o for o in k[1] if "TEAM" in o or "SLI" in o or "HUB" in o or "SPL" in o] for k in backend._shared.kernels if "-cl-opt-disable" in k[1]})
