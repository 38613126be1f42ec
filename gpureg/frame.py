"""The offset and the scale of data, and their spread, from order statistics: no single sample decides them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[Any]

# Samples of a channel from which the spread is found, and those for a frame, where a factor of 2 has no effect.
_SAMPLES, _FEW = 1 << 15, 1 << 12
# Channels with fewer values have no sample that could be left out.
_TINY = 8
# An offset of fewer spreads than this costs float32 less than 3 of its 24 bits.
_FAR = 8
# The exponents of a scale: their reciprocals and squares of values near 1 are float64 numbers.
_EXPONENTS = (-1000, 1000)
# Between these exponents the products of a few scales are float32 numbers.
_NEAR = 30


def spread(values: Values, samples: int = _SAMPLES) -> float:
    """Compute the spread of a function (n, m): the largest over its channels, 0 if each is constant.

    The spread of a channel is twice the range of its middle 90 percent, which is about the range of noisy data, or half
    the range of its middle 98 percent if that is larger. If both are 0, it is the range of all but fewer values, one at
    each end at least; if these are constant too, it is the standard deviation. Of more than 2^15 values of a channel,
    as many at equal distances count. The result is rounded to 4 bits, so that it does not change with every sample.
    """
    return _rounded(max((_of_channel(values[:, c], samples) for c in range(values.shape[1])), default=0.0))


def steps_of_samples(n: int) -> tuple[int, int]:
    """Return the distances of the samples for a frame and for a spread, among n values of a channel."""
    return tuple(n // samples | 1 if n > samples else 1 for samples in (_FEW, _SAMPLES))  # type: ignore[return-value]


def _sampled(channel: Values, samples: int) -> Values:
    # an odd distance, which does not fall in step with rows of even length
    return channel if len(channel) <= samples else channel[:: len(channel) // samples | 1]


def _of_channel(channel: Values, samples: int) -> float:
    x = _sampled(channel, samples)
    n = len(x)
    if n < _TINY:
        return _range(x.min(), x.max()) if n else 0.0
    few, fewer = max(1, n // 20), max(1, n // 100)
    part = np.partition(x, sorted({few, fewer, n - 1 - few, n - 1 - fewer}))
    found = max(2 * _range(part[few], part[-1 - few]), _range(part[fewer], part[-1 - fewer]) / 2)
    if found > 0:
        return found
    x = np.sort(channel)
    if x[0] == x[-1]:
        return 0.0
    out = max(1, len(x) // 100)
    while out > 1:
        out //= 2
        if x[-1 - out] > x[out]:
            return _range(x[out], x[-1 - out])
    # all values but two at most are equal
    middle = float(x[len(x) // 2])
    apart = x.astype(np.float64) - middle
    largest = float(np.abs(apart).max())
    return largest * math.sqrt(float(np.mean((apart / largest) ** 2)))


def _range(low: Any, high: Any) -> float:
    # half of the largest number, so that twice of it is one
    return min(float(high) - float(low), float(np.finfo(np.float64).max) / 2)


def _rounded(x: float) -> float:
    mantissa, exponent = math.frexp(x)
    return math.ldexp(round(16 * mantissa) / 16, min(exponent, 1023))


@dataclass(frozen=True)
class Frame:
    """The units in which data are computed with: data = offset + scale * function.

    Attributes
    ----------
    offset : tuple of m floats, or None
        One per channel, a multiple of a power of two near its spread; None for 0.
    scale : float
        A power of two: about the spread of the data.
    """

    offset: tuple[float, ...] | None = None
    scale: float = 1.0

    @classmethod
    def of(cls, values: Values, *, centred: bool = True) -> Frame:
        """Choose the frame of data (n, m); if not `centred`, without an offset."""
        columns = [values[:, c] for c in range(values.shape[1])]
        spreads = [_rounded(_of_channel(x, _FEW)) for x in columns]
        size = max(spreads, default=0.0) or max((abs(float(x[0])) for x in columns if len(x)), default=0.0)
        if not size:
            return cls()
        scale = _power_of_two(size)
        if not centred:
            return cls(None, scale)
        offset = np.zeros(len(columns))
        for c, (x, width) in enumerate(zip(columns, spreads, strict=True)):
            few = _sampled(x, _FEW)
            middle = float(np.partition(few, len(few) // 2)[len(few) // 2])
            unit = _power_of_two(width) if width else 0.0
            if unit and abs(middle) >= _FAR * width:
                middle = float(np.rint(middle / unit)) * unit
            offset[c] = middle if abs(middle) >= _FAR * width else 0.0
        return cls(tuple(offset.tolist()) if offset.any() else None, scale)

    @property
    def is_narrow(self) -> bool:
        """Whether the products of the frame need no wider type than that of the values."""
        return self.offset is None and abs(math.log2(self.scale)) <= _NEAR

    def into(self, values: Values, dtype: np.dtype[Any]) -> Values:
        """Return the function of data (n, m), in this type."""
        if self.offset is not None:
            shifted = values.astype(np.float64)
            shifted -= self.offset
            shifted *= 1 / self.scale
            return shifted.astype(dtype, copy=False)
        if self.scale == 1:
            return values.astype(dtype, copy=False)
        out = np.empty(values.shape, dtype)
        if abs(math.log2(self.scale)) > _NEAR:
            return np.multiply(values, np.float64(1 / self.scale), out=out, casting="same_kind")
        return np.multiply(values, 1 / self.scale, out=out, casting="same_kind")

    def reach(self, values: Values) -> float:
        """Return the largest absolute value of the function of data (n, m)."""
        if not values.size:
            return 0.0
        if self.offset is None:  # much faster than along the columns
            return max(abs(float(values.min())), abs(float(values.max()))) / self.scale
        ends = np.stack([values.min(axis=0), values.max(axis=0)]).astype(np.float64)
        return float(np.abs((ends - self.offset) / self.scale).max())

    def back(self, function: Values, dtype: np.dtype[Any]) -> Values:
        """Return the data of a function (n, m), in this type."""
        data = function.astype(dtype if self.is_narrow else np.float64)
        if self.scale != 1:
            data *= self.scale
        if self.offset is not None:
            data += self.offset
        return data.astype(dtype, copy=False)

    def lam(self, lam: Values, p: float) -> Values:
        """Return the fidelity of the function for that of the data; a number > 0 and finite stays so."""
        if p == 2 or self.scale == 1:
            return lam
        limits = np.finfo(np.float64)
        usual = (lam > 0) & (lam < np.inf)
        return np.where(usual, np.clip(_times(lam, self.scale, 2 - p), limits.tiny, limits.max), lam)

    def energy(self, energy: float, p: float) -> float:
        """Return the energy of the data for that of the function."""
        return float(_times(np.asarray(energy), self.scale, p))


# The units of the data themselves.
AS_GIVEN = Frame()


def _power_of_two(x: float) -> float:
    return math.ldexp(1.0, min(max(math.frexp(x)[1] - 1, _EXPONENTS[0]), _EXPONENTS[1]))


def _times(values: Values, scale: float, power: float) -> Values:
    """Multiply by scale^power, without rounding if this is a power of two."""
    exponent = math.log2(scale) * power
    whole = math.floor(exponent)
    with np.errstate(over="ignore", under="ignore"):
        product: Values = np.ldexp(np.asarray(values, np.float64) * 2.0 ** (exponent - whole), whole)
    return product
