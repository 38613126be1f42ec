"""Denoise the slices of a picture file within a limit of memory: :class:`Work`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..files.formats import FORMATS
from ..files.pictures import Picture
from ..images.parts import joined, part_of, run_part, tiles_of, working_set
from ..images.plan import DenoisePlan
from ..images.raster import Raster
from ..model.memory import ProcessLimit, readable
from ..model.result import Result
from ..progress import progress_bar
from ..regularization.tiling import Tile
from ..weights import Weights, patch_weights
from .denoise_settings import Settings, plan_of
from .inputs import Box, Inside, Source
from .slices import Layout

Put = Callable[[Box, npt.NDArray[Any]], None]

# Bytes of a value while the noise is estimated and the parameters are chosen, measured in two and three dimensions, and
# while a run sees a whole picture.
_PLANNING, _RUNNING = 64, 24
# What a job of the command line may exceed its limit by, beside half of it: its libraries need about 170 MB.
_SLACK = 1 << 27
# Values that are looked at together for NaN and the like.
_LOOKED_AT = 1 << 22


class FileMemory:
    """The memory that a job on a file may use."""

    def __init__(self, limit: ProcessLimit, settings: Settings) -> None:
        self.limit, self._settings = limit, settings

    def too_large(self, header: Picture, target: Path) -> bool:
        """Return whether a file has to be read in parts, and can be written so."""
        if self._settings.reference is not None and not self.limit.asked:
            return False  # whole pictures are compared
        values, kind = header.pixels.size, header.pixels.dtype
        needed = values * (2 * kind.itemsize + _PLANNING)
        return needed > self.limit.bytes and FORMATS.get(target.suffix.lower()) == "TIFF"

    def expect_whole(self, header: Picture, source: Path) -> None:
        """Refuse a picture that is read as a whole and needs far more than was asked for.

        Raises
        ------
        MemoryError
        """
        kind = header.pixels.dtype
        self._expect(
            header.pixels.size * (2 * kind.itemsize + _PLANNING),
            f"{source} is read as a whole",
            "a TIFF of grey or RGB values, without alpha, to a TIFF is read in parts",
        )

    def expect_one_run(self, values: int, kind: np.dtype[Any]) -> None:
        """Refuse a run that sees a whole slice at once and needs far more than was asked for.

        Raises
        ------
        MemoryError
        """
        self._expect(
            values * (2 * kind.itemsize + _RUNNING),
            f"these settings see all {values} values of a slice at once",
            "one sweep at p = 2 needs a part at a time, and --each takes slices one by one",
        )

    def _expect(self, needed: int, what: str, instead: str) -> None:
        if self.limit.asked and needed > 1.5 * self.limit.bytes + _SLACK:
            raise MemoryError(
                f"{what}, which needs about {readable(needed)}, and {readable(self.limit.bytes)} are allowed: "
                f"give more memory; {instead}"
            )

    @property
    def sample(self) -> int:
        """The number of values from which a plan may be made."""
        return max(1 << 18, self.limit.bytes // _PLANNING)


class Work:
    """The slices of a picture, denoised one by one, each in parts that fit the memory.

    Attributes
    ----------
    parts : int
        Number of parts so far.
    notes : list of str
        What the report says of them.
    """

    def __init__(
        self,
        source: Source,
        inside: Inside,
        guide: Source | None,
        layout: Layout,
        settings: Settings,
        memory: FileMemory,
    ) -> None:
        self._source, self._inside, self._guide = source, inside, guide
        self._layout, self._settings, self._memory = layout, settings, memory
        header = source.header
        self._shape = tuple(header.size(letter) for letter in layout.grid)
        self._coloured = header.channel_axis is not None
        self._masked = self._sampled = self._own_plans = False
        self.parts, self.notes = 0, list[str]()

    def begin(self, i: int) -> bool:
        """Count the pixels of a slice that are left out, and return whether any takes part."""
        self._masked = False
        if not self._inside.needed:
            return True
        some = False
        for rows in self._blocks():
            inside = self._inside.count(self._layout.box(i, rows))
            some |= bool(inside.any())
            self._masked |= not inside.all()
        return some

    def copy(self, i: int, put: Put) -> None:
        """Write a slice as it is."""
        for rows in self._blocks():
            box = self._layout.box(i, rows)
            put(box, self._source.read(box))

    def _blocks(self) -> Iterator[tuple[slice, ...]]:
        """Yield blocks of a slice along its first axis."""
        row = math.prod(self._shape[1:]) * self._source.header.channels
        step = max(1, _LOOKED_AT // row)
        for start in range(0, self._shape[0], step):
            yield (slice(start, min(start + step, self._shape[0])),)

    def plan(self, i: int) -> DenoisePlan:
        """Choose the parameters for a slice: from all of it, or from its middle if it is not in memory."""
        values = math.prod(self._shape) * self._source.header.channels
        whole = tuple(slice(0, n) for n in self._shape)
        middle = whole
        if self._source.in_parts and values > self._memory.sample:
            middle = _middle(self._shape, self._memory.sample // self._source.header.channels)
        raster = self._raster(i, middle)
        plan = plan_of(raster, self._settings, self._layout.spacing)
        self._sampled = middle != whole
        self._own_plans = self._sampled and not _is_uniform(plan, raster.shape)
        if self._sampled:
            share = " x ".join(str(part.stop - part.start) for part in middle)
            self._note(
                f"the parameters were chosen from {share} pixels in the middle: the whole does not fit the memory"
            )
        if self._own_plans:
            self._note("parameters that depend on the place were found in each part by itself")
        return plan

    def run(self, i: int, plan: DenoisePlan, put: Put, *, progress: bool) -> Result:
        """Denoise a slice and write it; the result has no value."""
        header, run = self._source.header, self._settings.run()
        kind = Raster(header.pixels, None, header.channel_axis).computed_type(self._settings.dtype)
        tiles = tiles_of(
            plan,
            self._shape,
            header.channels,
            solver=run["solver"],
            backend=run["backend"],
            dtype=kind,
            masked=self._masked,
            memory=working_set(self._memory.limit.bytes, math.prod(self._shape) * header.channels),
        )
        if tiles is None:
            self._memory.expect_one_run(math.prod(self._shape) * header.channels, header.pixels.dtype)
            whole = tuple(slice(0, n) for n in self._shape)
            tiles = (Tile(whole, whole),)
        results = list[Result]()
        several = len(tiles) > 1
        with progress_bar(progress and several, len(tiles), "parts") as done:
            for tile in tiles:
                done(len(results))
                raster = self._raster(i, tile.wide, checked=False)
                if self._own_plans and (raster.inside is None or raster.inside.any()):
                    fitting = plan_of(raster, self._settings, self._layout.spacing)
                else:
                    fitting = plan if self._sampled or not several else part_of(plan, self._shape, tile)
                cells, guide = Raster(raster.cells, raster.inside, -1), self._compared(i, tile)
                value, result = run_part(fitting, cells, tile, guide, progress=progress and not several, **run)
                put(self._layout.box(i, tile.own), self._layout.part_back(value, header.axes))
                results.append(result)
            done(len(tiles))
        self.parts += len(tiles)
        return joined(results)

    def _compared(self, i: int, tile: Tile) -> npt.NDArray[Any] | None:
        """Read the guide's part of a tile."""
        if self._guide is None:
            return None
        return self._layout.part(self._guide.read(self._layout.box(i, tile.wide)), self._guide.header.axes)

    def _raster(self, i: int, part: tuple[slice, ...], *, checked: bool = True) -> Raster:
        """Read a part of a slice."""
        box, axes = self._layout.box(i, part), self._source.header.axes
        values = self._source.read(box)
        inside = self._inside.of(values, box) if self._masked else None
        cells = None if inside is None else self._layout.part(inside, axes.replace("C", ""))
        pixels, axis = self._layout.part(values, axes), -1 if self._coloured else None
        return Raster.of(pixels, axis, cells, axes_known=True) if checked else Raster(pixels, cells, axis)

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


def _middle(shape: tuple[int, ...], count: int) -> tuple[slice, ...]:
    """Return a block of at most `count` cells in the middle: the longest axis is halved until it fits."""
    sizes = list(shape)
    while math.prod(sizes) > count and max(sizes) > 1:
        longest = sizes.index(max(sizes))
        sizes[longest] = -(-sizes[longest] // 2)
    return tuple(slice((n - size) // 2, (n - size) // 2 + size) for n, size in zip(shape, sizes, strict=True))


def _is_uniform(plan: DenoisePlan, shape: tuple[int, ...]) -> bool:
    """Return whether a plan has the same parameters everywhere, so that it fits any part."""
    found = patch_weights(plan.weights)
    if plan.noise is not None and plan.noise.profile is not None:
        return False
    if np.ndim(plan.lam) or not isinstance(plan.weights, Weights):
        return False
    if found is None:
        return True
    values = (getattr(found[0], name.name) for name in dataclasses.fields(found[0]))  # type: ignore[arg-type]
    return all(value is None or isinstance(value, int | float | str) for value in values)
