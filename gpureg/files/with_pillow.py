"""Read and write what Pillow does well: PNG of 8 bits, JPEG, WebP, BMP and GIF."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .picture import Metadata, Picture, PictureError, Tags, split
from .png import chunks_of, metadata_of

# Entries of Pillow's `info` that are written again, or that do not describe the picture: they need no note.
_KEPT = {
    *("icc_profile", "exif", "xmp", "XML:com.adobe.xmp", "dpi", "transparency", "background", "version", "compression"),
    *("jfif", "jfif_version", "jfif_unit", "jfif_density", "adobe", "adobe_transform", "progressive", "progression"),
    *("gamma", "chromaticity", "srgb", "interlace", "bbox", "loop", "duration", "extension", "timestamp", "aspect"),
    *("default_image", "blend", "disposal", "mpoffset", "mp"),
}


def read_with_pillow(path: Path, where: str) -> Picture:
    """Read a picture, or an animation as a series; turned upright by its EXIF.

    Raises
    ------
    PictureError
        Frames of an animation have different sizes.
    """
    from PIL import Image, ImageOps

    with _any_size(), Image.open(path) as opened:
        frames: int = getattr(opened, "n_frames", 1)
        if opened.format == "MPO":  # a photograph with others behind it, such as a preview
            return _of(ImageOps.exif_transpose(opened), opened, where, _told(frames > 1, _FIRST.format(frames)))
        if frames == 1:
            opened.load()  # raises for a truncated file
            return _of(ImageOps.exif_transpose(opened), opened, where, ())
        parts = []
        for i in range(frames):
            opened.seek(i)
            parts.append(_of(opened.copy(), opened, where, ()))
    first = parts[0]
    notes: tuple[str, ...] = (f"an animation of {frames} frames is a series (T); how long each is shown is not kept",)
    coloured = any(part.pixels.ndim == 3 for part in parts)
    pixels = np.stack([_coloured(part.pixels) if coloured else part.pixels for part in parts])
    alphas = [part.alpha for part in parts]
    clear = any(alpha is not None and (alpha < 255).any() for alpha in alphas)
    if clear:
        notes += ("transparent places of the animation are left out of the series",)
    words = Tags("plain", True, True)
    return Picture(pixels, None, first.icc_profile, "TYXC" if coloured else "TYX", words, first.metadata, notes=notes)


_FIRST = "{} pictures are in the file; the first, the photograph itself, was taken"


def _told(is_so: bool, sentence: str) -> tuple[str, ...]:
    return (sentence,) if is_so else ()


def _coloured(pixels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=-1)


def _of(image: Any, opened: Any, where: str, notes: tuple[str, ...]) -> Picture:
    """Return the picture of an upright image; `opened` is the file."""
    profile = image.info.get("icc_profile")
    if image.mode == "P" or "transparency" in image.info:
        grey = image.mode == "L"
        clear = "transparency" in image.info
        if image.mode == "P":
            colours = np.asarray(image.getpalette() or [], np.uint8).reshape(-1, 3)
            shades = bool((colours == colours[:, :1]).all()) and not clear
            kind = "L" if shades else "RGBA" if clear else "RGB"
            named = "greys" if shades else "colours with alpha" if clear else "colours"
            notes = (*notes, f"its palette became {named}: OUT has no palette")
        else:
            kind = "LA" if grey else "RGBA"
            notes = (*notes, "its transparent colour became an alpha channel")
        image = image.convert(kind)
    elif image.mode not in ("L", "LA", "RGB", "RGBA"):
        # Bilevel becomes grey, CMYK and YCbCr become RGB, which a CMYK profile does not fit.
        if image.mode == "1":
            notes = (*notes, "its 1 bit(s) per sample became 8")
        else:
            without = " without its colour profile" if profile else ""
            notes = (*notes, f"{image.mode} colours became RGB by the plain formula{without}")
            profile = None
        image = image.convert("L" if image.mode == "1" else "RGB")
    pixels, alpha = split(np.asarray(image), where)
    info, lost = image.info, list[str]()
    xmp = info.get("xmp") or info.get("XML:com.adobe.xmp")
    metadata = Metadata(
        exif=image.getexif().tobytes() if len(image.getexif()) else None,
        xmp=xmp.encode() if isinstance(xmp, str) else xmp,
        dpi=tuple(float(dots) for dots in info["dpi"]) if info.get("dpi") else None,  # type: ignore[arg-type]
    )
    if opened.format == "PNG":
        chunks = chunks_of(Path(opened.filename).read_bytes())
        found = metadata_of(chunks)
        metadata = Metadata(exif=metadata.exif, dpi=found.dpi, chunks=found.chunks)
    else:
        lost = sorted(str(name) for name in info.keys() - _KEPT)
    return Picture(pixels, alpha, profile, metadata=metadata, notes=(*notes, *_told(bool(lost), _lost(lost))))


def _lost(names: list[str]) -> str:
    return f"not kept from the file: {', '.join(names)}"


@contextlib.contextmanager
def _any_size() -> Iterator[None]:
    """Switch off Pillow's limit on the size of pictures, which refuses a scan of 180 megapixels."""
    from PIL import Image

    guard, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        yield
    finally:
        Image.MAX_IMAGE_PIXELS = guard


def write_with_pillow(array: npt.NDArray[np.uint8], kind: str, picture: Picture) -> bytes:
    """Encode an array, (H, W) or (H, W, samples), with what the format stores of a picture's metadata."""
    from PIL import Image

    held, image, buffer = picture.metadata, Image.fromarray(array), io.BytesIO()
    extra: dict[str, Any] = {}
    if kind in ("JPEG", "WebP"):
        named = {"icc_profile": picture.icc_profile, "exif": held.exif, "xmp": held.xmp}
        extra |= {name: value for name, value in named.items() if value is not None}
    if kind in ("JPEG", "BMP") and held.dpi is not None:
        extra["dpi"] = held.dpi
    if kind == "JPEG":
        extra |= {"quality": 95, "subsampling": 0}
    if kind == "WebP":
        extra |= {"lossless": True, "exact": True}
    if kind == "GIF":
        if image.mode == "L":  # every grey has its place
            palette = np.repeat(np.arange(256, dtype=np.uint8), 3).tobytes()
            image = Image.frombytes("P", image.size, image.tobytes())
            image.putpalette(palette)
            extra["optimize"] = False
        else:
            image = image.quantize(256)
    try:
        image.save(buffer, kind, **extra)
    except ImportError as error:
        raise PictureError(f"this build of Pillow does not write {kind}: {error}") from None
    return buffer.getvalue()
