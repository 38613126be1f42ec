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


def padded(array: npt.NDArray[Any], widths: Sequence[int], border: Border, constant: float = 0.0) -> npt.NDArray[Any]:
    """Pad an array by made-up cells around its leading axes, so many on either side of each.

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
