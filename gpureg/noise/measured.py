"""What is measured of the noise of a plane or a volume: :class:`Measured`, and the arrays behind it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from .impulses import ImpulseRule
from .steps import Array, Flags

State = Literal["measured", "no noise", "cannot tell"]
# Standard error of sigma times the square root of the number of pixels (Monte Carlo: 0.8 to 1.6 in a plane).
_ERROR = 1.4


@dataclass(frozen=True, eq=False)
class Fields:
    """The arrays behind a measure, (b, ...) each, in units of `scale` above `offset`.

    Attributes
    ----------
    values : float32 array
        The values; impulses are replaced by the median of their neighbourhood.
    smooth, texture, gradient : float32 arrays
        The values smoothed by (1 4 6 4 1)/16, the mean energy of their gradient in a window, and at each pixel.
    usable, centres : bool arrays
        True at pixels with noise, and at those of them that are not near a clipped value.
    response, valid : float array, bool array
        Product of second differences, with a deviation of 6^(d/2) sigma, and where it is valid; 2 shorter along each
        measured axis.
    impulses : bool array
    axes : tuple of int
    sigma, scale, offset : float
        The noise in units of `scale`, the contrast, and the median of the values.
    low, high : float
        The smallest and the largest value, in the image's units.
    whole : bool
        Whether the values have few levels, as whole numbers have.
    """

    values: Array
    smooth: Array
    texture: Array
    gradient: Array
    usable: Flags
    centres: Flags
    response: Array
    valid: Flags
    impulses: Flags
    axes: tuple[int, ...]
    sigma: float
    scale: float
    offset: float
    low: float
    high: float
    whole: bool


@dataclass(frozen=True, eq=False)
class Measured:
    """The noise of one plane or volume.

    Attributes
    ----------
    state : {"measured", "no noise", "cannot tell"}
    why : str
        The reason of the state, if it is not "measured".
    sigma : float
        Standard deviation of the noise, in the image's units; NaN if it cannot be told.
    count, pixels : int
        Number of pixels that were measured, and of those that count.
    texture : float
        Energy of the gradient where it was measured, over sigma^2: .03 for pure noise, more than .09 if texture is
        everywhere and sigma is an upper bound.
    censored : bool
        Whether clipped values could not be left out: sigma is a lower bound.
    flat, impulses, clipped_low, clipped_high, repeated : float
        Shares of the pixels: in areas of equal values, impulses, at the ends of the range, with a value that many have.
    rule : ImpulseRule or None
        How the impulses were found; its sigma is 0 if they stand in areas of equal values, and there is nothing else.
    sparse : bool
        Whether the values are counts of less than 1 on average.
    span : tuple of float
        The range of means of 7 pixels along each axis, where there is noise; NaN if unknown.
    fields : Fields or None
        The arrays behind it, if it was measured.
    """

    state: State
    why: str = ""
    sigma: float = math.nan
    count: int = 0
    pixels: int = 0
    texture: float = math.nan
    censored: bool = False
    flat: float = 0.0
    impulses: float = 0.0
    clipped_low: float = 0.0
    clipped_high: float = 0.0
    repeated: float = 0.0
    rule: ImpulseRule | None = None
    sparse: bool = False
    span: tuple[float, float] = (math.nan, math.nan)
    fields: Fields | None = field(default=None, repr=False)

    @property
    def salt(self) -> bool:
        """Whether the impulses are salt and pepper."""
        return self.rule is not None and self.rule.salt

    @property
    def lone(self) -> bool:
        """Whether the impulses stand in areas of equal values, and there is no other noise."""
        return self.rule is not None and self.rule.sigma == 0

    @property
    def relative_error(self) -> float:
        """Standard error of sigma, relative to sigma."""
        return _ERROR / math.sqrt(self.count) if self.count else math.inf
