"""What is known of a library of arrays (:class:`Library`), and which library an object belongs to."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Hashable
from typing import Any, Literal, NamedTuple, Protocol, cast

import numpy as np
import numpy.typing as npt

# The package in which a type or one of its bases is defined, and the file here that knows its arrays.
KNOWN = {"torch": "torch", "cupy": "cupy", "jax": "jax", "jaxlib": "jax", "warp": "warp"}

# The codes of DLPack for memory of the host and of CUDA.
HOST = frozenset((1, 3))
CUDA = frozenset((2, 13))


class Place(NamedTuple):
    """The device on which an array lies, if it is not the host.

    Attributes
    ----------
    kind : {"cuda", "opencl"}
    device : object
        The number of a CUDA device, or a ``pyopencl.Device``.
    """

    kind: Literal["cuda", "opencl"]
    device: Any


class Memory(NamedTuple):
    """The memory of an array as one of Warp.

    Attributes
    ----------
    numbers : (size,) Warp array
        In C order.
    shape : tuple of int
    dtype : dtype
    """

    numbers: Any
    shape: tuple[int, ...]
    dtype: np.dtype[Any]


class Library(Protocol):
    """The functions that a file of this room has for the arrays of its library."""

    def to_host(self, array: Any, name: str) -> npt.NDArray[Any]:
        """Return the values as a numpy array, a view where the array lies on the host.

        `name` is the parameter, for messages. An array that records gradients raises a TypeError.
        """

    def to_library(self, value: npt.NDArray[Any], like: Any) -> Any:
        """Return a writeable numpy array that nobody else uses as an array of the library, on the device of `like`."""

    def to_warp(self, array: Any, name: str) -> Memory | None:
        """Return the same memory as an array of Warp; None for memory that Warp cannot use, or without Warp."""

    def from_warp(self, numbers: Any, shape: tuple[int, ...], like: Any) -> Any:
        """Return an array of Warp, (size,), as an array of the library, without a copy."""

    def place(self, array: Any) -> Place | None:
        """Return the device of an array; None for the host and for devices on which gpureg does not compute."""


def library_of(x: Any) -> Library | None:
    """Return the library of an array; None for numpy and for anything that is no array."""
    name = _name(cast("Hashable", type(x)))
    if name is None and "__cuda_array_interface__" in getattr(x, "__dict__", ()):
        name = "other"
    return None if name is None else cast("Library", importlib.import_module(f"{__package__}.{name}"))


@functools.lru_cache(512)
def _name(kind: Any) -> str | None:
    """Return the file here that knows arrays of a type; None if it is not such a type."""
    if issubclass(kind, np.ndarray | np.generic):
        return None
    if any((base.__module__, base.__name__) == ("pyopencl.array", "Array") for base in kind.__mro__):
        return "opencl"
    if not hasattr(kind, "__dlpack__") and not hasattr(kind, "__cuda_array_interface__"):
        return None
    packages = (base.__module__.partition(".")[0] for base in kind.__mro__)
    return next((KNOWN[package] for package in packages if package in KNOWN), "other")


def on_cuda(array: Any) -> Place | None:
    """Return the CUDA device that DLPack tells; None for another device."""
    kind, number = array.__dlpack_device__()
    return Place("cuda", int(number)) if int(kind) in CUDA else None


def refuse_gradients(name: str, detached: str) -> None:
    """Raise the TypeError for an array that records gradients; `detached` is code that leaves them out."""
    raise TypeError(f"{name} requires gradients, and gpureg computes none: pass {detached}")


def numpy_has(dtype: npt.DTypeLike) -> bool:
    """Return whether a type is one of numpy itself; bfloat16 and the types of 8 bits are of other packages."""
    return np.dtype(dtype).isbuiltin == 1
