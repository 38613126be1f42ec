"""Measure the noise of all channels of an image: :func:`survey`."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from .blocks import Block, blocks, channels_of
from .channels import PLANES, Relations, relate
from .growth import Growth, cells_of, fit_growth
from .measure import Measuring, measure
from .measured import Measured, State
from .steps import Array
from .whiteness import Whiteness, whiteness

# Planes of a volume, and of a series, that are tested for noise that is not white.
_TESTED = 6
# Pixels of planes that are tested together.
_PLANE = 1 << 14
# Channels that are measured at the same time.
_AT_ONCE = 4
# Share of impulses from which noise that grows with the signal is measured again.
_SOME = 1e-4


@dataclass(frozen=True, eq=False)
class Channel:
    """The measures of a channel: its planes or volumes, and the tests of planes.

    Attributes
    ----------
    parts : tuple of Measured
    tests : tuple of Whiteness
    growth : Growth or None
    pixels : int
        Number of pixels that count.
    same_as : int or None
        The earlier channel with exactly the same values, whose measures these are.
    """

    parts: tuple[Measured, ...]
    tests: tuple[Whiteness, ...] = ()
    growth: Growth | None = None
    pixels: int = 0
    same_as: int | None = None

    @property
    def told(self) -> tuple[Measured, ...]:
        """The parts whose noise could be told."""
        return tuple(part for part in self.parts if part.state != "cannot tell")

    @property
    def state(self) -> State:
        """What is known of the noise of the channel."""
        if not self.told:
            return "cannot tell"
        return "measured" if any(part.state == "measured" for part in self.parts) else "no noise"

    @property
    def span(self) -> tuple[float, float]:
        """The range of the smoothed channel where there is noise; NaN if nothing is known."""
        return _joined([part.span for part in self.parts])

    @property
    def why(self) -> str:
        """The reason of the state, if nothing was measured."""
        if self.state == "measured":
            return ""
        return next((part.why for part in self.parts if part.state == self.state), "no pixel counts")

    @property
    def sigma(self) -> float:
        """Root mean square of the noise of the parts; NaN if it cannot be told."""
        return root_mean_square([part.sigma for part in self.told])

    @property
    def relative_error(self) -> float:
        """Standard error of sigma, relative to sigma."""
        count = sum(part.count for part in self.told)
        return 1.4 / math.sqrt(count) if count else math.inf

    def share(self, name: str) -> float:
        """Return the mean of an attribute of the parts, weighted by their pixels."""
        pixels = sum(part.pixels for part in self.parts)
        return sum(float(getattr(part, name)) * part.pixels for part in self.parts) / pixels if pixels else 0.0

    def says(self, name: str) -> bool:
        """Return whether most of the tests say so."""
        return 2 * sum(bool(getattr(test, name)) for test in self.tests) > len(self.tests)

    def mean(self, name: str) -> float:
        """Return the mean of a number of the tests; 0 without tests."""
        return float(np.mean([getattr(test, name) for test in self.tests])) if self.tests else 0.0


@dataclass(frozen=True, eq=False)
class Survey:
    """The measures of all channels of an image, and how they are related (None if unknown or not asked)."""

    channels: tuple[Channel, ...]
    relations: Relations | None = None

    @property
    def sigmas(self) -> tuple[float, ...]:
        """Standard deviation of the noise of each channel; NaN where it cannot be told."""
        return tuple(channel.sigma for channel in self.channels)


@dataclass(frozen=True, eq=False)
class _Pass:
    """The blocks of a channel, measured; only the first parts keep their arrays, to save memory."""

    parts: list[Measured]
    tests: list[Whiteness]
    growth: Growth | None

    @classmethod
    def over(cls, cut: Sequence[Block], *, tested: bool, line: tuple[float, float] | None = None) -> _Pass:
        parts: list[Measured] = []
        tests: list[Whiteness] = []
        cells: list[Array] = []
        growth = None
        with ThreadPoolExecutor(1) as beside:
            for i, block in enumerate(cut):
                found = measure(block, line)
                # in a second thread, while this one fits the growth; each takes about a third of the time
                testing = beside.submit(_tests, block, found) if tested and len(tests) < _TESTED else None
                cells.append(cells_of(found, len(cut)))
                if i == len(cut) - 1:
                    growth = fit_growth(cells)
                if testing is not None:
                    tests += [test for test in testing.result() if test is not None]
                parts.append(found if len(parts) < PLANES else replace(found, fields=None))
        return cls(parts, tests, growth)


def measured_with_growth(cut: Sequence[Block], *, tested: bool = False) -> _Pass:
    """Measure blocks, and fit the growth of their noise.

    One standard deviation takes strong noise in bright places for impulses. If the noise grows, the blocks are measured
    again with the line.
    """
    first = _Pass.over(cut, tested=tested)
    growth = first.growth
    if growth is None or not growth.is_likely or not any(part.impulses > _SOME for part in first.parts):
        return first
    again = _Pass.over(cut, tested=tested, line=(growth.slope, growth.level))
    return again if again.growth is not None else first


def measure_channels(
    image: npt.ArrayLike, channel_axis: int | None, mask: npt.ArrayLike | None
) -> list[list[Measured]]:
    """Measure the planes or volumes of each channel; only what :func:`gpureg.estimate_noise` needs.

    Raises
    ------
    TypeError, ValueError
        As :func:`gpureg.noise.blocks.channels_of`.
    """
    channels, inside = channels_of(image, channel_axis, mask)
    return [[measure(block) for part in blocks(channel, inside) for block in part] for channel in channels]


def spans_of(
    image: npt.ArrayLike, channel_axis: int | None, mask: npt.ArrayLike | None
) -> tuple[tuple[tuple[float, float], ...], float]:
    """Return the range of each smoothed channel where there is noise, and the smallest share of areas of equal values.

    The ranges are NaN where nothing is known.
    """
    channels, inside = channels_of(image, channel_axis, mask)
    spans, shares = [], []
    for channel in channels:
        found = [_seen(block) for part in blocks(channel, inside) for block in part]
        spans.append(_joined([span for span, _ in found]))
        shares.append(max((share for _, share in found), default=0.0))
    return tuple(spans), min(shares)


def _seen(block: Block) -> tuple[tuple[float, float], float]:
    """Return the range of a block where there may be noise, NaN if unknown, and the share of areas of equal values."""
    good = block.good
    pixels = int(np.count_nonzero(good))
    if not pixels:
        return (math.nan, math.nan), 0.0
    work = Measuring(block.values, good, pixels, block.axes)
    return work.span(work.values), np.count_nonzero(work.flat) / pixels


def _joined(spans: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the range over the parts of a channel; NaN if nothing is known."""
    known = [span for span in spans if not math.isnan(span[0])]
    if not known:
        return math.nan, math.nan
    return min(low for low, _ in known), max(high for _, high in known)


