"""TIFF stacks for the tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tifffile

SIZES = {"T": 5, "Z": 4, "C": 2, "Y": 13, "X": 17, "S": 3}  # all different: exchanged axes are found out


def values(axes: str, dtype: str = "uint16", **sizes: int) -> np.ndarray:
    shape = tuple({**SIZES, **sizes}[letter] for letter in axes)
    return np.random.default_rng(3).integers(0, 250, shape).astype(dtype)


IMAGEJ: dict[str, Any] = {"imagej": True}
OME: dict[str, Any] = {"ome": True}
# name: axes for tifffile, axes for us, type, how it is written
NAMED: dict[str, tuple[str, str, str, dict[str, Any]]] = {
    "imagej-zyx": ("ZYX", "ZYX", "uint8", IMAGEJ),
    "imagej-tyx": ("TYX", "TYX", "uint16", IMAGEJ),
    "imagej-zcyx": ("ZCYX", "ZCYX", "float32", IMAGEJ),
    "imagej-tzcyx": ("TZCYX", "TZCYX", "uint8", IMAGEJ),
    "imagej-cyx": ("CYX", "CYX", "uint16", IMAGEJ),
    "imagej-colour": ("TYXS", "TYXC", "uint8", IMAGEJ | {"photometric": "rgb"}),
    "ome-zyx": ("ZYX", "ZYX", "float64", OME),
    "ome-tcyx": ("TCYX", "TCYX", "uint16", OME),
    "ome-colour": ("ZYXS", "ZYXC", "uint8", OME | {"photometric": "rgb"}),
    "shaped-tyx": ("TYX", "TYX", "float64", {"photometric": "minisblack"}),
    "shaped-zcyx": ("ZCYX", "ZCYX", "float32", {"photometric": "minisblack"}),
    "shaped-colour": ("TYXS", "TYXC", "uint16", {"photometric": "rgb"}),
    "compressed": ("TZYX", "TZYX", "uint16", {"photometric": "minisblack", "compression": "zlib"}),
    "big-endian": ("ZYX", "ZYX", "uint16", {"photometric": "minisblack", "byteorder": ">"}),
    "bigtiff": ("ZYX", "ZYX", "float32", {"photometric": "minisblack", "bigtiff": True}),
}


def write_named(path: Path, name: str) -> np.ndarray:
    axes, _, dtype, how = NAMED[name]
    array = values(axes, dtype)
    tifffile.imwrite(path, array, metadata={"axes": axes}, **how)
    return array
