"""Measure the noise of one plane or volume: :func:`measure`."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from .blocks import Block
from .flat import are_counts, cubes_of, flat_areas, put_there, written_twice
from .graphs import MEDIAN
from .impulses import ImpulseRule, Scene, filled, impulses_by, lone_pixels, rule_for
from .measured import Fields, Measured
from .steps import (
    Array,
    Flags,
    all_three,
    along,
    box_mean,
    dilated,
    doubled,
    gradient_energy,
    halved,
    inner,
    median_of_three,
    rms_of_smoothest,
    second_difference,
    smoothed,
)

# Share of the pixels that is measured, the smoothest ones.
SMOOTHEST = 0.1
# Fewest pixels for the product of second differences, for second differences along one axis, and for any estimate.
_PRODUCT, _TRIPLES, FEWEST = 400, 30, 50
# The noise over the median distance to the median of 3 x 3: 1.15 for Gaussian noise.
_OF_MEDIAN = 1.15 / MEDIAN
# Pixels with a value at an end of the range count as clipped if they are this many, or this share.
_CLIPPED, _CLIPPED_SHARE = 5, 1e-4
# A rare large count is no impulse: it must be so much larger than its neighbours.
_RARE_COUNT = 6.0
# All pixels of counts are measured, not only smooth ones, if this share of them is 0.
_ZEROS = 0.02
# Single pixels in areas of equal values are looked for if these have more than a share, and said from another.
_MOSTLY_FLAT, _LONE = 0.2, 1e-3
# If they leave less than this share of the other pixels, there is no noise besides them.
_LEFT = 0.4
# Planes of more pixels are measured in windows of pairs of pixels.
_LARGE = 1 << 16
# A second pass is made if the impulses of more than this share of the pixels change.
_CHANGED = 2e-3


def measure(block: Block, line: tuple[float, float] | None = None) -> Measured:
    """Measure the noise of a block.

    The smoothest tenth of the pixels is measured with the product of second differences along all axes. Areas of equal
    values, impulses and the surroundings of clipped values are left out. ``FEWEST`` pixels are needed.

    Parameters
    ----------
    block : Block
    line : (slope, level), optional
        The noise has the variance slope * value + level, which tells impulses from noise that is stronger where it is
        bright; None if it is white.
    """
    good, axes = block.good, block.axes
    pixels = int(np.count_nonzero(good))
    if pixels < FEWEST:
        known = block.values[good]
        if pixels and (known == known[0]).all():
            return Measured("no noise", "all values are equal", 0.0, pixels=pixels, flat=1.0)
        return Measured("cannot tell", f"only {pixels} pixels count", pixels=pixels)
    if max(block.values.shape[1:]) < 3:
        return Measured("cannot tell", "no axis has three pixels", pixels=pixels)
    return Measuring(block.values, good, pixels, axes).measured(line)


class Measuring:
    """The work of :func:`measure` on one block."""

    def __init__(
        self,
        exact: npt.NDArray[Any],
        good: Flags,
        pixels: int,
        axes: tuple[int, ...],
        rule: ImpulseRule | None = None,
    ) -> None:
        self.exact, self.good, self.pixels, self.axes = exact, good, pixels, axes
        self.complete = bool(good.all())
        if rule is None:
            known = exact.ravel() if self.complete else exact[good]
            self.sample = known[:: max(1, pixels // 16384)]
            self.low, self.high = float(known.min()), float(known.max())
            self.whole, self.often = put_there(self.sample, self.low, self.high)
            some = self.sample.astype(np.float64)
            self.offset = float(np.median(some))
            below, above = np.percentile(some, [5, 95])
            self.scale = float(above - below) or float(some.std()) or 1.0
            self.counts = are_counts(some, self.low)
            self.flat, self.side = flat_areas(exact, good, axes, whole=self.whole, counts=self.counts)
        else:
            self.low, self.high, self.whole, self.counts = rule.low, rule.high, rule.whole, rule.counts
            self.often = rule.often
            self.offset, self.scale, self.side = rule.offset, rule.scale, rule.side
            self.flat = cubes_of(exact, good, self.side, axes)
        self.values = self._scaled()
        self.usable = good & ~self.flat

    @cached_property
    def medians(self) -> Array:
        """The medians of 3 x 3 values, nearly."""
        found = self.values
        for axis in self.axes[-2:]:
            found = median_of_three(found, axis)
        return found

    def _rule(self, sigma: float, line: tuple[float, float] | None) -> ImpulseRule:
        """Return what is known of the image, for noise of this standard deviation in its units."""
        return ImpulseRule(
            sigma, line, self.offset, self.scale, self.low, self.high, self.whole, self.counts, self.side,
            self.often,
        )  # fmt: skip

    def _scaled(self) -> Array:
        """Return the values in units of the contrast; missing ones are means of those around them."""
        kind = self.exact.dtype
        # the difference of two float32 numbers is exact enough; tiny and huge ones would underflow
        narrow = (kind.kind in "iu" and kind.itemsize < 4) or (kind.itemsize <= 4 and 1e-30 < self.scale < 1e30)
        values: npt.NDArray[Any] = self.exact.astype(np.float32 if narrow else np.float64)
        values = (values - values.dtype.type(self.offset)) / values.dtype.type(self.scale)
        if self.complete:
            return values.astype(np.float32, copy=False)
        values = np.where(self.good, values, 0).astype(np.float32, copy=False)
        total, weight = values.copy(), self.good.astype(np.float32)
        for side in (3, 5, 9):
            sides = [1] + [side] * len(self.axes)
            sums, counts = box_mean(total, sides), box_mean(weight, sides)
            new = (weight == 0) & (counts > 1e-6)
            values = np.where(new, sums / np.maximum(counts, 1e-6), values)
            total, weight = np.where(new, values, total), np.where(new, np.float32(1), weight)
            if weight.all():
                break
        return values

    def measured(self, line: tuple[float, float] | None = None) -> Measured:
        """Return the measure, in two passes if the impulses depend on the noise, as :func:`measure` describes."""
        sparse = self.counts and float(self.sample.mean()) < 1
        flat = np.count_nonzero(self.flat) / self.pixels
        shares: dict[str, Any] = {"pixels": self.pixels, "flat": flat, "sparse": sparse}
        scene = self._scene()
        if shares["flat"] > _MOSTLY_FLAT and not self.counts:
            lone = lone_pixels(scene)
            if np.count_nonzero(lone) > _LONE * self.pixels:
                before = np.count_nonzero(self.usable)
                # without them, the values around are equal
                rest = filled(self.exact, lone, self.axes[-2:], self.good)
                self.usable = self.good & ~cubes_of(rest, self.good, self.side, self.axes) & ~lone
                scene = replace(scene, usable=self.usable)
                if np.count_nonzero(self.usable) < _LEFT * before:
                    share = np.count_nonzero(lone) / self.pixels
                    why = "there are only areas of equal values and single pixels"
                    return Measured("no noise", why, 0.0, **shares, impulses=share, rule=self._rule(0.0, None))
        step = max(1, self.values.size // 20000)
        distances = np.abs(self.values - self.medians).ravel()[::step][self.usable.ravel()[::step]]
        if np.count_nonzero(self.usable) < FEWEST or not distances.size:
            return self._only_flat(shares)
        nonzero = distances[distances > 0]
        first = float(np.median(nonzero)) * _OF_MEDIAN if nonzero.size else 0.0
        impulses = np.zeros(self.good.shape, bool)
        rule: ImpulseRule | None = None
        if first > 0:
            sigmas = first if line is None else self._of_line(line, first)
            rule, impulses = rule_for(scene, self._rule(first * self.scale, line), sigmas)
        found = self._estimate(impulses)
        if line is None and found is not None and found[0].sigma > 0 and first > 0:
            own = min(found[0].sigma, first)
            new, again = rule_for(scene, self._rule(own * self.scale, None), own)
            if np.count_nonzero(again ^ impulses) > _CHANGED * self.pixels:
                second = self._estimate(again)
                if second is not None:
                    found, impulses, rule = second, again, new
        if found is None:
            return Measured("cannot tell", "no pixel has neighbours that count", **shares)
        fields, count, texture, more = found
        shares |= more
        shares["span"] = self.span(fields.values)
        shares["impulses"] = np.count_nonzero(impulses) / self.pixels
        if fields.sigma == 0:
            why = "neighbouring values do not differ" if texture == 0 else "no second difference"
            return Measured("no noise", why, 0.0, count, **shares)
        return Measured(
            "measured", "", fields.sigma * self.scale, count, texture=texture, rule=rule, fields=fields, **shares
        )

    def _scene(self) -> Scene:
        """Return what is needed to find impulses."""
        extreme = np.isin(self.exact, self.often) & self.good if self.often else np.zeros(self.good.shape, bool)
        least = _RARE_COUNT / self.scale if self.counts else 0.0
        return Scene(self.values, self.medians, self.usable, extreme, self.axes[-2:], least)

    def impulses(self, rule: ImpulseRule) -> Flags:
        """Return the impulses by a rule."""
        own = rule.sigma / self.scale
        return impulses_by(self._scene(), rule, own if rule.line is None else self._of_line(rule.line, own))

    def span(self, values: Array) -> tuple[float, float]:
        """Return the range of means of 6 or 7 pixels along each axis, in the image's units, without a thousandth.

        The cut is made before the means are taken, so that no group of outliers decides.
        """
        step = max(1, values.size // (1 << 14))
        some = values.ravel()[::step][self.usable.ravel()[::step]]
        if not some.size:
            return math.nan, math.nan
        known = np.clip(values, *np.percentile(some, [0.1, 99.9]).astype(np.float32))
        whole = bool(self.usable.all())
        if whole and known.size > _LARGE:
            inside = box_mean(halved(known, self.axes), [1] + [3] * len(self.axes))
        else:
            window = [1] + [7] * len(self.axes)
            inside = (box_mean(known, window) if whole else self._known_mean(known, self.usable, window))[self.usable]
        low, high = (float(end) * self.scale + self.offset for end in (inside.min(), inside.max()))
        return low, high

    def _known_mean(self, values: Array, known: Flags, window: list[int]) -> Array:
        """Return the mean of the known values in a window around each pixel."""
        weight = box_mean(known.astype(np.float32), window)
        found: Array = box_mean(values * known, window) / np.maximum(weight, 1e-6)
        return found

    def _of_line(self, line: tuple[float, float], first: float) -> Array:
        """Return the standard deviation of noise that grows with the signal, at least a fifth of `first`."""
        slope, level = line
        variance = (slope * (self.medians * self.scale + self.offset) + level) / self.scale**2
        return np.sqrt(np.maximum(variance, 0.04 * first**2))

    def _only_flat(self, shares: dict[str, Any]) -> Measured:
        """Return the measure of a block of areas of equal values."""
        axis = written_twice(self.exact, self.axes)
        if axis is not None and np.unique(self.sample).size > self.sample.size // 16:
            return Measured("cannot tell", "every pixel is written twice, as an enlargement does", **shares)
        return Measured("no noise", "there are only areas of equal values", 0.0, **shares)

    def _estimate(self, impulses: Flags) -> tuple[Fields, int, float, dict[str, Any]] | None:
        """Measure without these impulses; None if no pixel has neighbours that count."""
        axes, usable = self.axes, self.usable & ~impulses
        values = np.where(impulses, self.medians, self.values)
        centres, shares = self._centres(usable, impulses)
        # where most counts are 0, the smoothest places are those without any
        share = 1.0 if self.counts and shares["clipped_low"] > _ZEROS else SMOOTHEST
        smooth = smoothed(values, axes)
        gradient = gradient_energy(smooth, axes)
        texture = self._texture(gradient, usable)
        response: Array = values
        valid = usable
        for axis in axes:
            response, valid = second_difference(response, axis), all_three(valid, axis)
        valid = valid & inner(centres, axes)
        enough = _PRODUCT if len(axes) > 1 else 100
        if np.count_nonzero(valid) >= enough:
            sigma, count, middle = rms_of_smoothest(response, valid, inner(texture, axes), share, 6.0 ** len(axes))
        else:
            single = self._along_one_axis(values, usable, centres, texture, share)
            if single is None:
                return None
            sigma, count, middle = single
        energy = middle / max(sigma, 1e-30) ** 2 if middle > 0 else 0.0
        fields = Fields(
            values, smooth, texture, gradient, usable, centres, response, valid, impulses, axes, sigma, self.scale,
            self.offset, self.low, self.high, self.whole,
        )  # fmt: skip
        return fields, count, energy, shares

    def _centres(self, usable: Flags, impulses: Flags) -> tuple[Flags, dict[str, Any]]:
        """Return the usable pixels that are not near a clipped or repeated value, and the shares of these."""
        clipped = np.zeros(usable.shape, bool)
        shares: dict[str, Any] = {"censored": False}
        least = max(_CLIPPED, _CLIPPED_SHARE * self.pixels)
        for value, name in ((self.low, "clipped_low"), (self.high, "clipped_high")):
            at = (self.exact == value) & self.good & ~impulses
            count = np.count_nonzero(at)
            shares[name] = count / self.pixels
            if count >= least and not (self.counts and value == 0):
                clipped |= at
        if not self.whole and self.often:
            at = np.isin(self.exact, self.often) & self.good & ~impulses
            shares["repeated"] = np.count_nonzero(at & ~clipped & ~self.flat) / self.pixels
            clipped |= at
        clipped &= ~self.flat
        if not clipped.any():
            return usable, shares
        apart = usable & ~dilated(clipped, 3 if len(self.axes) < 3 else 2, self.axes)
        if np.count_nonzero(apart) >= max(0.003 * self.pixels, _PRODUCT):
            return apart, shares
        return usable, shares | {"censored": True}

    def _texture(self, gradient: Array, usable: Flags) -> Array:
        """Return the mean energy of the gradient in windows of 7 pixels, of 5 in volumes; infinite where unknown.

        In a large plane it is computed from means of pairs of pixels, three of them, in a quarter of the time; in a
        volume that would take edges for smooth places.
        """
        axes = self.axes
        plane = len(axes) < 3
        paired = plane and gradient.size > _LARGE
        window = [1] + [3 if paired else 7 if plane else 5] * len(axes)

        def mean(values: Array) -> Array:
            return box_mean(halved(values, axes) if paired else values, window)

        if usable.all():
            found = mean(gradient)
        else:
            present = mean(usable.astype(np.float32))
            total = mean(gradient * usable)
            found = np.where(present > 0.05, total / np.maximum(present, 0.05), np.inf).astype(np.float32)
        return doubled(found, gradient.shape, axes) if paired else found

    def _along_one_axis(
        self, values: Array, usable: Flags, centres: Flags, texture: Array, share: float
    ) -> tuple[float, int, float] | None:
        """Measure second differences along single axes, or differences of two neighbours; the smallest counts."""
        found = []
        for axis in self.axes:
            valid = all_three(usable, axis) & inner(centres, (axis,))
            if np.count_nonzero(valid) >= _TRIPLES:
                found.append(
                    rms_of_smoothest(second_difference(values, axis), valid, inner(texture, (axis,)), share, 6.0)
                )
        if found:
            return min(found)
        ndim = values.ndim
        for axis in range(ndim):
            if values.shape[axis] > 1:
                one, other = along(axis, 1, None, ndim), along(axis, None, -1, ndim)
                steps = np.abs(values[one] - values[other])[usable[one] & usable[other]]
                if steps.size >= _TRIPLES:
                    found.append((float(np.median(steps)) / MEDIAN / math.sqrt(2), int(steps.size), 0.0))
        return min(found) if found else None
