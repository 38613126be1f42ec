"""Describe the noise of picture files: the work of ``gpureg noise``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._version import __version__
from ..doors import warn
from ..files.pictures import Picture, read_picture
from ..images.raster import Raster
from ..noise.photon import PhotonNoise, estimate_photon_noise
from ..noise.report import NoiseReport, report_of
from ..noise.survey import survey
from .inputs import Inside, Source
from .report import left_out
from .slices import layout_of, mask_of


@dataclass(frozen=True)
class NoiseOptions:
    """The options of ``gpureg noise``, without IN.

    Attributes
    ----------
    offset : float or None
        The value without light, which tells the read noise of a camera.
    axes : str or None
        Letters of the axes of the picture.
    each : tuple of str
        Axes whose slices are described one by one.
    mask : Path or None
    nodata : float or None
        The value of pixels without data.
    """

    offset: float | None = None
    axes: str | None = None
    each: tuple[str, ...] = ()
    mask: Path | None = None
    nodata: float | None = None


@dataclass(frozen=True)
class NoiseOfFile:
    """The report on the noise of a picture file.

    Attributes
    ----------
    source : Path
    slices : tuple of NoiseReport
    cameras : tuple of (PhotonNoise or None)
        Gain and read noise of each slice, if there is an offset and they can be told.
    through : str
        Letters of the axes of the slices.
    left : mapping
        Numbers of pixels that are NaN or without data, and that the mask excludes.
    """

    source: Path
    slices: tuple[NoiseReport, ...]
    cameras: tuple[PhotonNoise | None, ...]
    through: str
    left: Mapping[str, int]

    def as_json(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON."""
        found = []
        for report, camera in zip(self.slices, self.cameras, strict=True):
            row = report.as_json()
            if camera is not None:
                row["camera"] = {"gain": camera.gain, "read_noise": camera.read_noise, "offset": camera.offset}
            found.append(row)
        more: dict[str, Any] = {"each": self.through, "slices": found} if self.through else found[0]
        return {"input": str(self.source), **more, **self.left, "version": __version__}

    def lines(self) -> list[str]:
        """Return the report as lines of text."""
        lines = [str(self.source)]
        for number, (report, camera) in enumerate(zip(self.slices, self.cameras, strict=True), start=1):
            if self.through:
                lines.append(f"  slice {number} of {len(self.slices)} along {self.through}")
            lines += [f"  {line}" for line in report.lines()]
            if camera is not None:
                lines.append(
                    f"  camera: gain {camera.gain:.4g}, read noise {camera.read_noise:.4g} with offset "
                    f"{camera.offset:g}"
                )
        if any(self.left.values()):
            lines.append(f"  {left_out(self.left['nan'] + self.left['nodata'], self.left['outside_mask'])}")
        return lines


def noise_of_file(source: Path, options: NoiseOptions) -> NoiseOfFile:
    """Describe the noise of a picture, a volume or a series.

    Raises
    ------
    PictureError, ValueError
        A file cannot be read, or files and options do not fit together.
    """
    picture = read_picture(source, options.axes)
    read = Source.of(picture)
    layout = layout_of(picture, source, options.each, None)
    drawn = None
    if options.mask is not None:
        drawn = mask_of(Source.of(read_picture(options.mask)), picture, source, options.mask)
    nodata = picture.nodata if options.nodata is None else options.nodata
    inside = Inside(read, source, drawn, nodata)
    reports, cameras = [], []
    for i in range(layout.slices):
        box = layout.box(i, ())
        values = read.read(box)
        known = inside.count(box) if inside.needed else None
        cells = None if known is None or known.all() else layout.part(known, picture.axes.replace("C", ""))
        raster = Raster.of(layout.part(values, picture.axes), _channels(picture), cells, axes_known=True)
        reports.append(report_of(survey(raster.values, raster.channel_axis, raster.inside)))
        cameras.append(_camera(raster, options.offset, f" in slice {i + 1}" if layout.several else ""))
    left = {"nan": inside.nans, "nodata": inside.nodata, "outside_mask": inside.masked}
    return NoiseOfFile(source, tuple(reports), tuple(cameras), layout.several, left)


def _channels(picture: Picture) -> int | None:
    return None if picture.channel_axis is None else -1


def _camera(raster: Raster, offset: float | None, where: str) -> PhotonNoise | None:
    """Return the camera of an image; None without an offset, or with a warning if it cannot be told."""
    if offset is None:
        return None
    values: Any = np.asarray(raster.values)
    try:
        return estimate_photon_noise(values, offset=offset, channel_axis=raster.channel_axis, mask=raster.inside)
    except ValueError as error:
        # a dark or saturated slice of a series: the others are described
        warn(f"the gain of the camera cannot be told{where}: {error}")
        return None
