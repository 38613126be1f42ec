"""A picture of a file: its values, the letters of its axes, and its metadata."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy.typing as npt

# T time, Z, Y, X, C channels
AXES = "TZYXC"


class PictureError(OSError):
    """A picture cannot be read or written; the message says which and why."""


class AxesError(ValueError):
    """Letters of axes are wrong, or do not fit the file."""


@dataclass(frozen=True, eq=False)
class Tags:
    """The metadata of a TIFF file, to be written again.

    Attributes
    ----------
    kind : {"plain", "shaped", "imagej", "ome"}
        Format of the metadata: only TIFF tags, tifffile's JSON, ImageJ's, or OME-XML.
    named : bool
        Whether the letters of the axes are from the file or the caller, not guessed.
    samples : bool
        Whether the channels are samples of a pixel, such as red, green and blue, not pages.
    words : dict
        Metadata in the format of `kind`.
    resolution : tuple or None
        Pixels per unit along X and Y, and the unit, as in the TIFF tags.
    sizes : dict of str to float
        Size of a voxel along the axes for which the file has one, all in the same unit.
    """

    kind: Literal["plain", "shaped", "imagej", "ome"] = "plain"
    named: bool = True
    samples: bool = True
    words: dict[str, Any] = field(default_factory=dict)
    resolution: tuple[Any, Any, int] | None = None
    sizes: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Metadata:
    """What a picture file says beside its pixels, to be written again where the format of the output stores it.

    Attributes
    ----------
    exif, xmp : bytes or None
        The data of the camera and of the programs, without the orientation: pixels are turned upright.
    dpi : (float, float) or None
        Pixels per inch along X and Y.
    chunks : tuple of (bytes, bytes)
        Names and contents of the chunks of a PNG that are copied to another PNG.
    tags : tuple
        Tags of a TIFF that are copied to another TIFF: (code, type, count, value, True), as tifffile writes them.
    white : int or None
        The value of white in a PNM file, if it is neither 255 nor 65535.
    """

    exif: bytes | None = None
    xmp: bytes | None = None
    dpi: tuple[float, float] | None = None
    chunks: tuple[tuple[bytes, bytes], ...] = ()
    tags: tuple[tuple[Any, ...], ...] = ()
    white: int | None = None


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture, a volume or a series of a file.

    Attributes
    ----------
    pixels : array
        uint8, uint16 or, from TIFF, any integers and floats; (H, W) or (H, W, 3), or a stack with axes in any order.
    alpha : array or None
        Opacity, in the dtype of the pixels, with their shape without the channels.
    icc_profile : bytes or None
        The colour profile, copied to the output.
    axes : str
        One letter for each axis of the pixels: T (time), Z, Y, X or C (channels); the default is YX or YXC.
    tags : Tags
    metadata : Metadata
    nodata : float or None
        The value of pixels without data that a TIFF names (the tag of GDAL).
    notes : tuple of str
        What the reader converted or left out, as sentences.
    """

    pixels: npt.NDArray[Any]
    alpha: npt.NDArray[Any] | None = None
    icc_profile: bytes | None = None
    axes: str = ""
    tags: Tags = field(default_factory=Tags)
    metadata: Metadata = field(default_factory=Metadata)
    nodata: float | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.axes:
            object.__setattr__(self, "axes", "YX" if self.pixels.ndim == 2 else "YXC")

    @property
    def channel_axis(self) -> int | None:
        """Axis of the channels; None for a grey picture."""
        return self.axes.index("C") if "C" in self.axes else None

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.size("C")

    @property
    def cells(self) -> tuple[int, ...]:
        """Shape of the pixels without the channels."""
        return tuple(n for n, letter in zip(self.pixels.shape, self.axes, strict=True) if letter != "C")

    @property
    def is_stack(self) -> bool:
        """Whether the picture needs more than one page of grey or colour."""
        return self.axes not in ("YX", "YXC") or not self.tags.samples

    def size(self, letter: str) -> int:
        """Return the length of the axis with this letter, 1 if there is none."""
        return self.pixels.shape[self.axes.index(letter)] if letter in self.axes else 1


def checked_axes(axes: str) -> str:
    """Check the letters of axes, and return them in capitals.

    Raises
    ------
    AxesError
        An unknown letter, a letter twice, or no Y or X.
    """
    letters = axes.upper()
    if not set(letters) <= set(AXES) or len(set(letters)) < len(letters) or not {"Y", "X"} <= set(letters):
        raise AxesError(
            f"axes must be letters of T (time), Z, Y, X and C (channels), each once, with Y and X, such as ZYX or "
            f"TCYX; got {axes!r}"
        )
    return letters


def split(array: npt.NDArray[Any], where: str) -> tuple[npt.NDArray[Any], npt.NDArray[Any] | None]:
    """Split an array, (H, W) or (..., samples) with one to four samples, into colours and alpha."""
    samples = 1 if array.ndim == 2 else array.shape[-1]
    if samples > 4:
        raise PictureError(f"{where} has the shape {array.shape}, it is not one grey or RGB picture")
    if array.ndim == 2:
        return array, None
    if samples <= 2:
        return array[..., 0], array[..., 1] if samples == 2 else None
    return array[..., :3], array[..., 3] if samples == 4 else None
