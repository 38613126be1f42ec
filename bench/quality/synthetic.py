"""Volumes and series whose clean version is known, in [0, 255]: all of it follows from seeds.

Volumes have the axes (z, y, x), series (t, y, x).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

Image = npt.NDArray[np.float64]
VOLUME = (64, 128, 128)


def _inside(distance: Image, width: float = 0.7) -> Image:
    """A soft step: 1 where the distance, in cells, is negative, 0 where it is positive."""
    return np.asarray(0.5 - 0.5 * np.tanh(distance / width))


def _drawn(shape: tuple[int, ...], points: Image, amount: Image) -> Image:
    """A grid with the points added into it, each shared out to its 8 nearest cells."""
    grid = np.zeros(shape)
    low = np.floor(points).astype(int)
    part = points - low
    for corner in np.ndindex(*(2,) * len(shape)):
        at = low + corner
        share = np.prod(np.where(corner, part, 1 - part), axis=1) * amount
        valid = np.all((at >= 0) & (at < shape), axis=1)
        np.add.at(grid, tuple(at[valid].T), share[valid])
    return grid


def head(shape: tuple[int, int, int] = VOLUME, seed: int = 0) -> Image:
    """A volume like those of magnetic resonance: shells, folded sheets, vessels, gradients, weak texture."""
    random = np.random.default_rng(seed)
    size = np.asarray(shape, float)
    z, y, x = ((axis - (n - 1) / 2) / (n / 2) for axis, n in zip(np.indices(shape).astype(float), shape, strict=True))
    # distances in cells of the mean half axis: about right for soft edges
    cell = size.mean() / 2
    radius = np.sqrt((z / 0.93) ** 2 + (y / 0.92) ** 2 + (x / 0.78) ** 2)
    angle, height = np.arctan2(y, x), z / np.maximum(radius, 0.2)
    volume = np.full(shape, 6.0)
    for outer, inner, level in ((0.98, 0.93, 150), (0.93, 0.86, 25), (0.86, 0.82, 45)):  # skin, bone, fluid
        volume += level * (_inside((radius - outer) * cell) - _inside((radius - inner) * cell))
    folds = 0.045 * np.sin(11 * angle + 4 * height) * np.cos(9 * height + 2 * angle)
    grey, white = radius - 0.80 - folds, radius - 0.68 - 2.2 * folds
    volume += 105 * _inside(grey * cell) + 45 * _inside(white * cell)
    for side in (-1, 1):  # two cavities, and two nuclei with a gradient
        cavity = np.sqrt((z / 0.28) ** 2 + ((y + 0.1) / 0.32) ** 2 + ((x - side * 0.16) / 0.09) ** 2) - 1
        volume -= 100 * _inside(cavity * 0.15 * cell)
        core = np.sqrt((z / 0.2) ** 2 + ((y - 0.28) / 0.14) ** 2 + ((x - side * 0.25) / 0.11) ** 2) - 1
        volume -= (30 + 40 * (y - 0.28)) * _inside(core * 0.13 * cell)
    volume -= 70 * _inside((np.abs(x - 0.015 * np.sin(9 * z)) - 0.012) * cell) * _inside((radius - 0.78) * cell)
    volume *= 1 + 0.12 * y - 0.1 * x * z + 0.06 * np.sin(2 * x + z)
    for _ in range(14):  # bright vessels of about a cell and a half
        curve = np.cumsum(ndimage.gaussian_filter1d(random.standard_normal((400, 3)), 40, axis=0), axis=0)
        curve = curve / np.abs(curve).max() * 0.6 + random.uniform(-0.35, 0.35, 3)
        line = _drawn(shape, (curve + 1) / 2 * (size - 1), np.linspace(1, 0.5, 400))
        share = np.minimum(ndimage.gaussian_filter(line, 0.9) * 5, 1) * _inside((radius - 0.9) * cell)
        volume += (215 - volume) * share
    texture = ndimage.gaussian_filter(random.standard_normal(shape), 1.2)
    volume += 3 * texture / texture.std() * _inside(grey * cell)
    return np.clip(ndimage.gaussian_filter(volume, 0.45), 0, 255)


def filaments(shape: tuple[int, int, int] = VOLUME, seed: int = 1) -> Image:
    """A volume like those of a fluorescence microscope: filaments, beads and nuclei; the blur along z is larger."""
    random = np.random.default_rng(seed)
    size = np.asarray(shape, float)
    axes = np.indices(shape).astype(float)
    volume = 8 + 5 * axes[1] / size[1]
    rough = ndimage.gaussian_filter(random.standard_normal(shape), 2.5)
    for _ in range(6):  # nuclei with texture
        centre, radii = random.uniform(0.15, 0.85, 3) * size, random.uniform(0.08, 0.13, 3) * size.mean()
        distance = np.sqrt(sum(((a - c) / r) ** 2 for a, c, r in zip(axes, centre, radii, strict=True)))
        volume = np.maximum(volume, (70 + 14 * rough / rough.std()) * _inside((distance - 1) * radii.mean(), 1.2))
    line = np.zeros(shape)
    steps = np.linspace(-1, 1, 700)[:, None]
    for _ in range(45):  # nearly straight curves, mostly in the plane
        way = random.standard_normal(3) * (0.35, 1, 1)
        way /= np.linalg.norm(way)
        bend = random.standard_normal(3) * 12 * (0.3, 1, 1)
        points = random.uniform(0, 1, 3) * size + steps * way * 55 + steps**2 * bend
        line += _drawn(shape, points, np.full(700, random.uniform(0.5, 1.5)))
    beads = _drawn(shape, random.uniform(0, 1, (160, 3)) * size, random.uniform(0.3, 1, 160))
    volume = volume + 230 * ndimage.gaussian_filter(line, (1.4, 0.9, 0.9))
    return np.clip(volume + 2600 * ndimage.gaussian_filter(beads, (1.6, 1, 1)), 0, 255)


def series(picture: Image, other: Image, frames: int = 20, size: int = 128) -> Image:
    """Frames of a grey picture that moves by parts of a pixel, with a disk of another that moves the other way."""
    grid = np.indices((size, size)).astype(float)
    moving = ((picture, np.array([0.4, 0.7])), (other, np.array([-0.9, 1.3])))  # rows and columns a frame
    result = np.empty((frames, size, size))
    for t in range(frames):
        since = t - (frames - 1) / 2
        moved = []
        for image, speed in moving:
            corner = (np.array(image.shape) - size) / 2 + speed * since
            at = [axis + first for axis, first in zip(grid, corner, strict=True)]
            moved.append(ndimage.map_coordinates(image, at, order=3, mode="mirror"))
        centre = size / 2 - moving[1][1] * since
        disk = _inside(np.hypot(grid[0] - centre[0], grid[1] - centre[1]) - size / 5)
        result[t] = moved[0] + (moved[1] - moved[0]) * disk
    return np.clip(result, 0, 255)


def microscope(seed: int, side: int = 512) -> Image:
    """Photons that are expected of cells with texture on a dark ground, from 3 to some hundred; not in [0, 255]."""
    random, (y, x) = np.random.default_rng(seed), np.indices((side, side))
    light = np.full((side, side), 3.0)
    for _ in range(40):
        (cy, cx), reach = random.uniform(0, side, 2), random.uniform(8, 25)
        light += random.uniform(20, 150) / (1 + np.exp(np.minimum(8 * (np.hypot(y - cy, x - cx) / reach - 1), 50)))
    texture = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal((side, side)), 1.5)
    return light * (1 + 0.1 * texture / texture.std())
