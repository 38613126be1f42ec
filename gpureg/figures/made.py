"""Generated shapes, the default inputs of the figures, as the shapes of the paper are not free."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray

# Ellipsoids of an animal: centres and half axes, x to the side, y up, z to the front.
_BALLS = (
    ((0, 0, 0), (0.75, 0.7, 1.0)),  # body
    ((0, -0.15, -0.35), (0.85, 0.7, 0.7)),  # hips
    ((0, 0.75, 0.85), (0.42, 0.42, 0.5)),  # head
    ((0.24, 1.45, 0.6), (0.13, 0.6, 0.2)),  # ears
    ((-0.24, 1.45, 0.6), (0.13, 0.6, 0.2)),
    ((0.5, -0.65, 0.3), (0.25, 0.18, 0.6)),  # feet
    ((-0.5, -0.65, 0.3), (0.25, 0.18, 0.6)),
    ((0, 0.1, -1.1), (0.27, 0.27, 0.27)),  # tail
)
# Sharpness of their union: larger gives deeper folds between them.
_SHARP = 12.0


def animal(side: int) -> tuple[FloatArray, IntArray]:
    """Generate a closed smooth surface with thin parts, like the bunny of the paper; `side` voxels per unit."""
    from skimage.measure import marching_cubes

    from ..meshes.denoise import denoise_mesh
    from ..solvers import Jacobi

    low, high = np.array([-1.1, -1.1, -1.6]), np.array([1.1, 2.25, 1.6])
    count = np.round((high - low) * side).astype(int)
    axes = np.meshgrid(*(np.linspace(a, b, n) for a, b, n in zip(low, high, count, strict=True)), indexing="ij")
    x = np.stack(axes, axis=-1)
    # a smooth union: the sum of exp(-k d) over the ellipsoids, d the approximate distance
    total = np.zeros(x.shape[:3])
    for middle, half in _BALLS:
        radii = np.asarray(half)
        r = np.linalg.norm((x - middle) / radii, axis=-1)
        total += np.exp(-_SHARP * (r - 1) * radii.min())
    step = (high - low) / (count - 1)
    vertices, faces, _, _ = marching_cubes(np.log(total), 0.0, spacing=tuple(step))
    # two iterations of the mean of the neighbours remove slivers of marching cubes, with edges of almost no length
    mesh = (vertices.astype(np.float64) + low, faces[:, ::-1].astype(np.int64))
    found: tuple[FloatArray, IntArray] = denoise_mesh(
        mesh, filter="positions", lam=0, max_iter=2, tol=None, solver=Jacobi(damping=1), backend="numpy"
    )
    return found


def bracket(cells: int) -> tuple[FloatArray, IntArray]:
    """Generate a machine part with creases and a hole, `cells` squares of two triangles along its shortest side."""
    n = cells
    solid = np.zeros((4 * n, 3 * n, 2 * n), bool)
    solid[:, :n] = True
    solid[:n] = True
    solid[2 * n : 3 * n, :n, n // 2 : 3 * n // 2] = False
    return _skin(solid)


def _skin(solid: npt.NDArray[np.bool_]) -> tuple[FloatArray, IntArray]:
    """Return the surface of voxels (x, y, z): vertices (n, 3) without duplicates, faces (m, 3) oriented outwards."""
    padded = np.pad(solid, 1)
    quads = []
    for axis in range(3):
        # the two other axes, in the order that makes a quad counterclockwise seen from the end of this one
        unit = np.eye(3, dtype=int)
        a, b = unit[(axis + 1) % 3], unit[(axis + 2) % 3]
        for outwards in (1, -1):
            bare = padded & ~np.roll(padded, -outwards, axis)
            corner = np.argwhere(bare) - 1 + (unit[axis] if outwards == 1 else 0)
            around = (0 * a, a, a + b, b) if outwards == 1 else (0 * a, b, a + b, a)
            quads.append(np.stack([corner + step for step in around], axis=1))
    corners = np.concatenate(quads)
    vertices, which = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    q = which.reshape(-1, 4)
    return vertices.astype(np.float64), np.concatenate([q[:, [0, 1, 2]], q[:, [0, 2, 3]]])


def coast(n: int) -> FloatArray:
    """Generate a closed curve (n, 2) with waves of several lengths, like a coast."""
    random = np.random.default_rng(7)
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    waves = np.zeros(n)
    for k, amplitude in ((2, 0.2), (5, 0.1), (13, 0.05), (31, 0.03)):
        waves += amplitude * np.cos(k * angle + random.uniform(0, 2 * np.pi))
    points: FloatArray = (1 + waves)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return points
