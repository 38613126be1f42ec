"""Groups of patches and their step as literal loops: the specification in ``gpureg/backends/groups.py``.

As in ``paper.py``: vertices are pixels, tuples of coordinates, and a function is a dictionary over them. A patch is a
list of numbers, one for each of its cells.
"""

from __future__ import annotations

import itertools

import numpy as np
from paper import Function, reflect, rho

Pixel = tuple[int, ...]


def references(shape: Pixel, steps: Pixel) -> list[Pixel]:
    """Every step-th pixel along each axis, and the last one."""
    along = [sorted({*range(0, size, step), size - 1}) for size, step in zip(shape, steps, strict=True)]
    return list(itertools.product(*along))


def cells(radii: Pixel) -> list[Pixel]:
    """The cells of a patch, from its middle."""
    return list(itertools.product(*(range(-r, r + 1) for r in radii)))


def group(
    u: Pixel,
    guides: list[Function],
    inside: set[Pixel],
    shape: Pixel,
    patch: Pixel,
    window: Pixel,
    nearest: int,
    most: int,
    limit: float,
) -> list[Pixel]:
    """The members of u; `limit` is the mean squared difference up to which all patches belong to it."""
    if u not in inside:
        return []
    g = dict.fromkeys(cells(patch), 1.0)
    around = [tuple(a + b for a, b in zip(u, step, strict=True)) for step in cells(window)]
    d = {v: rho(u, v, guides, shape, g) for v in around if v in inside}
    smallest = sorted(d.values())[: min(nearest, len(d))]
    t = max(smallest[-1], limit * len(g) * len(guides))
    members = [v for v in sorted(d) if d[v] <= t]
    count = len(members)
    if count <= most:
        return members
    return [v for i, v in enumerate(members) if (i + 1) * most // count > i * most // count]


def patch_at(f: Function, v: Pixel, shape: Pixel, patch: Pixel) -> np.ndarray:
    """The patch of a function at v, filled by reflection."""
    places = [tuple(a + b for a, b in zip(v, j, strict=True)) for j in cells(patch)]
    return np.array([f[tuple(reflect(x, size) for x, size in zip(at, shape, strict=True))] for at in places])


def covariance(patches: list[np.ndarray]) -> np.ndarray:
    """C, of the patches of a guide; 0 for one patch."""
    mean = sum(patches) / len(patches)
    total = sum((np.outer(b - mean, b - mean) for b in patches), np.zeros((len(mean), len(mean))))
    return total / max(len(patches) - 1, 1)


def changes(
    noisy: list[np.ndarray], pilots: list[np.ndarray], variances: list[np.ndarray], largest: float = np.inf
) -> list[np.ndarray]:
    """r of every member of a group, from its patches of f0, of the guide and of the variance.

    `largest` is the ratio of trace C to the least variance above which the guide's patches are taken.
    """
    C, S = covariance(pilots), np.diag(sum(variances) / len(variances))
    if np.trace(C) > largest * np.diag(S).min():
        return [a - b for a, b in zip(noisy, pilots, strict=True)]
    mean = sum(noisy) / len(noisy)
    return [S @ np.linalg.solve(C + S, a - mean) for a in noisy]


def group_step(
    groups: list[list[Pixel]],
    f0: Function,
    guide: Function,
    variance: Function,
    shape: Pixel,
    patch: Pixel,
    largest: float = np.inf,
) -> Function:
    """The step of one channel: f0 minus the mean of r over all patches that cover a pixel, or the guide."""
    found: dict[Pixel, list[float]] = {u: [] for u in f0}
    for members in groups:
        if not members:
            continue
        patches = ([patch_at(f, v, shape, patch) for v in members] for f in (f0, guide, variance))
        for v, r in zip(members, changes(*patches, largest), strict=True):
            for j, value in zip(cells(patch), r.tolist(), strict=True):
                at = tuple(a + b for a, b in zip(v, j, strict=True))
                if at in found:
                    found[at].append(value)
    return {u: f0[u] - sum(each) / len(each) if each else guide[u] for u, each in found.items()}