def survey(image: npt.ArrayLike, channel_axis: int | None = None, mask: npt.ArrayLike | None = None) -> Survey:
    """Measure and test the noise of an image.

    Raises
    ------
    TypeError, ValueError
        As :func:`gpureg.noise.blocks.channels_of`.
    """
    arrays, inside = channels_of(image, channel_axis, mask)
    count = arrays[0].size if inside is None else int(np.count_nonzero(inside))
    earlier = [next((i for i in range(j) if _same(arrays[i], arrays[j])), None) for j in range(len(arrays))]
    own = [j for j, same in enumerate(earlier) if same is None]

    def measured(index: int) -> _Pass:
        cut = [block for part in blocks(arrays[index], inside) for block in part]
        return measured_with_growth(cut, tested=True)

    # numpy computes arrays without the interpreter's lock; a few channels at a time, as each needs arrays of its own
    with ThreadPoolExecutor(max(1, min(len(own), os.cpu_count() or 1, _AT_ONCE))) as threads:
        passes = dict(zip(own, threads.map(measured, own), strict=True))
    channels: list[Channel] = []
    compared: list[list[Measured]] = []
    for index, same in enumerate(earlier):
        if same is not None:
            channels.append(_again(channels[same], same))
            compared.append(compared[same])
            continue
        found = passes[index]
        channels.append(Channel(tuple(found.parts), tuple(found.tests), found.growth, count))
        compared.append(found.parts[:PLANES])
    return Survey(tuple(channels), relate(compared) if len(channels) > 1 else None)


def _tests(block: Block, found: Measured) -> list[Whiteness | None]:
    """Test the plane of a block, or some planes of its volumes."""
    if found.state != "measured" or block.values.ndim < 3:
        return []
    if block.values.ndim == 3:
        return [whiteness(found)]
    values = block.values.reshape(-1, *block.values.shape[2:])
    inside = None if block.inside is None else block.inside.reshape(values.shape)
    # small planes are tested together
    together = -(-_PLANE // (values.shape[1] * values.shape[2]))
    count = min(len(values), max(_TESTED, 2 * together))
    places = np.unique(np.linspace(0, len(values) - 1, count + 2).round().astype(int)[1:-1])
    groups = [places[i : i + together] for i in range(0, len(places), together)]
    planes = [Block(values[i], None if inside is None else inside[i]) for i in groups]
    return [whiteness(part) for part in map(measure, planes) if part.state == "measured"]


def _same(one: Array, other: Array) -> bool:
    """Return whether two channels are exactly equal; a look at a row tells nearly always."""
    row = len(one) // 2
    return bool(np.array_equal(one[row], other[row], equal_nan=one.dtype.kind == "f")) and bool(
        np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    )


def _again(channel: Channel, index: int) -> Channel:
    """Return the measures of a channel for one that is equal."""
    return Channel(channel.parts, channel.tests, channel.growth, channel.pixels, index)


def worst(states: Sequence[State]) -> State:
    """Return the state of an image: "cannot tell" if it cannot be told of any channel, "no noise" if of all."""
    if "measured" in states:
        return "measured"
    return "cannot tell" if "cannot tell" in states else "no noise"


def root_mean_square(sizes: Sequence[float]) -> float:
    """Return the root mean square of numbers of any size; NaN of none."""
    if not sizes:
        return math.nan
    unit = max(sizes)
    return unit * math.sqrt(sum((size / unit) ** 2 for size in sizes) / len(sizes)) if unit > 0 else 0.0
