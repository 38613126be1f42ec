"""The inputs of the figures: the user's files, or pictures of scikit-image and generated shapes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..curves.contents import CurveError
from ..curves.files import read_curves
from ..files.picture import Picture, PictureError
from ..files.pictures import read_picture
from ..meshes.reading import read_mesh
from . import made

Pair = tuple[FloatArray, IntArray]

# The smallest height and width of a picture.
_LEAST = 32


class Image(NamedTuple):
    """A picture with values from 0 to 255: (H, W), or (H, W, 3) in colour."""

    name: str
    pixels: FloatArray


class Mesh(NamedTuple):
    """A mesh (vertices, faces)."""

    name: str
    mesh: Pair


class Curve(NamedTuple):
    """A closed curve (n, 2), and whether its y axis points up."""

    name: str
    points: FloatArray
    upright: bool


@dataclass(frozen=True)
class Inputs:
    """The inputs and options of the figures.

    Attributes
    ----------
    image : Path, optional
        Picture for figures 1 to 4. The default is scikit-image's camera, and its astronaut for figure 3.
    mesh : Path, optional
        Mesh for figures 6 and 8. The default is generated meshes.
    curve : Path, optional
        Figures 5, 7 and 9 use its first closed curve. The default is scikit-image's horse, and a generated coast.
    noise : bool, default True
        Whether figures 3, 5 and 6 add noise to the input. False if the input is noisy itself.
    quick : bool, default False
        Use smaller pictures and shapes: all figures within a minute.
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
        """Return the picture in grey, with at most `side` pixels along its longer side."""
        if self.image is None:
            from skimage import data

            return _reduced("scikit-image's camera", data.camera().astype(np.float64), side)
        image = self._image(self.image)
        if image.pixels.ndim == 3:
            from skimage.color import rgb2gray

            image = image._replace(pixels=255 * rgb2gray(image.pixels / 255))
        return _reduced(*image, side)

    def colour(self, side: int) -> Image:
        """Return the picture, in colour if it has colours, with at most `side` pixels along its longer side."""
        if self.image is None:
            from skimage import data

            # her face, the flag and the model of the shuttle
            return _reduced("scikit-image's astronaut", data.astronaut()[:320, 100:420].astype(np.float64), side)
        return _reduced(*self._image(self.image), side)

    def surface(self, cad: bool) -> Mesh:
        """Return the mesh, or a generated one: a machine part if `cad`, otherwise an animal."""
        if self.mesh is not None:
            read = read_mesh(self.mesh)
            return Mesh(self.mesh.name, (read.vertices, read.faces))
        if cad:
            return Mesh("a made bracket", made.bracket(6 if self.quick else 8))
        return Mesh("a made animal", made.animal(14 if self.quick else 36))

    def outline(self) -> Curve:
        """Return the curve, or the outline of scikit-image's horse."""
        if self.curve is not None:
            return self._closed(self.curve)
        from skimage import data
        from skimage.measure import find_contours

        outline = max(find_contours((~data.horse()).astype(float), 0.5), key=len)[:-1, ::-1]
        return Curve("the outline of scikit-image's horse", np.array(outline[:: 4 if self.quick else 1]), False)

    def coast(self) -> Curve:
        """Return the curve, or a generated coast."""
        if self.curve is not None:
            return self._closed(self.curve)
        return Curve("a made coast", made.coast(300 if self.quick else 600), True)

    def _image(self, path: Path) -> Image:
        picture = read_picture(path)
        if picture.pixels.ndim - ("C" in picture.axes) != 2:
            raise PictureError(f"{path}: the figures need a picture with the axes YX, got {picture.axes}")
        pixels = _to_255(picture, path)
        if min(pixels.shape[:2]) < _LEAST:
            raise PictureError(f"{path}: the figures need {_LEAST} x {_LEAST} pixels and more, got {pixels.shape[:2]}")
        if pixels.min() == pixels.max():
            raise PictureError(f"{path}: all pixels have the value {pixels.min():g} of 255, there is nothing to see")
        return Image(path.name, pixels)

    def _closed(self, path: Path) -> Curve:
        read = read_curves(path)
        for curve in read.curves:
            if curve.closed and curve.points.shape[1] == 2:
                return Curve(path.name, curve.points, path.suffix.lower() != ".svg")
        raise CurveError(f"{path}: the figures need a closed curve in the plane, and there is none")


def _to_255(picture: Picture, path: Path) -> FloatArray:
    """Scale pixels to 0 to 255, as the parameters need: integers by the limits of their type, others by their range."""
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
    """Reduce to `side` pixels along the longer axis by local means, and round to integers as in a file."""
    longest = max(pixels.shape[:2])
    if longest > side:
        from skimage.transform import resize_local_mean

        shape = tuple(max(round(n * side / longest), 8) for n in pixels.shape[:2])
        pixels = resize_local_mean(pixels, shape, channel_axis=-1 if pixels.ndim == 3 else None)
        name = f"{name}, reduced to {shape[1]} x {shape[0]}"
    return Image(name, np.rint(pixels))
