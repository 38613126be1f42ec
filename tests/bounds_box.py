"""How far a device may be from the last term of the duality gap in a box; ``bounds.py`` has the other primitives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gpureg.arrays import FloatArray

DIVISION = 5  # in units of u, as in bounds.py


def in_box(
    gamma: Callable[[Any], Any],
    f: FloatArray,
    s: FloatArray,
    s_off: FloatArray,
    f0: FloatArray,
    lam: FloatArray,
    nothing: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """The last term of the gap in a box, and its error apart from that of the term without a box, which is added.

    Without data it is s times a distance. With data where fhat is at an end: a product of a distance, and a sum of
    three terms. Where the device takes the other form, the ends are as near as s/lam is off.
    """
    width = np.where(s > 0, f - low, high - f)
    without = np.abs(s) * width
    without_off = s_off * np.maximum(f - low, high - f) + gamma(3) * without
    nearest = np.clip(f0 - s / lam, low, high)
    apart = np.abs(f - nearest)
    parts = lam / 2 * apart + np.abs(s) + lam * np.abs(nearest - f0)
    found = apart * np.abs(lam / 2 * (f - nearest) + s + lam * (nearest - f0))
    near = s_off / lam + gamma(DIVISION + 2) * (np.abs(f0) + np.abs(s) / lam)
    at_end = np.abs(nearest - (f0 - s / lam)) > 0
    found_off = np.where(at_end, apart * (s_off + gamma(6) * parts), 0) + lam * near**2
    return np.where(nothing, without, found), np.where(nothing, without_off, found_off)
