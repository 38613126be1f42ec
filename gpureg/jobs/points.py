"""From a file of points to a denoised or clustered one: what ``gpureg points`` does."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .. import weights
from ..files.pictures import check_place, write_files
from ..points.cluster import cluster_points
from ..points.denoise import denoised
from ..points.files import PointsError, PointsFile, encode_points, point_format, read_points
from ..points.filters import PointFilter
from .points_report import clustering_report, denoising_report, errors_of

POINT_WEIGHTS = ("constant", "inverse-distance", "inverse-square")

_DENOISING = ("filter", "values", "update_neighbours", "sigma", "max_displacement", "reference")
_CLUSTERING = ("n_clusters", "min_size")
_MODEL = ("k", "p", "lam", "norm", "solver", "max_iter", "tol", "eps", "backend", "dtype")
_CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True)
class PointsSettings:
    """What is asked for besides IN and OUT: the options of ``gpureg points``; None leaves it to the door."""

    filter: PointFilter | None = None
    values: str | None = None
    columns: tuple[str, ...] | None = None
    cluster: bool = False
    n_clusters: int | None = None
    min_size: int | None = None
    k: int | None = None
    update_neighbours: int | None = None
    p: float | None = None
    lam: float | None = None
    sigma: float | None = None
    weights: str | None = None
    norm: Literal["vertex", "edge"] = "vertex"
    max_displacement: float | None = None
    solver: Literal["jacobi", "certified"] = "jacobi"
    max_iter: int | None = None
    tol: float | None = None
    eps: float | None = None
    backend: str = "auto"
    dtype: str | None = None
    reference: Path | None = None
    picture: Path | None = None
    view: tuple[float, float] | Literal["auto"] = "auto"
    up: Literal["x", "y", "z"] | None = None

    @property
    def clusters(self) -> bool:
        """Whether points get a cluster, instead of moving."""
        return self.cluster or self.n_clusters is not None

    def model(self) -> dict[str, Any]:
        """What the doors are told of the model, where it is not their default."""
        found = {name: getattr(self, name) for name in _MODEL if getattr(self, name) is not None}
        chosen: Any = {
            None: None,
            "constant": weights.constant(),
            "inverse-distance": weights.inverse_distance(1),
            "inverse-square": weights.inverse_distance(2),
        }[self.weights]
        return found if chosen is None else found | {"weights": chosen}

    def check(self) -> None:
        """Refuse options that do nothing together.

        Raises
        ------
        ValueError
        """
        idle = _DENOISING if self.clusters else _CLUSTERING
        given = [name for name in idle if getattr(self, name) is not None]
        if given and self.clusters:
            raise ValueError(f"{_option(given[0])} is for denoising, --cluster and --n-clusters are not; run twice")
        if given:
            raise ValueError(f"{_option(given[0])} is for clusters: give --cluster too")
        if self.values is not None and self.filter is not None:
            raise ValueError("--values are denoised in the place of the points: leave --filter out")
        if self.picture is None and (self.view != "auto" or self.up is not None):
            raise ValueError("--view and --up turn the picture: give --picture too")


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def points_file(source: Path, target: Path, settings: PointsSettings, *, progress: bool = False) -> dict[str, Any]:
    """Denoise or cluster the points of `source` into the file `target`, and draw them where a picture is asked for.

    All files are written, or none.

    Parameters
    ----------
    source, target : Path
    settings : PointsSettings
    progress : bool, default False
        Whether to draw a bar.

    Returns
    -------
    dict
        What was done, as JSON can hold it.

    Raises
    ------
    PointsError, PictureError
        A file that cannot be read or written, a picture where matplotlib is not installed.
    ValueError, TypeError, BackendUnavailable, FloatingPointError, MemoryError, Interrupted
        As :func:`gpureg.denoise_points` and :func:`gpureg.cluster_points`.
    """
    settings.check()
    _check_files(source, target, settings)
    given = read_points(source, columns=settings.columns)
    truth = None if settings.reference is None else read_points(settings.reference)
    model = settings.model() | {"progress": progress}
    about = {"input": str(source), "output": str(target)}
    points, columns, colours = given.points, dict(given.columns), None
    if settings.clusters:
        given_model = {name: value for name, value in model.items() if value is not None}
        labels, report = _clustered(given, settings, given_model)
        columns["cluster"] = labels
        colours = [labels, labels]
    else:
        names = ("filter", "update_neighbours", "sigma", "max_displacement")
        values = None if settings.values is None else _values(given, settings.values, source)
        found = denoised(given.points, values=values, **{name: getattr(settings, name) for name in names}, **model)
        points = found.points
        if found.values is not None and settings.values is not None:
            columns |= _named(given, settings.values, found.values)
            colours = None if found.values.ndim > 1 else [np.asarray(values, float), found.values]
        report = denoising_report(found)
        if truth is not None:
            report["reference"] = {"file": str(settings.reference)} | errors_of(given, points, truth)
    content = encode_points(target, points, columns, like=given)
    writes = {target: lambda path: path.write_bytes(content)}
    if settings.picture is not None:
        figure = _drawn(given.points, points, colours, settings, report)
        writes[settings.picture] = lambda path: figure.savefig(path)
        report["picture"] = str(settings.picture)
    write_files(writes)
    return about | report


def _clustered(
    given: PointsFile, settings: PointsSettings, model: dict[str, Any]
) -> tuple[npt.NDArray[np.int32], dict[str, Any]]:
    import time

    begin = time.perf_counter()
    labels = cluster_points(given.points, settings.n_clusters, min_size=settings.min_size, **model)
    return labels, clustering_report(labels, settings.n_clusters is not None, time.perf_counter() - begin)


def _check_files(source: Path, target: Path, settings: PointsSettings) -> None:
    """Refuse, before work is spent on them, files that cannot be written, and such as overwrite what is read."""
    point_format(target)
    check_place(target)
    read = [path for path in (settings.reference,) if path is not None]
    outputs = [("OUT", target, read)]
    if settings.picture is not None:
        from ..plot.canvas import check_path

        try:
            check_path(settings.picture)
        except ImportError as error:
            raise PointsError(f"--picture: {error}") from None
        check_place(settings.picture)
        if os.path.realpath(settings.picture) == os.path.realpath(target):
            raise ValueError(f"OUT and --picture would both be written to {target}; give each its own file")
        outputs.append(("--picture", settings.picture, [source, *read]))
    for option, path, others in outputs:
        for other in others:
            if os.path.exists(path) and os.path.exists(other) and os.path.samefile(path, other):
                raise ValueError(f"{option} {path} would overwrite {other}, which is read; give another file")


def _values(given: PointsFile, name: str, source: Path) -> npt.NDArray[Any]:
    """The function at the points of that name; colours are three columns."""
    if name == "colours" and all(channel in given.columns for channel in _CHANNELS):
        return np.stack([given.columns[channel] for channel in _CHANNELS], axis=1)
    if name not in given.columns:
        known = [*(["colours"] if _CHANNELS[0] in given.columns else []), *given.columns]
        raise PointsError(f"{source} has no values {name!r}; it has {', '.join(known) if known else 'none'}")
    return given.columns[name]


def _named(given: PointsFile, name: str, values: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
    """Regularized values as the columns that they came from, in their types."""
    if name == "colours" and name not in given.columns:
        return {channel: _typed(values[:, c], given.columns[channel]) for c, channel in enumerate(_CHANNELS)}
    return {name: _typed(values, given.columns[name])}


def _typed(values: npt.NDArray[Any], like: npt.NDArray[Any]) -> npt.NDArray[Any]:
    # text has integers where numbers happened to be whole
    if like.dtype.kind in "iu" and like.dtype.itemsize < 8:
        limits = np.iinfo(like.dtype)
        rounded: npt.NDArray[Any] = np.clip(np.rint(values), limits.min, limits.max).astype(like.dtype)
        return rounded
    return values if like.dtype.kind != "f" else values.astype(like.dtype)


def _drawn(
    before: npt.NDArray[Any], after: npt.NDArray[Any], colours: Any, settings: PointsSettings, report: dict[str, Any]
) -> Any:
    from ..plot import points

    d = before.shape[1]
    if d not in (2, 3):
        raise ValueError(f"--picture draws points of the plane or of space, these have {d} coordinates: leave it out")
    style: Any = {"view": settings.view, "up": settings.up, "caption": report["filter"]}
    if settings.clusters:
        return points({f"{report['clusters']} clusters": after}, values=colours[1:], **style)
    return points({"before": before, "after": after}, values=colours, **style)
