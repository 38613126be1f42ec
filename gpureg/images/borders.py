"""What lies beyond the border of an image: nothing (the graph ends there), or pixels made up and cut off again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

Border = Literal["clip", "reflect", "symmetric", "nearest", "wrap", "constant"]
BORDERS: tuple[Border, ...] = get_args(Border)

_MODES: dict[Border, Any] = {
    "reflect": "reflect",
    "symmetric": "symmetric",
    "nearest": "edge",
    "wrap": "wrap",
    "constant": "constant",
}


def expect_border(border: str) -> Border:
    """The border's name, checked.

    Raises
    ------
    ValueError
        Another name.
    """
    for name in BORDERS:
        if border == name:
            return name
    raise ValueError(f"border must be one of {', '.join(BORDERS)}, got {border!r}")


def padded(array: npt.NDArray[Any], widths: Sequence[int], border: Border, constant: float = 0.0) -> npt.NDArray[Any]:
    """An array with made-up cells around its leading axes, so many on either side of each.

    "reflect" mirrors without repeating the edge cell, "symmetric" with it, "nearest" repeats it, "wrap" goes on at the
    other end.
    """
    if border == "clip" or not any(widths):
        return array
    around = [(w, w) for w in widths] + [(0, 0)] * (array.ndim - len(widths))
    if border == "constant":
        return np.pad(array, around, mode="constant", constant_values=constant)
    return np.pad(array, around, mode=_MODES[border])


def cropped(array: npt.NDArray[Any], widths: Sequence[int]) -> npt.NDArray[Any]:
    """What :func:`padded` was given."""
    inner = tuple(slice(w, size - w) for w, size in zip(widths, array.shape, strict=False))
    return np.ascontiguousarray(array[inner])
