"""Copy bandwidth and multiply-add rate of a CUDA device, measured with Warp. Warp reads the types: no future import."""

from collections.abc import Callable
from typing import Any

import warp as wp

STEPS = wp.constant(256)
CHAINS = 4


@wp.kernel
def triad(a: wp.array(dtype=wp.vec4), b: wp.array(dtype=wp.vec4), c: wp.array(dtype=wp.vec4)):
    """Write a + b into c."""
    i = wp.tid()
    c[i] = a[i] + b[i]


@wp.kernel
def multiply_add(s: float, t: float, out: wp.array(dtype=float)):
    """Four chains of vectors of 4 that do not wait for each other."""
    i = wp.tid()
    a = wp.vec4(s, s, s, s)
    b = wp.vec4(t, t, t, t)
    x = a * float(i)
    y = x + b
    z = y + b
    w = z + b
    for _ in range(STEPS):
        x = wp.cw_mul(x, a) + b
        y = wp.cw_mul(y, a) + b
        z = wp.cw_mul(z, a) + b
        w = wp.cw_mul(w, a) + b
    v = x + y + z + w
    out[i] = v[0] + v[1] + v[2] + v[3]


def measure(device: Any, quick: bool, repeats: int, best: Callable[..., float], shortest: float) -> dict[str, float]:
    """Copy and triad in bytes per second, multiply-adds in operations per second.

    Parameters
    ----------
    device : warp device
    quick : bool
        Smaller arrays.
    repeats : int
    best : callable
        Gives the least seconds of so many calls of a function.
    shortest : float
        Seconds that a kernel of the rate must last.
    """
    n = 1 << (22 if quick else 24)
    a, b, c = (wp.full(n, wp.vec4(1.0, 1.0, 1.0, 1.0), dtype=wp.vec4, device=device) for _ in range(3))

    def copied() -> None:
        wp.copy(b, a)
        wp.synchronize_device(device)

    def added() -> None:
        wp.launch(triad, dim=n, inputs=[a, b], outputs=[c], device=device)
        wp.synchronize_device(device)

    found = {"copy": 32.0 * n / best(copied, repeats), "triad": 48.0 * n / best(added, repeats)}
    items = 1024
    while True:
        out = wp.empty(items, dtype=float, device=device)

        def multiplied(items: int = items, out: Any = out) -> None:
            wp.launch(multiply_add, dim=items, inputs=[0.999, 0.001], outputs=[out], device=device)
            wp.synchronize_device(device)

        seconds = best(multiplied, repeats)
        if seconds >= shortest or items >= 1 << 26:
            break
        items *= 4
    found["rate"] = 2.0 * items * CHAINS * 4 * 256 / seconds
    return found
