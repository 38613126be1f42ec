"""Nothing is done twice: calls that differ in p, lam or data alone build no kernel, and upload data alone."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from cases import rng

import gpureg as gr
from gpureg import backends


def test_import_leaves_the_heavy_libraries_alone() -> None:
    """Their start would take most of the time that `import gpureg` has."""
    heavy = "warp pyopencl scipy.ndimage scipy.sparse matplotlib PIL rich networkx skimage"
    code = f"import sys, gpureg; print([name for name in {heavy.split()!r} if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.fixture
def counted(device: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, list]:
    """Kernels built, and sizes of host arrays brought up."""
    seen: dict[str, list] = {"builds": [], "uploads": []}
    backend = backends.get(device)
    if device == "numpy":
        pytest.skip("numpy builds and uploads nothing")
    if device.startswith("opencl"):
        from gpureg.backends.opencl import failing as opencl

        program, copied = opencl.cl.Program, opencl.cl.enqueue_copy

        def copy(queue, target, source, **options):
            if isinstance(source, np.ndarray):
                seen["uploads"].append(source.size)
            return copied(queue, target, source, **options)

        monkeypatch.setattr(opencl.cl, "Program", lambda *a: seen["builds"].append(a) or program(*a))
        monkeypatch.setattr(opencl.cl, "enqueue_copy", copy)
    else:
        upload = backend.upload
        monkeypatch.setattr(backend, "upload", lambda x, *a: seen["uploads"].append(x.size) or upload(x, *a))
        from gpureg.backends.warp import primitives as warp

        load = warp.wp.load_module
        monkeypatch.setattr(warp.wp, "load_module", lambda *a, **b: seen["builds"].append(a) or load(*a, **b))
    return seen


@pytest.mark.parametrize("stored", [False, True])
def test_a_graph_goes_up_once(device: str, counted: dict[str, list], stored: bool) -> None:
    """On the same graph with weights of its own: the data, and what is made of them."""
    grid = gr.GridGraph((21, 23))
    n, graph = grid.n_vertices, grid.to_graph() if stored else grid
    settings = {"backend": device, "max_iter": 2}
    gr.regularize(rng(3).random(n), graph, p=1.5, lam=0.5, **settings)
    counted["builds"].clear()
    counted["uploads"].clear()
    gr.regularize(rng(5).random(n), graph, p=1.7, lam=0.25, **settings)
    assert counted["builds"] == []
    # data and start; on OpenCL's grids with their guards
    assert len(counted["uploads"]) == 2
    assert all(n <= size < 3 * n for size in counted["uploads"])


def test_images_build_once_and_upload_little_but_data(device: str, counted: dict[str, list]) -> None:
    """The door makes its grid anew at each call: its few offsets are all that goes up besides the picture."""
    shape = (61, 67)
    n = shape[0] * shape[1]

    def call(seed: int, p: float, lam: float) -> None:
        image = rng(seed).random(shape, dtype=np.float32)
        gr.denoise_image(image, p=p, lam=lam, weights=gr.weights.constant(), max_iter=2, backend=device)
        gr.denoise_image(image, lam=lam, radius=2, weights=gr.weights.bilateral(2.0, 0.2 + p), backend=device)

    call(3, 1.5, 0.5)
    counted["builds"].clear()
    counted["uploads"].clear()
    call(5, 1.7, 0.25)
    assert counted["builds"] == []
    small = [size for size in counted["uploads"] if size < n]
    assert sum(small) < 500
    # data and start of the process, and the picture of the filter, which OpenCL on a CPU reads where it is
    assert len(counted["uploads"]) - len(small) == (2 if device.startswith("opencl") else 3)
