"""From a mesh file to a denoised or simpler one: what ``gpureg mesh`` does."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .. import weights
from ..files.pictures import check_place, write_files
from ..meshes.denoise import denoised
from ..meshes.filters import Filter
from ..meshes.reading import MeshError, check_format, read_mesh
from ..meshes.simplify import simplified
from ..meshes.writing import encode_mesh
from ..shapes.surface import Surface, surface_of
from .mesh_report import denoising_report, errors_of, simplification_report

WEIGHTS = ("constant", "inverse-distance", "inverse-square", "cotangent")

# Fields that only one of the two does something with, and those of both.
_DENOISING = ("filter", "taubin", "sigma", "fix_border", "max_displacement", "values")
_MODEL = ("p", "lam", "norm", "solver", "max_iter", "tol", "eps", "backend", "dtype")


@dataclass(frozen=True)
class MeshSettings:
    """What is asked for besides IN and OUT: the options of ``gpureg mesh``; None leaves it to the door."""

    filter: Filter | None = None
    taubin: bool = False
    values: str | None = None
    p: float | None = None
    lam: float | None = None
    sigma: float | None = None
    weights: str | None = None
    norm: Literal["vertex", "edge"] = "vertex"
    fix_border: bool = False
    max_displacement: float | None = None
    simplify: bool = False
    n_vertices: int | None = None
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
    def simplifies(self) -> bool:
        """Whether the mesh is to have fewer vertices, instead of less noise."""
        return self.simplify or self.n_vertices is not None

    def model(self, surface: Surface) -> dict[str, Any]:
        """What the doors are told of the model, where it is not their default."""
        found = {name: getattr(self, name) for name in _MODEL if getattr(self, name) is not None}
        chosen: Any = {
            None: None,
            "constant": weights.constant(),
            "inverse-distance": weights.inverse_distance(1),
            "inverse-square": weights.inverse_distance(2),
            "cotangent": weights.cotangent(surface.welded()[0].faces),
        }[self.weights]
        return found if chosen is None else found | {"weights": chosen}

    def check(self) -> None:
        """Refuse options that do nothing together.

        Raises
        ------
        ValueError
        """
        if self.simplifies:
            given = [name for name in _DENOISING if getattr(self, name) not in (None, False)]
            if given:
                raise ValueError(
                    f"{_option(given[0])} is for denoising, --simplify and --n-vertices are not; run twice"
                )
        elif self.values is not None and self.filter is not None:
            raise ValueError("--values are denoised in the place of the positions: leave --filter out")
        elif self.weights == "cotangent" and self.values is None and self.filter != "vertices":
            raise ValueError("--weights cotangent are between vertices: give --filter vertices")
        if self.picture is None and (self.view != "auto" or self.up is not None):
            raise ValueError("--view and --up turn the picture: give --picture too")


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def mesh_file(source: Path, target: Path, settings: MeshSettings, *, progress: bool = False) -> dict[str, Any]:
    """Denoise or simplify the mesh `source` into the file `target`, and draw both where a picture is asked for.

    All files are written, or none.

    Parameters
    ----------
    source, target : Path
    settings : MeshSettings
    progress : bool, default False
        Whether to draw a bar.

    Returns
    -------
    dict
        What was done, as JSON can hold it.

    Raises
    ------
    MeshError, PictureError
        A file that cannot be read or written, a picture where matplotlib is not installed.
    ValueError, TypeError, BackendUnavailable, FloatingPointError, MemoryError, Interrupted
        As :func:`gpureg.denoise_mesh` and :func:`gpureg.simplify_mesh`.
    """
    settings.check()
    _check_files(source, target, settings)
    surface, mesh, dtype = _read(source)
    truth = None if settings.reference is None else _read(settings.reference)[0]
    model = settings.model(surface) | {"progress": progress}
    about = {"input": str(source), "output": str(target)}
    if settings.simplifies:
        made = simplified(surface, n_vertices=settings.n_vertices, **model)
        after = Surface(made.vertices, made.faces, surface.make)
        result = surface.like(made.vertices, made.faces, made.kept)
        report = simplification_report(surface, after, made)
    else:
        names = ("taubin", "sigma", "fix_border", "max_displacement")
        values = None if settings.values is None else _values(mesh, settings.values, source)
        found = denoised(
            surface,
            filter=settings.filter or "normals",
            values=values,
            **{name: getattr(settings, name) for name in names},
            **model,
        )
        after = Surface(found.vertices, surface.faces, surface.make)
        result = surface.like(found.vertices)
        if found.values is not None and settings.values is not None:
            _put(result, settings.values, found.values)
        report = denoising_report(surface, after, found)
    if truth is not None:
        report["reference"] = {"file": str(settings.reference)} | errors_of(surface, after, truth)
    content = encode_mesh(target, result, dtype)
    writes = {target: lambda path: path.write_bytes(content)}
    if settings.picture is not None:
        figure = _drawn(surface, after, truth, settings, report)
        writes[settings.picture] = lambda path: figure.savefig(path)
        report["picture"] = str(settings.picture)
    write_files(writes)
    return about | report


def _check_files(source: Path, target: Path, settings: MeshSettings) -> None:
    """Refuse, before work is spent on them, files that cannot be written, and such as overwrite what is read."""
    check_format(target)
    check_place(target)
    read = [path for path in (settings.reference,) if path is not None]
    outputs = [("OUT", target, read)]
    if settings.picture is not None:
        from ..plot.canvas import check_path

        try:
            check_path(settings.picture)
        except ImportError as error:
            raise MeshError(f"--picture: {error}") from None
        check_place(settings.picture)
        if os.path.realpath(settings.picture) == os.path.realpath(target):
            raise ValueError(f"OUT and --picture would both be written to {target}; give each its own file")
        outputs.append(("--picture", settings.picture, [source, *read]))
    for option, path, others in outputs:
        for other in others:
            if os.path.exists(path) and os.path.exists(other) and os.path.samefile(path, other):
                raise ValueError(f"{option} {path} would overwrite {other}, which is read; give another file")


def _read(path: Path) -> tuple[Surface, Any, np.dtype[Any]]:
    """The mesh in a file as a surface and as it was read, and the type of its coordinates."""
    found = read_mesh(path)
    surface = surface_of(found.mesh)
    if path.suffix.lower() == ".stl":
        # every face has corners of its own there; in another format that would stay so
        whole, _ = surface.welded()
        surface = surface_of((whole.vertices, whole.faces))
    return surface, found.mesh, found.dtype


def _values(mesh: Any, name: str, source: Path) -> npt.NDArray[Any]:
    """The function at the vertices of that name."""
    known = list(mesh.vertex_attributes)
    if mesh.visual.kind == "vertex":
        known.insert(0, "colours")
        if name == "colours":
            colours: npt.NDArray[Any] = np.asarray(mesh.visual.vertex_colors)[:, :3]
            return colours
    if name not in mesh.vertex_attributes:
        there = f"it has {', '.join(known)}" if known else "it has none"
        raise MeshError(f"{source} has no values {name!r} at its vertices; {there}")
    return np.asarray(mesh.vertex_attributes[name])


def _put(mesh: Any, name: str, values: npt.NDArray[Any]) -> None:
    """Values in the place of those of that name, in their type."""
    if name == "colours":
        mesh.visual.vertex_colors[:, :3] = np.clip(np.rint(values), 0, 255)
        return
    kind = mesh.vertex_attributes[name].dtype
    if kind.kind in "iu":
        values = np.clip(np.rint(values), np.iinfo(kind).min, np.iinfo(kind).max)
    mesh.vertex_attributes[name] = values.astype(kind)


def _drawn(
    before: Surface, after: Surface, truth: Surface | None, settings: MeshSettings, report: dict[str, Any]
) -> Any:
    from ..plot import meshes

    drawn = {
        title: (surface.vertices, surface.faces)
        for title, surface in (("before", before), ("after", after), ("reference", truth))
        if surface is not None
    }
    return meshes(drawn, view=settings.view, up=settings.up, edges=settings.simplifies, caption=report["filter"])
