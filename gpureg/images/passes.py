"""Passes on groups of similar patches, the part of a plan that follows its filter: :class:`PatchPass`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from ..backends.groups import GroupForm
from ..frame import Frame
from ..noise.photon import PhotonNoise
from ..regularization.tiling import Tile

Quality = Literal["fast", "balanced", "best"]
QUALITIES: tuple[Quality, ...] = ("fast", "balanced", "best")


@dataclass(frozen=True)
class PatchPass:
    """A pass that estimates the patches of each group of similar patches together, and averages them.

    Attributes
    ----------
    patch_radius, radius : tuple of int
        Radii of a patch, and of the window in which similar patches are looked for, along each axis, in cells.
    step : tuple of int
        A group is found for every step-th cell along an axis, and for the last one.
    nearest : int
        Number of most similar patches that always belong to a group.
    most : int
        Number of patches that a group has at most.
    flat : float, default 0.15
        All patches whose root mean square difference is at most this, in multiples of the noise, belong to the group.
    """

    patch_radius: tuple[int, ...]
    radius: tuple[int, ...]
    step: tuple[int, ...]
    nearest: int
    most: int
    flat: float = 0.15

    def form(self, sigma: float) -> GroupForm:
        """Return the form of the groups for noise of this standard deviation."""
        return GroupForm(self.patch_radius, self.radius, self.step, self.nearest, self.most, (self.flat * sigma) ** 2)

    @property
    def reach(self) -> tuple[int, ...]:
        """Distance along each axis, in cells, of the cells on which a new value depends."""
        return self.form(0.0).reach

    def beyond(self, *, masked: bool) -> tuple[int, ...]:
        """Return :attr:`reach`; where a mask leaves cells out, they take values up to half a patch's diagonal away."""
        return tuple(reach + masked * math.isqrt(sum(r**2 for r in self.patch_radius)) for reach in self.reach)

    @property
    def block(self) -> tuple[int, ...]:
        """Parts of a grid that begin at multiples of these sides have the bits of the whole."""
        return tuple(2 * side for side in self.form(0.0).block)


@dataclass(frozen=True)
class PassNoise:
    """The noise that passes on groups remove.

    Attributes
    ----------
    level : float
        Standard deviation in the units in which channels are compared.
    frame : Frame
        The offset and the unit of the values with which a pass computes.
    units : tuple of float
        What the channels are divided by for the passes alone, if :attr:`DenoisePlan.units` are 1; empty for 1.
    photon : tuple of (PhotonNoise or None)
        For each channel how the noise grows with the signal, if it does; empty for none.
    profile : (n,) array or None
        Noise of each pixel as a multiple of `level`, if it was given as a map.
    """

    level: float
    frame: Frame
    units: tuple[float, ...] = ()
    photon: tuple[PhotonNoise | None, ...] = ()
    profile: npt.NDArray[np.float64] | None = field(default=None, compare=False, repr=False)

    def part_of(self, shape: tuple[int, ...], tile: Tile) -> PassNoise:
        """Return the noise of a part of an image of this shape: a map is cut as the image is."""
        if self.profile is None:
            return self
        return replace(self, profile=self.profile.reshape(shape)[tile.wide].ravel())


def passes_for(quality: Quality, count: int | None, axes: int) -> tuple[PatchPass, ...]:
    """Return the passes for a word and a number, which counts the filter before them; None means the word's number."""
    known = _TABLE[axes][_WITH_PASSES[quality]]
    if count is None:
        return () if quality == "fast" else known
    return known[len(known) - (count - 1) :]


def many(passes: Sequence[PatchPass]) -> str:
    """Return how many passes there are, in words."""
    return "1 pass" if len(passes) == 1 else f"{len(passes)} passes"


def patches_of(passes: Sequence[PatchPass]) -> str:
    """Describe the patches of all passes, and how often a group is found."""
    kinds = [f"{_sides(each.patch_radius)} every {_each(each.step)}" for each in passes]
    return f"{', '.join(kinds)} pixels" if passes else "none"


def windows_of(passes: Sequence[PatchPass]) -> str:
    """Describe the windows of all passes."""
    return f"window {' and '.join(dict.fromkeys(_sides(each.radius) for each in passes))}"


def _sides(radii: Sequence[int]) -> str:
    return "x".join(str(2 * r + 1) for r in radii)


def _each(steps: Sequence[int]) -> str:
    return str(steps[0]) if len(set(steps)) == 1 else "x".join(map(str, steps))


def _picture(step: int) -> tuple[PatchPass, ...]:
    """Return the passes for pictures.

    The second pass takes twice as many members where there are more than it needs: with 64 it left some of the first
    pass's noise in smooth areas, 0.5 dB at sigma 40 on a picture of a cell.
    """
    return (
        PatchPass((2, 2), (19, 19), (step,) * 2, 25, 48),
        PatchPass((3, 3), (19, 19), (step,) * 2, 45, 128),
    )


def _volume(radius: tuple[int, ...], steps: tuple[tuple[int, ...], ...]) -> tuple[PatchPass, ...]:
    """Return the passes for volumes and series, the same for both: the patches of the second are larger in a plane."""
    first = PatchPass((1, 1, 1), radius, steps[0], 30, 64, 0.2)
    return first, PatchPass((1, 2, 2), radius, steps[1], 40, 128, 0.2)


# The passes for each number of axes and each word; the last ones are made if fewer are asked for.
_TABLE: dict[int, dict[Quality, tuple[PatchPass, ...]]] = {
    2: {"balanced": _picture(6), "best": _picture(4)},
    3: {
        "balanced": _volume((7, 7, 7), ((3, 3, 3), (3, 4, 4))),
        "best": _volume((7, 7, 7), ((2, 2, 2), (2, 4, 4))),
    },
}
# The numbers of axes with passes.
AXES = tuple(_TABLE)
# The word whose passes are made if passes are asked for.
_WITH_PASSES: dict[Quality, Quality] = {"fast": "balanced", "balanced": "balanced", "best": "best"}
