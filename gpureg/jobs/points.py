"""Denoise or cluster a file of points: the work of ``gpureg points``."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from ..points.cluster import cluster_points
from ..points.contents import PointsError, PointsFile
from ..points.denoise import denoised
from ..points.files import POINT_FORMATS, encode_points, lost_in, point_format, read_all, read_points
from ..points.filters import PointFilter
from ..points.renewed import renewed_normals
from ..points.report import PointDenoising
from .many import Many, treat_files
from .options import ViewedSettings
from .outputs import Outputs
from .points_report import ClusteringReport, PointDenoisingReport, PointErrors

_DENOISING = ("filter", "values", "update_neighbours", "sigma", "max_displacement", "reference")
_CLUSTERING = ("n_clusters", "min_size")
_CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True, kw_only=True)
class PointsSettings(ViewedSettings):
    """The options, without IN and OUT, of ``gpureg points``."""

    MODEL: ClassVar[tuple[str, ...]] = ("k", *ViewedSettings.MODEL)

    filter: PointFilter | None = None
    values: str | None = None
    columns: tuple[str, ...] | None = None
    cluster: bool = False
    n_clusters: int | None = None
    min_size: int | None = None
    k: int | None = None
    update_neighbours: int | None = None
    max_displacement: float | None = None

    @property
    def clusters(self) -> bool:
        """Whether to cluster the points instead of denoising them."""
        return self.cluster or self.n_clusters is not None

    def check(self) -> None:
        """Raise ValueError for combinations of options that have no effect."""
        given = self.first_given(_DENOISING if self.clusters else _CLUSTERING)
        if given is not None and self.clusters:
            raise ValueError(f"{given} is for denoising, --cluster and --n-clusters are not; run twice")
        if given is not None:
            raise ValueError(f"{given} is for clusters: give --cluster too")
        if self.values is not None and self.filter is not None:
            raise ValueError("--values are denoised instead of the points: leave --filter out")
        self.check_view()


def points_file(
    source: Path, target: Path, settings: PointsSettings, *, progress: bool = False
) -> PointDenoisingReport | ClusteringReport:
    """Denoise or cluster the points of `source` into the file `target`, and draw them if a picture is asked for.

    All files are written, or none.

    Parameters
    ----------
    source, target : Path
    settings : PointsSettings
    progress : bool, default False
        Whether to show a progress bar.

    Returns
    -------
    PointDenoisingReport or ClusteringReport

    Raises
    ------
    PointsError, PictureError
        A file cannot be read or written, or matplotlib is missing for the picture.
    ValueError, TypeError, BackendUnavailable, FloatingPointError, MemoryError, Interrupted
        As :func:`gpureg.denoise_points` and :func:`gpureg.cluster_points`.
    """
    settings.check()
    point_format(target)
    outputs = Outputs(source, settings.reference)
    outputs.expect("OUT", target)
    outputs.expect_picture(settings.picture, PointsError)
    whole = read_all(source, settings.columns)
    finite: npt.NDArray[np.bool_] = np.asarray(np.isfinite(whole.points).all(axis=1))
    if not finite.any():
        raise PointsError(f"{source} has no point that is finite")
    given = whole if finite.all() else _part(whole, finite)
    work = _clustered if settings.clusters else _denoised
    points, columns, colours, report = work(given, source, target, settings, progress)
    drawn = points
    notes = [f"{name} not kept" for name in lost_in(target, whole)]
    if not finite.all():
        points, columns = _put_back(whole, finite, points, columns)
        notes.append(f"{int((~finite).sum())} points are not finite; they took no part and stay as they are")
    outputs.put(target, encode_points(target, points, dict(whole.columns) | columns, like=whole))
    if settings.picture is not None:
        outputs.draw(settings.picture, _drawn(given.points, drawn, colours, settings, report))
    outputs.write()
    return replace(report, notes=(*report.notes, *notes))


def points_files(sources: Sequence[Path], folder: Path, settings: PointsSettings, *, progress: bool = False) -> Many:
    """Denoise or cluster files of points into a folder, which is created if it does not exist.

    Raises
    ------
    PictureError, ValueError
        The options are wrong for all files; raised before any work.
    """
    settings.check()
    if settings.picture is not None:
        raise ValueError("--picture is for one file: leave it out")
    read = [] if settings.reference is None else [settings.reference]
    return treat_files(
        sources,
        folder,
        lambda a, b: points_file(a, b, settings),
        others=read,
        formats=POINT_FORMATS,
        progress=progress,
    )


def _part(whole: PointsFile, rows: npt.NDArray[np.bool_]) -> PointsFile:
    columns = {name: values[rows] for name, values in whole.columns.items()}
    return replace(whole, points=whole.points[rows], columns=columns)


def _put_back(
    whole: PointsFile, rows: npt.NDArray[np.bool_], points: npt.NDArray[Any], columns: dict[str, npt.NDArray[Any]]
) -> tuple[npt.NDArray[Any], dict[str, npt.NDArray[Any]]]:
    """Return all points, and the columns that changed; a cluster is -1 where there is none."""
    every = whole.points.copy()
    every[rows] = points
    changed = {}
    for name, values in columns.items():
        old = whole.columns.get(name)
        new = np.full((len(rows), *values.shape[1:]), -1, values.dtype) if old is None else old.astype(values.dtype)
        new[rows] = values
        changed[name] = new
    return every, changed


# The points, the new columns, the values for the colours before and after, and the report.
_Done = tuple[
    npt.NDArray[Any],
    dict[str, npt.NDArray[Any]],
    list[npt.NDArray[Any]] | None,
    PointDenoisingReport | ClusteringReport,
]


def _denoised(given: PointsFile, source: Path, target: Path, settings: PointsSettings, progress: bool) -> _Done:
    truth = None if settings.reference is None else read_points(settings.reference)
    values = None if settings.values is None else _values(given, settings.values, source)
    told = settings.model("filter", "update_neighbours", "sigma", "max_displacement")
    found = denoised(given.points, values=values, progress=progress, **told)
    columns: dict[str, npt.NDArray[Any]] = {}
    colours, notes = None, list[str]()
    if found.moves and given.normals:
        columns, notes = _normals(given, found)
    if values is not None and settings.values is not None:
        columns = _named(given, settings.values, found.value)
        colours = None if found.value.ndim > 1 else [np.asarray(values, float), found.value]
    errors = None
    if truth is not None and settings.reference is not None:
        errors = PointErrors.of(settings.reference, given.points, found.points, truth)
    report = PointDenoisingReport(
        input=source,
        output=target,
        filter=found.describe(),
        results=found.results,
        seconds=found.seconds,
        picture=settings.picture,
        found=found,
        errors=errors,
        notes=tuple(notes),
    )
    return found.points, columns, colours, report


def _normals(given: PointsFile, found: PointDenoising) -> tuple[dict[str, npt.NDArray[Any]], list[str]]:
    """Compute the normals in a file again, as its columns; and say so."""
    names = given.normals
    old = [np.asarray(given.columns[name]) for name in names]
    new = renewed_normals(found, np.stack(old, axis=1) if len(names) > 1 else old[0].astype(np.float64))
    if new is None:
        told = f"the normals {', '.join(names)} are 0 now: the points moved, and are too few for new ones"
        return {name: np.zeros_like(values) for name, values in zip(names, old, strict=True)}, [told]
    parts = new.T if len(names) > 1 else [new]
    columns = {name: part.astype(values.dtype) for name, part, values in zip(names, parts, old, strict=True)}
    return columns, [f"the normals {', '.join(names)} are computed again for the moved points, on their old side"]


def _clustered(given: PointsFile, source: Path, target: Path, settings: PointsSettings, progress: bool) -> _Done:
    begin = time.perf_counter()
    count = settings.n_clusters
    labels = cluster_points(given.points, count, min_size=settings.min_size, progress=progress, **settings.model())
    report = ClusteringReport(
        input=source,
        output=target,
        seconds=time.perf_counter() - begin,
        picture=settings.picture,
        labels=labels,
        given=count is not None,
    )
    return given.points, {"cluster": labels}, [labels, labels], report


def _values(given: PointsFile, name: str, source: Path) -> npt.NDArray[Any]:
    """Return the values with this name at the points, (n,), or (n, 3) for colours."""
    if name == "colours" and all(channel in given.columns for channel in _CHANNELS):
        return np.stack([given.columns[channel] for channel in _CHANNELS], axis=1)
    if name not in given.columns:
        known = [*(["colours"] if _CHANNELS[0] in given.columns else []), *given.columns]
        raise PointsError(f"{source} has no values {name!r}; it has {', '.join(known) if known else 'none'}")
    return given.columns[name]


def _named(given: PointsFile, name: str, values: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
    """Convert regularized values, (n,) or (n, 3), to the columns of the file, in the same types."""
    if name == "colours" and name not in given.columns:
        return {channel: _typed(values[:, c], given.columns[channel]) for c, channel in enumerate(_CHANNELS)}
    return {name: _typed(values, given.columns[name])}


def _typed(values: npt.NDArray[Any], like: npt.NDArray[Any]) -> npt.NDArray[Any]:
    # a column of text is int64 if its numbers happen to be whole; its regularized values are not rounded
    if like.dtype.kind in "iu" and like.dtype.itemsize < 8:
        limits = np.iinfo(like.dtype)
        rounded: npt.NDArray[Any] = np.clip(np.rint(values), limits.min, limits.max).astype(like.dtype)
        return rounded
    return values if like.dtype.kind != "f" else values.astype(like.dtype)


def _drawn(
    before: npt.NDArray[Any],
    after: npt.NDArray[Any],
    colours: list[npt.NDArray[Any]] | None,
    settings: PointsSettings,
    report: PointDenoisingReport | ClusteringReport,
) -> Any:
    from ..plot import points

    d = before.shape[1]
    if d not in (2, 3):
        raise ValueError(f"--picture draws points with 2 or 3 coordinates, these have {d}: leave it out")
    style: Any = {"view": settings.view, "up": settings.up, "caption": report.filter}
    if isinstance(report, ClusteringReport):
        return points({f"{len(report.sizes)} clusters": after}, values=[report.labels], **style)
    return points({"before": before, "after": after}, values=colours, **style)
