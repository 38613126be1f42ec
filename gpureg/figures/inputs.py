"""What the figures are drawn of: the reader's files, or what comes with scikit-image or is made."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..curves.files import CurveError, read_curves
from ..files.picture import Picture, PictureError
from ..files.pictures import read_picture
from ..meshes.reading import read_mesh
from . import made

Pair = tuple[FloatArray, IntArray]

# The least height and width of a reader's picture.
_LEAST = 32


class Image(NamedTuple):
    """A picture, 0 to 255: (H, W), or (H, W, 3) in colour."""

    name: str
    pixels: FloatArray


class Mesh(NamedTuple):
    """A mesh."""

    name: str
    mesh: Pair


class Curve(NamedTuple):
    """A closed curve, and whether its y points up."""

    name: str
    points: FloatArray
    upright: bool


@dataclass(frozen=True)
class Inputs:
    """What to draw the figures of, and how.

    Attributes
    ----------
    image : Path, optional
        A picture for figures 1 to 4. None: scikit-image's camera, and its astronaut for figure 3.
    mesh : Path, optional
        A mesh for figures 6 and 8. None: made ones.
    curve : Path, optional
        Curves for figures 5, 7 and 9; the first closed one is taken. None: scikit-image's horse, and a made coast.
    noise : bool, default True
        Figures 3, 5 and 6 add noise to what is given; False takes it as it is: noisy.
    quick : bool, default False
        Smaller pictures and made shapes: all figures within a minute.
    backend : str, default "auto"
        As in :func:`gpureg.regularize`.
    """

    image: Path | None = None
    mesh: Path | None = None
    curve: Path | None = None
    noise: bool = True
    quick: bool = False
    backend: str = "auto"

    def grey(self, side: int) -> Image:
        """The picture in grey, so many pixels along its longer side at most."""
        if self.image is None:
            from skimage import data

            return _reduced("scikit-image's camera", data.camera().astype(np.float64), side)
        image = self._image(self.image)
        if image.pixels.ndim == 3:
            from skimage.color import rgb2gray

            image = image._replace(pixels=255 * rgb2gray(image.pixels / 255))
        return _reduced(*image, side)

    def colour(self, side: int) -> Image:
        """The picture in colour where it has any."""
        if self.image is None:
            from skimage import data

            # her face, the flag and the model of the shuttle
            return _reduced("scikit-image's astronaut", data.astronaut()[:320, 100:420].astype(np.float64), side)
        return _reduced(*self._image(self.image), side)

    def surface(self, cad: bool) -> Mesh:
        """The mesh, or a made one: of a machine part, or of an animal."""
        if self.mesh is not None:
            read = read_mesh(self.mesh)
            return Mesh(self.mesh.name, (read.vertices, read.faces))
        if cad:
            return Mesh("a made bracket", made.bracket(6 if self.quick else 8))
        return Mesh("a made animal", made.animal(14 if self.quick else 36))

    def outline(self) -> Curve:
        """The curve, or the outline of scikit-image's horse."""
        if self.curve is not None:
            return self._closed(self.curve)
        from skimage import data
        from skimage.measure import find_contours

        outline = max(find_contours((~data.horse()).astype(float), 0.5), key=len)[:-1, ::-1]
        return Curve("the outline of scikit-image's horse", np.array(outline[:: 4 if self.quick else 1]), False)

    def coast(self) -> Curve:
        """The curve, or a made coast."""
        if self.curve is not None:
            return self._closed(self.curve)
        return Curve("a made coast", made.coast(300 if self.quick else 600), True)

    def _image(self, path: Path) -> Image:
        picture = read_picture(path)
        if picture.pixels.ndim - ("C" in picture.axes) != 2:
            raise PictureError(f"{path}: the figures are of pictures, not of the axes {picture.axes}")
        pixels = _to_255(picture, path)
        if min(pixels.shape[:2]) < _LEAST:
            raise PictureError(f"{path}: the figures need {_LEAST} x {_LEAST} pixels and more, got {pixels.shape[:2]}")
        if pixels.min() == pixels.max():
            raise PictureError(f"{path}: all of its pixels are {pixels.min():g} of 255: there is nothing to see in it")
        return Image(path.name, pixels)

    def _closed(self, path: Path) -> Curve:
        read = read_curves(path)
        for curve in read.curves:
            if curve.closed and curve.points.shape[1] == 2:
                return Curve(path.name, curve.points, path.suffix.lower() != ".svg")
        raise CurveError(f"{path}: the figures are of a closed curve of the plane, of which there is none")


def _to_255(picture: Picture, path: Path) -> FloatArray:
    """Pixels from 0 to 255, the unit of the figures' parameters: integers by their type, others by their span."""
    pixels: npt.NDArray[Any] = np.moveaxis(picture.pixels, picture.axes.index("C"), -1) if "C" in picture.axes else (
        picture.pixels
    )  # fmt: skip
    if pixels.ndim == 3 and pixels.shape[-1] != 3:
        pixels = pixels.mean(axis=-1)
    if pixels.dtype.kind in "iu":
        low, high = 0.0, float(np.iinfo(pixels.dtype).max)
    else:
        if not np.isfinite(pixels).all():
            raise PictureError(f"{path}: not all of its values are finite")
        low, high = float(pixels.min()), float(pixels.max())
    scaled: FloatArray = (pixels.astype(np.float64) - low) * (255 / (high - low or 1.0))
    return scaled


def _reduced(name: str, pixels: FloatArray, side: int) -> Image:
    """Reduced by means over its pixels to `side` along the longer axis, rounded as a file would be."""
    longest = max(pixels.shape[:2])
    if longest > side:
        from skimage.transform import resize_local_mean

        shape = tuple(max(round(n * side / longest), 8) for n in pixels.shape[:2])
        pixels = resize_local_mean(pixels, shape, channel_axis=-1 if pixels.ndim == 3 else None)
        name = f"{name}, reduced to {shape[1]} x {shape[0]}"
    return Image(name, np.rint(pixels))
