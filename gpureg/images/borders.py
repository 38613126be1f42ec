"""Padding of an image at its border."""

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
    """Pad an array by `widths` cells on both sides of its leading axes; "clip" pads nothing.

    "reflect" mirrors without the edge cell, "symmetric" mirrors with it, "nearest" repeats it, "wrap" continues at the
    other end.
    """
    if border == "clip" or not any(widths):
        return array
    around = [(w, w) for w in widths] + [(0, 0)] * (array.ndim - len(widths))
    if border == "constant":
        return np.pad(array, around, mode="constant", constant_values=constant)
    return np.pad(array, around, mode=_MODES[border])


def cropped(array: npt.NDArray[Any], widths: Sequence[int]) -> npt.NDArray[Any]:
    """Remove the cells that :func:`padded` added."""
    inner = tuple(slice(w, size - w) for w, size in zip(widths, array.shape, strict=False))
    return np.ascontiguousarray(array[inner])
