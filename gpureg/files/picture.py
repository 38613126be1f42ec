"""What a picture is between a file and the work: values, the letters of their axes, and what the file says besides."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy.typing as npt

# T time, Z, Y, X, C channels
AXES = "TZYXC"


class PictureError(OSError):
    """A picture that cannot be read or written; the message says which and why."""


class AxesError(ValueError):
    """Letters of axes that are none, or not those of a file."""


@dataclass(frozen=True, eq=False)
class Tags:
    """What a TIFF file says of its values, to be written again.

    Attributes
    ----------
    kind : {"plain", "shaped", "imagej", "ome"}
        Whose words: a TIFF's own tags alone, tifffile's JSON, ImageJ's, or OME-XML.
    named : bool
        Whether the letters of the axes come from the file or the caller, and are no guess.
    samples : bool
        Whether the channels are the samples of a pixel, such as red, green and blue, and no axis of pages.
    words : dict
        Metadata in the terms of `kind`.
    resolution : tuple or None
        Pixels per unit along X and Y, and the unit, as the tags of TIFF hold them.
    sizes : dict of str to float
        Size of a voxel along the axes for which the file names one, in one unit.
    """

    kind: Literal["plain", "shaped", "imagej", "ome"] = "plain"
    named: bool = True
    samples: bool = True
    words: dict[str, Any] = field(default_factory=dict)
    resolution: tuple[Any, Any, int] | None = None
    sizes: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture, a volume or a series as a file holds it.

    Attributes
    ----------
    pixels : array
        uint8, uint16 or, from TIFF, float; (H, W) or (H, W, 3), or a stack of any order of axes.
    alpha : array or None
        Opacity, in the dtype of the pixels and their shape without the channels.
    icc_profile : bytes or None
        The colour profile, carried through.
    axes : str
        A letter for each axis of the pixels, of T (time), Z, Y, X and C (channels); by default YX or YXC.
    tags : Tags
    """

    pixels: npt.NDArray[Any]
    alpha: npt.NDArray[Any] | None = None
    icc_profile: bytes | None = None
    axes: str = ""
    tags: Tags = field(default_factory=Tags)

    def __post_init__(self) -> None:
        if not self.axes:
            object.__setattr__(self, "axes", "YX" if self.pixels.ndim == 2 else "YXC")

    @property
    def channel_axis(self) -> int | None:
        """Axis of the channels; None for grey."""
        return self.axes.index("C") if "C" in self.axes else None

    @property
    def channels(self) -> int:
        """How many channels there are."""
        return self.size("C")

    @property
    def cells(self) -> tuple[int, ...]:
        """The shape without the channels."""
        return tuple(n for n, letter in zip(self.pixels.shape, self.axes, strict=True) if letter != "C")

    @property
    def is_stack(self) -> bool:
        """Whether a picture file of one page in grey or colours does not hold it."""
        return self.axes not in ("YX", "YXC") or not self.tags.samples

    def size(self, letter: str) -> int:
        """Length of the axis of this letter, 1 where there is none."""
        return self.pixels.shape[self.axes.index(letter)] if letter in self.axes else 1


def checked_axes(axes: str) -> str:
    """The letters of axes in capitals, one of each.

    Raises
    ------
    AxesError
        Other letters, one twice, or no Y or X.
    """
    letters = axes.upper()
    if not set(letters) <= set(AXES) or len(set(letters)) < len(letters) or not {"Y", "X"} <= set(letters):
        raise AxesError(
            f"axes must be letters of T (time), Z, Y, X and C (channels), each once, with Y and X, such as ZYX or "
            f"TCYX; got {axes!r}"
        )
    return letters


def split(array: npt.NDArray[Any], where: str) -> tuple[npt.NDArray[Any], npt.NDArray[Any] | None]:
    """Colours and alpha of a grey picture, or of an array whose last axis holds one to four samples."""
    samples = 1 if array.ndim == 2 else array.shape[-1]
    if samples > 4:
        raise PictureError(f"{where} holds an array of shape {array.shape}, not one grey or RGB picture")
    if array.ndim == 2:
        return array, None
    if samples <= 2:
        return array[..., 0], array[..., 1] if samples == 2 else None
    return array[..., :3], array[..., 3] if samples == 4 else None
