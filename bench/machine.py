"""What the machine is, and how fast it copies and multiplies: the bounds of the table."""

from __future__ import annotations

import datetime
import os
import platform
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

import gpureg as gr
from gpureg import backends

from .model import peer

# A kernel of the multiply-add rate lasts at least this long.
SHORTEST = 0.02

# Chains that do not wait for each other: a multiply-add takes 4 cycles, and two are started in each.
CHAINS = 8
STEPS = 512

OPENCL = """
typedef float VECTOR __attribute__((ext_vector_type(WIDTH)));

__kernel void copy(__global const VECTOR *a, __global VECTOR *b) {
    size_t i = get_global_id(0);
    b[i] = a[i];
}

__kernel void triad(__global const VECTOR *a, __global const VECTOR *b, __global VECTOR *c) {
    size_t i = get_global_id(0);
    c[i] = a[i] + b[i];
}

__kernel void multiply_add(float s, float t, __global float *out) {
    VECTOR x[CHAINS], a = s, b = t;
    #pragma unroll
    for (int k = 0; k < CHAINS; k++)
        x[k] = a * (float)(get_global_id(0) + k);
    for (int i = 0; i < STEPS; i++) {
        #pragma unroll
        for (int k = 0; k < CHAINS; k++)
            x[k] = mad(x[k], a, b);
    }
    VECTOR sum = 0;
    #pragma unroll
    for (int k = 0; k < CHAINS; k++)
        sum += x[k];
    float total = 0;
    union { VECTOR v; float f[WIDTH]; } lanes;
    lanes.v = sum;
    for (int k = 0; k < WIDTH; k++)
        total += lanes.f[k];
    out[get_global_id(0)] = total;
}
"""


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def best(work: Callable[[], Any], repeats: int) -> float:
    """Least seconds after a warm-up."""
    work()
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def host_bounds(quick: bool, repeats: int) -> dict[str, float]:
    """Bytes per second of copy and sum (a = b + c) by numpy in float32, and operations per second of its matmul.

    The sum moves what a STREAM triad moves, three arrays, and stands for it: numpy has no fused a = b + s c. A ufunc of
    numpy runs on one thread and lets others run meanwhile, so a small pool shares the arrays out.
    """
    n = 1 << 24 if quick else 1 << 26
    a, b, c = (np.full(n, value, np.float32) for value in (0, 1, 2))

    def copy(begin: int, end: int) -> None:
        np.copyto(a[begin:end], b[begin:end])

    def triad(begin: int, end: int) -> None:
        np.add(b[begin:end], c[begin:end], out=a[begin:end])

    found = {"array_bytes": float(a.nbytes)}
    for name, work, arrays in (("copy", copy, 2), ("triad", triad, 3)):
        for threads in sorted({1, cores()}):
            edges = [n * k // threads for k in range(threads + 1)]
            with ThreadPoolExecutor(threads) as pool:
                seconds = best(lambda: list(pool.map(work, edges[:-1], edges[1:])), repeats)  # noqa: B023
            found[f"{name}_{threads}"] = arrays * a.nbytes / seconds
        found[name] = max(found[f"{name}_{threads}"] for threads in {1, cores()})
    size = 512 if quick else 2048
    x, y = np.random.default_rng(3).random((2, size, size), dtype=np.float32)
    found["rate"] = 2.0 * size**3 / best(lambda: x @ y, repeats)
    return found


def opencl_bounds(device: Any, quick: bool, repeats: int) -> dict[str, float]:
    """Copy, triad and multiply-adds of an OpenCL device, as :func:`bounds` has them."""
    import pyopencl as cl

    context = cl.Context([device.handle])
    queue = cl.CommandQueue(context)
    gpu = device.kind == "gpu"

    def kernels(width: int) -> Any:
        options = [f"-DWIDTH={width}", f"-DCHAINS={CHAINS}", f"-DSTEPS={STEPS}"]
        return cl.Program(context, OPENCL).build(options=options)

    # 4 numbers to a work item let a GPU's neighbours read side by side; a CPU takes its whole vector.
    width = 4 if gpu else device.vector_width
    n = min(1 << (24 if quick else 26), device.handle.max_mem_alloc_size // 4, device.memory // 32)
    n -= n % (width * 256)
    a, b, c = (cl.Buffer(context, cl.mem_flags.READ_WRITE, 4 * n) for _ in range(3))
    for buffer in (a, b, c):
        cl.enqueue_fill_buffer(queue, buffer, np.float32(1), 0, 4 * n)
    program = kernels(width)

    def timed(kernel: Any, size: int, *args: Any) -> float:
        def work() -> None:
            kernel(queue, (size,), None, *args)
            queue.finish()

        return best(work, repeats)

    def copied() -> None:
        cl.enqueue_copy(queue, b, a)
        queue.finish()

    copy, triad = cl.Kernel(program, "copy"), cl.Kernel(program, "triad")
    found = {
        "copy": 8.0 * n / min(timed(copy, n // width, a, b), best(copied, repeats)),
        "triad": 12.0 * n / timed(triad, n // width, a, b, c),
    }
    # 16 numbers to a work item on a GPU too: more independent chains.
    width = 16 if gpu else device.vector_width
    multiply_add = cl.Kernel(kernels(width), "multiply_add")
    items, seconds = 1024, 0.0
    while True:
        out = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, 4 * items)
        seconds = timed(multiply_add, items, np.float32(0.999), np.float32(0.001), out)
        if seconds >= SHORTEST or items >= 1 << 24:
            break
        items *= 4
    found["rate"] = 2.0 * items * CHAINS * STEPS * width / seconds
    return found


def bounds(quick: bool, repeats: int) -> dict[str, dict[str, float]]:
    """Copy and triad in bytes per second, multiply-adds in operations per second, by device and of the "host".

    Also "memory", the larger of copy and triad. CPU devices share the best that was measured on the CPU by any of them:
    it is one machine. A GPU counts by itself. A number that could not be measured is missing.
    """
    host = host_bounds(quick, repeats)
    found: dict[str, dict[str, float]] = {"host": host}
    listed = backends.devices()
    for device in listed:
        try:
            if device.backend == "opencl":
                found[device.id] = opencl_bounds(device, quick, repeats)
            elif device.backend == "warp" and device.kind == "gpu":
                from .warp_bounds import measure

                found[device.id] = measure(device.handle, quick, repeats, best, SHORTEST)
            else:
                found[device.id] = {}
        except Exception as error:  # a driver that cannot do this must not take the table down
            print(f"{device.id}: no bounds, {type(error).__name__}: {error}", file=sys.stderr)
            found[device.id] = {}
    cpus = ["host", *(device.id for device in listed if device.kind == "cpu")]
    for names in (cpus, *([device.id] for device in listed if device.kind != "cpu")):
        memory = [found[name][work] for name in names for work in ("copy", "triad") if work in found[name]]
        rate = [found[name]["rate"] for name in names if "rate" in found[name]]
        for name in names:
            found[name] |= {"memory": max(memory)} if memory else {}
            found[name] |= {"best_rate": max(rate)} if rate else {}
    return found


def describe() -> dict[str, Any]:
    """What the numbers were measured on and with."""
    versions = {"gpureg": gr.__version__, "python": platform.python_version()}
    for module, package in (("numpy", "numpy"), ("scipy", "scipy"), ("pyopencl", "pyopencl"), ("warp", "warp-lang")):
        try:
            versions[module] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[module] = "not installed"
    for module, package in (("opencv", "cv2"), ("scikit-image", "skimage"), ("trimesh", "trimesh")):
        found = peer(package)
        versions[module] = "not installed" if found is None else found.__version__
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "cpu": _cpu(),
        "cores": cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "load_before": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "versions": versions,
        "devices": {
            device.id: f"{device.name}, {device.driver}, vectors of {device.vector_width}"
            for device in backends.devices()
        },
        "absent": backends.absent(),
    }
