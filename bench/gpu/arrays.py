"""Arrays that lie on a device, of all libraries that are installed: the results of arrays of numpy, on the device."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import gpureg as gr
from gpureg import backends

from ..model import peer

IMAGE = (np.indices((24, 31)).sum(axis=0) % 7 + np.random.default_rng(3).normal(0, 0.2, (24, 31))).astype(np.float32)
GRID = gr.GridGraph(IMAGE.shape)

# Calls of which the first is made without the host where the data are on CUDA, with and without other units.
CALLS: dict[str, Callable[..., Any]] = {
    "regularize": lambda x, **on: gr.regularize(x, GRID, p=1, lam=2, max_iter=3, **on).value,
    "denoise_bilateral": lambda x, **on: gr.denoise_bilateral(x, radius=2, sigma_value=1.0, **on),
}


class _Interface:
    """An object that has ``__cuda_array_interface__`` alone."""

    def __init__(self, array: Any) -> None:
        self._array = array
        self.__cuda_array_interface__ = array.__cuda_array_interface__


def kinds(device: str) -> Iterator[tuple[str, Callable[[Any], Any], Callable[[Any], Any]]]:
    """Libraries with the device: a name, a function that puts numpy's array there, and one that reads a result."""
    backend, _, at = device.partition(":")
    if backend == "opencl":
        import pyopencl as cl
        import pyopencl.array as cl_array

        queue = cl.CommandQueue(cl.Context([backends.get(device).device.handle]))
        yield "pyopencl", lambda x: cl_array.to_device(queue, x), lambda x: x.get()
    if backend != "warp":
        return
    import warp as wp

    yield "warp", lambda x: wp.array(x, device=at), lambda x: x.numpy()
    if not at.startswith("cuda"):
        return
    yield "interface alone", lambda x: _Interface(wp.array(x, device=at)), lambda x: x.numpy()
    if (torch := peer("torch")) is not None and torch.cuda.is_available():
        yield "torch", lambda x: torch.from_numpy(x).to(at), lambda x: x.cpu().numpy()
    if (cupy := peer("cupy")) is not None:
        yield "cupy", lambda x: cupy.asarray(x), lambda x: x.get()


def compared(device: str) -> tuple[list[str], list[str]]:
    """Compare the results of every library with those of numpy; return the libraries, and what was wrong."""
    found, wrong = [], []
    expected = {(name, unit): call(unit * IMAGE, backend=device) for name, call in CALLS.items() for unit in (1, 64)}
    for library, put, read in kinds(device):
        found.append(library)
        for (name, unit), value in expected.items():
            try:
                # "auto" takes the device of the data, but for a CPU
                on = {} if library != "warp" or "cuda" in device else {"backend": device}
                result = read(CALLS[name](put(np.float32(unit) * IMAGE), **on))
                if not np.array_equal(result, value):
                    wrong.append(f"{name} of an array of {library}: off by {np.abs(result - value).max():g}")
            except Exception as error:  # a driver's error is a wrong result too
                wrong.append(f"{name} of an array of {library}: {type(error).__name__}: {error}"[:1000])
    return found, wrong
