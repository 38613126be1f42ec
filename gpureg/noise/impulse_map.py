"""Find the impulses of a whole image, or of a part of it: :func:`impulses_in`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .blocks import Block, measured_axes
from .impulses import ImpulseRule
from .measure import Measuring
from .steps import Flags


def impulses_in(values: npt.NDArray[Any], inside: Flags | None, rule: ImpulseRule) -> Flags:
    """Return the impulses of an image of one channel, or of a part of it, by a rule.

    Parameters
    ----------
    values : array
    inside : bool array of its shape, or None
        True at the pixels that count.
    rule : ImpulseRule
    """
    axes = measured_axes(values.shape)
    if not axes:
        return np.zeros(values.shape, bool)
    last = tuple(range(-len(axes), 0))
    moved = np.moveaxis(values, axes, last)
    whole = moved.shape
    block = Block(
        moved.reshape(-1, *whole[-len(axes) :]),
        None if inside is None else np.moveaxis(inside, axes, last).reshape(-1, *whole[-len(axes) :]),
    )
    good = block.good
    if not good.any():
        return np.zeros(values.shape, bool)
    found = Measuring(block.values, good, int(np.count_nonzero(good)), block.axes, rule).impulses(rule)
    return np.moveaxis(found.reshape(whole), last, axes)
