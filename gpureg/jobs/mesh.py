"""Denoise or simplify a mesh file: the work of ``gpureg mesh``."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import metrics
from ..meshes.beside import KEY, Beside, Told
from ..meshes.denoise import denoised
from ..meshes.filters import Filter
from ..meshes.reading import FORMATS, MeshError, MeshFile, check_format, load_mesh
from ..meshes.simplify import simplified
from ..meshes.writing import encode_mesh, loss_of_digits
from ..shapes.surface import Surface, surface_of, taken_apart
from ..weights import cotangent
from .many import Many, treat_files
from .mesh_report import Measures, MeshDenoisingReport, MeshErrors, MeshReport, MeshSimplificationReport
from .options import WEIGHTS, ViewedSettings
from .outputs import Outputs
from .slices import beside

MESH_WEIGHTS = (*WEIGHTS, "cotangent")

_OCTAHEDRON = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])

# The options that are only for denoising.
_DENOISING = ("filter", "taubin", "sigma", "fix_border", "max_displacement", "values")


@dataclass(frozen=True, kw_only=True)
class MeshSettings(ViewedSettings):
    """The options, without IN and OUT, of ``gpureg mesh``."""

    filter: Filter | None = None
    taubin: bool = False
    values: str | None = None
    fix_border: bool = False
    max_displacement: float | None = None
    simplify: bool = False
    n_vertices: int | None = None

    @property
    def simplifies(self) -> bool:
        """Whether to simplify the mesh instead of denoising it."""
        return self.simplify or self.n_vertices is not None

    def model_on(self, surface: Surface, *names: str) -> dict[str, Any]:
        """Return the given options of the model and those of these names, for a surface."""
        told = self.model(*names)
        return told if self.weights != "cotangent" else told | {"weights": cotangent(surface.welded()[0].faces)}

    def check(self) -> None:
        """Raise ValueError for combinations of options that have no effect."""
        given = self.first_given(_DENOISING)
        if self.simplifies and given is not None:
            raise ValueError(f"{given} is for denoising, --simplify and --n-vertices are not; run twice")
        if not self.simplifies and self.values is not None and self.filter is not None:
            raise ValueError("--values are denoised instead of the positions: leave --filter out")
        if not self.simplifies and self.weights == "cotangent" and self.values is None and self.filter != "positions":
            raise ValueError("--weights cotangent needs --filter positions or --values")
        self.check_view()


def mesh_file(source: Path, target: Path, settings: MeshSettings, *, progress: bool = False) -> MeshReport:
    """Denoise or simplify the mesh `source` into the file `target`, and draw both if a picture is asked for.

    All files are written, or none.

    Parameters
    ----------
    source, target : Path
    settings : MeshSettings
    progress : bool, default False
        Whether to show a progress bar.

    Returns
    -------
    MeshReport

    Raises
    ------
    MeshError, PictureError
        A file cannot be read or written, or matplotlib is missing for the picture.
    ValueError, TypeError, BackendUnavailable, FloatingPointError, MemoryError, Interrupted
        As :func:`gpureg.denoise_mesh` and :func:`gpureg.simplify_mesh`.
    """
    settings.check()
    check_format(target)
    reference = None if settings.reference is None else beside(settings.reference, source)
    outputs = Outputs(source, reference)
    outputs.expect("OUT", target)
    outputs.expect_picture(settings.picture, MeshError)
    given = load_mesh(source)
    surface = _surface(given)
    truth = None if reference is None else _surface(load_mesh(reference))
    work = _simplified if settings.simplifies else _denoised
    result, after, report, lost = work(source, target, surface, given.mesh, settings, progress)
    if truth is not None and reference is not None:
        report = replace(report, errors=MeshErrors.of(reference, surface, after, truth))
    encoded, notes = _encoded(source, target, given, surface, result, after)
    changed = [f"the new mesh lost {', '.join(lost)}"] if lost else []
    report = replace(report, notes=(*report.notes, *given.told.lines("not read:"), *surface.notes, *changed, *notes))
    outputs.put(target, encoded)
    if settings.picture is not None:
        outputs.draw(settings.picture, _drawn(surface, after, truth, settings, report.filter))
    outputs.write()
    return report


def mesh_files(sources: Sequence[Path], folder: Path, settings: MeshSettings, *, progress: bool = False) -> Many:
    """Denoise or simplify the meshes of many files into a folder; the parameters are as in :func:`mesh_file`.

    ``settings.reference`` is one file for all, or a folder with files named as the inputs.

    Raises
    ------
    PictureError, ValueError
        The options or the folder are wrong for all files; raised before any work.
    """
    settings.check()
    if settings.picture is not None:
        raise ValueError("--picture is one file: it needs a single IN")
    _rehearse(settings)
    read_too = [] if settings.reference is None else [beside(settings.reference, source) for source in sources]
    return treat_files(
        sources,
        folder,
        lambda source, target: mesh_file(source, target, settings),
        others=read_too,
        formats=FORMATS,
        progress=progress,
    )


def _rehearse(settings: MeshSettings) -> None:
    """Use the options for an octahedron, so that wrong ones are found before any work."""
    surface = surface_of(np.concatenate([np.eye(3), -np.eye(3)]), _OCTAHEDRON)
    names = () if settings.simplifies else ("filter", "sigma", "max_displacement")
    options = settings.model_on(surface, *names)
    if settings.max_iter is not None and settings.max_iter > 1:
        options["max_iter"] = 1
    with warnings.catch_warnings():
        # what is said of the octahedron concerns nobody
        warnings.simplefilter("ignore")
        if settings.simplifies:
            simplified(surface, n_vertices=settings.n_vertices, **options)
            return
        denoised(
            surface,
            values=None if settings.values is None else np.arange(6.0),
            taubin=settings.taubin,
            fix_border=settings.fix_border,
            **options,
        )


def _denoised(
    source: Path, target: Path, surface: Surface, mesh: Any, settings: MeshSettings, progress: bool
) -> tuple[Any, Surface, MeshReport, list[str]]:
    values = None if settings.values is None else _values(mesh, settings.values, source)
    found = denoised(
        surface,
        values=values,
        taubin=settings.taubin,
        fix_border=settings.fix_border,
        progress=progress,
        **settings.model_on(surface, "filter", "sigma", "max_displacement"),
    )
    after = Surface(found.vertices, surface.faces, surface.make)
    result, lost = surface.made(found.vertices)
    if settings.values is not None:
        _put(result, settings.values, found.value)
    report = MeshDenoisingReport(
        input=source,
        output=target,
        filter=found.describe(),
        results=found.results,
        seconds=found.seconds,
        picture=settings.picture,
        measures=Measures.of(surface, after) if found.moves else None,
        found=found,
    )
    return result, after, report, lost


def _simplified(
    source: Path, target: Path, surface: Surface, mesh: Any, settings: MeshSettings, progress: bool
) -> tuple[Any, Surface, MeshReport, list[str]]:
    found = simplified(surface, n_vertices=settings.n_vertices, progress=progress, **settings.model_on(surface))
    after = Surface(found.vertices, found.faces, surface.make)
    rounds = len(found.results)
    each = f"{rounds} rounds of " if rounds > 1 else ""
    report = MeshSimplificationReport(
        input=source,
        output=target,
        filter=f"vertices that meet become one; {each}{found.results[0].iterations} iterations",
        results=found.results,
        seconds=found.seconds,
        picture=settings.picture,
        measures=Measures.of(surface, after),
        found=found,
        hausdorff=metrics.hausdorff((after.vertices, after.faces), (surface.vertices, surface.faces)),
        notes=tuple(found.notes),
    )
    result, lost = surface.made(found.vertices, found.carried)
    return result, after, report, lost


def _surface(given: MeshFile) -> Surface:
    return taken_apart(given.mesh)


def _encoded(
    source: Path, target: Path, given: MeshFile, before: Surface, result: Any, after: Surface
) -> tuple[bytes, list[str]]:
    """Encode the result; return notes on what the file has no place for."""
    kind, told = check_format(target), Told()
    moved = after.vertices - before.vertices if after.vertices.shape == before.vertices.shape else None
    change = None if moved is None else float(np.sqrt((moved**2).sum(axis=1).mean()))
    dtype: np.dtype[Any] | None = given.dtype
    # a PLY of the type of IN, unless that loses what was done
    if kind == "PLY" and dtype == np.float32 and loss_of_digits(after, "the file holds", change):
        dtype = None
        told.notes.append("the coordinates are float64 now: float32, as in IN, would lose too much of what was changed")
    encoded = encode_mesh(target, result, dtype, told=told, change=change)
    needed = _needed(result.metadata[KEY], kind)
    missing = [name for name in needed if not (target.parent / name).exists()]
    if missing and source.absolute().parent != target.absolute().parent:
        told.notes.append(f"OUT needs {', '.join(missing)} beside it: copy what lies beside IN")
    return encoded, told.lines(f"{kind} has no place for")


def _needed(beside: Beside, kind: str) -> list[str]:
    """List the files of materials and textures that a file of this kind names."""
    if kind == "OBJ":
        return list(beside.libraries)
    words = (line.split(None, 2) for line in beside.comments)
    return [w[2] for w in words if kind == "PLY" and len(w) == 3 and w[1].lower() == "texturefile"]


def _values(mesh: Any, name: str, source: Path) -> npt.NDArray[Any]:
    """Return the values with this name at the vertices, (n,) or (n, 3)."""
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
    """Replace the values with this name by values (n,) or (n, 3), in the same type."""
    if name == "colours":
        mesh.visual.vertex_colors[:, :3] = np.clip(np.rint(values), 0, 255)
        return
    kind = mesh.vertex_attributes[name].dtype
    if kind.kind in "iu":
        values = np.clip(np.rint(values), np.iinfo(kind).min, np.iinfo(kind).max)
    mesh.vertex_attributes[name] = values.astype(kind)


def _drawn(before: Surface, after: Surface, truth: Surface | None, settings: MeshSettings, caption: str) -> Any:
    from ..plot import meshes

    drawn = {
        title: (surface.vertices, surface.faces)
        for title, surface in (("before", before), ("after", after), ("reference", truth))
        if surface is not None
    }
    return meshes(drawn, view=settings.view, up=settings.up, edges=settings.simplifies, caption=caption)
