"""Check the arrays that a caller passes: integers, finite values, points, faces, values at vertices."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.floating[Any]]
IntArray = npt.NDArray[np.integer[Any]]
# Most entries of a table that is computed at a time, such as (vertices, neighbours): it bounds the memory.
BLOCK_ENTRIES = 1 << 22
# Squares of coordinates up to this size, and of differences down to its reciprocal, are numbers of float64.
_LARGEST = 1e100


def frozen(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Make an array read-only and return it."""
    array.flags.writeable = False
    return array


def integers(name: str, values: npt.ArrayLike, ndim: int) -> IntArray:
    """Check integers and return them as an array of `ndim` axes.

    Raises
    ------
    TypeError, ValueError
        Values that are not integers, or another number of axes.
    """
    array = np.asarray(values)
    if array.size == 0 and array.dtype.kind == "f":
        array = array.astype(np.int64)
    if array.dtype.kind not in "iu":
        raise TypeError(f"{name} must hold integers, got {array.dtype}")
    if array.ndim != ndim:
        raise ValueError(f"{name} must have {ndim} dimension(s), got shape {array.shape}")
    return array


def computed_type(dtype: npt.DTypeLike | None) -> np.dtype[Any]:
    """Return the type to compute in, float32 (the default) or float64, in the native byte order.

    Raises
    ------
    ValueError
        Another type.
    """
    try:
        kind: np.dtype[Any] = np.dtype(np.float32 if dtype is None else dtype).newbyteorder("=")
    except TypeError:
        raise ValueError(f"dtype must be float32 or float64, got {dtype!r}") from None
    if kind not in (np.float32, np.float64):
        raise ValueError(f"dtype must be float32 or float64, got {kind}")
    return kind


def unmasked(values: npt.ArrayLike, name: str) -> npt.NDArray[Any]:
    """Return `values` as an array; refuse a numpy masked array, whose mask would be lost."""
    if isinstance(values, np.ma.MaskedArray):
        raise TypeError(f"{name} is a masked array: pass its data, and mask=~{name}.mask to a function with a mask")
    return np.asarray(values)


def held_type(given: npt.DTypeLike, computed: npt.DTypeLike) -> np.dtype[Any]:
    """Return the type that holds values of the type `given` and in which they are computed with.

    It is float32 for integers of 16 bits and less and for narrow real numbers, otherwise float64, and at least of the
    type `computed`.
    """
    kind = np.dtype(given)
    narrow = kind.itemsize <= (4 if kind.kind == "f" else 2)
    return np.promote_types(np.float32 if narrow else np.float64, np.dtype(computed).newbyteorder("="))


def into_integers(values: npt.NDArray[Any], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Convert values to a type: for integers rounded to the nearest, of two the even one, and clipped."""
    kind = np.dtype(dtype)
    if kind.kind in "iu" and values.dtype.kind == "f":
        limits = np.iinfo(kind)
        values = np.clip(np.rint(values), limits.min, limits.max)
    return values.astype(kind, copy=False)


def all_finite(values: npt.NDArray[Any]) -> bool:
    """Check block by block whether no value is NaN or infinite."""
    if values.dtype.kind != "f":
        return True
    if values.size and not any(values.strides):
        # one number at all places
        values = values.reshape(-1)[:1]
    flat = values.reshape(-1) if values.flags.c_contiguous else values
    block = max(1, BLOCK_ENTRIES // max(1, math.prod(flat.shape[1:])))
    return all(bool(np.isfinite(flat[begin : begin + block]).all()) for begin in range(0, len(flat), block))


def checked_points(points: npt.ArrayLike, name: str = "points") -> FloatArray:
    """Check coordinates and return them as a float64 array (n, d), n >= 1 and d >= 1.

    Raises
    ------
    TypeError, ValueError
        Values that are not real and finite, or whose squares are not numbers of float64; another shape.
    """
    array = unmasked(points, name)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{name} must hold real numbers, got {array.dtype}")
    if array.ndim != 2 or 0 in array.shape:
        raise ValueError(f"{name} must have shape (n, d), a row per vertex, got {array.shape}")
    if not all_finite(array):
        row = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise ValueError(f"{name} must be finite, row {row} is {array[row].tolist()}: leave such rows out")
    x: FloatArray = array.astype(np.float64)
    low, high = x.min(axis=0), x.max(axis=0)
    size, extent = float(np.maximum(np.abs(low), np.abs(high)).max()), float((high / 2 - low / 2).max())
    if size > _LARGEST or 0 < extent < 1 / _LARGEST:
        what = f"be up to {_LARGEST:g}, got {size:.3g}" if size > _LARGEST else f"differ by {1 / _LARGEST:g} or more"
        raise ValueError(f"{name} must {what}: use another unit")
    return x


def checked_faces(faces: npt.ArrayLike, n_vertices: int) -> IntArray:
    """Check faces and return them as an int64 array (F, k) of vertices 0..n_vertices - 1, with k >= 3 corners.

    Raises
    ------
    TypeError, ValueError
        Values that are not integers, another shape, or a vertex that does not exist.
    """
    array = np.asarray(faces)
    if array.size == 0:
        array = np.zeros((0, 3), np.int64)
    if array.dtype.kind not in "iu":
        raise TypeError(f"faces must hold integers, got {array.dtype}")
    if array.ndim != 2 or array.shape[1] < 3:
        raise ValueError(f"faces must have shape (F, 3) of three vertices each, or (F, k), got {array.shape}")
    if array.size and (array.min() < 0 or array.max() >= n_vertices):
        wrong = array[(array < 0) | (array >= n_vertices)][0]
        raise ValueError(f"faces must name vertices 0..{n_vertices - 1}, got {wrong}")
    return array.astype(np.int64)


def checked_values(values: npt.ArrayLike, n: int) -> npt.NDArray[Any]:
    """Check values at the vertices and return them as (n, m), in their own floating-point type or in float64.

    Raises
    ------
    TypeError, ValueError
        Values that are not real and finite, or another shape.
    """
    f = unmasked(values, "values")
    if f.dtype.kind not in "biuf":
        raise TypeError(f"values must be real numbers, got {f.dtype}")
    if f.ndim not in (1, 2) or len(f) != n or f.size == 0:
        raise ValueError(f"values must have shape ({n},) or ({n}, m), a row per vertex, got {f.shape}")
    if not all_finite(f):
        raise ValueError("values must be finite: give lam=0 and any value where there is none")
    return f.astype(f.dtype if f.dtype.kind == "f" else np.float64).reshape(n, -1)


def checked_flags(name: str, given: npt.ArrayLike, n: int) -> npt.NDArray[np.bool_]:
    """Check a boolean array with one value per vertex, (n,).

    Raises
    ------
    ValueError
        Another type or shape.
    """
    flags = np.asarray(given)
    if flags.dtype != np.bool_ or flags.shape != (n,):
        raise ValueError(f"{name} must be boolean of shape ({n},), one per vertex, got {flags.dtype} of {flags.shape}")
    return flags
