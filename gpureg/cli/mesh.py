"""``gpureg mesh``: denoise or simplify a triangle mesh."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ..jobs.batch import expand
from ..jobs.mesh import MESH_WEIGHTS, MeshSettings, mesh_file, mesh_files
from ..meshes.filters import FILTERS
from ..model.problem import NORMS
from . import options
from .group import sentences
from .options import FILE
from .terminal import tell, tell_many


@click.command(
    epilog=options.examples(
        "gpureg mesh scan.ply clean.ply --picture both.png",
        "gpureg mesh part.stl small.ply --n-vertices 5000",
        "gpureg mesh bunny.ply smooth.ply --filter positions --weights inverse-square --lam 0 --max-iter 8    # Fig. 6",
    ),
    short_help="Denoise or simplify a triangle mesh.",
)
@click.argument("paths", metavar="IN... OUT", nargs=-1)
@click.option(
    "--filter",
    type=click.Choice(FILTERS),
    help="normals: regularize the normals of faces and fit the vertices to them, which keeps creases. positions: "
    "regularize the vertices.  [default: normals]",
)
@click.option("--taubin", is_flag=True, help="With --filter positions: use Taubin's two steps instead of the model.")
@click.option(
    "--values", metavar="NAME", help="Denoise these values at the vertices instead: colours, or a PLY property."
)
@click.option("--p", type=float, help="Degree of regularity > 0.  [default: 1 for normals and values, 2 for positions]")
@click.option("--lam", type=float, help="Fidelity >= 0: larger stays closer to IN.  [default: from the noise]")
@click.option("--sigma", type=float, help="Noise, in the units of the coordinates.  [default: estimated]")
@click.option(
    "--weights",
    type=click.Choice(MESH_WEIGHTS),
    help="1, 1/|u-v|, 1/|u-v|^2, or cotangents of the opposite angles.  [default: 1; for normals by similarity]",
)
@click.option("--norm", type=click.Choice(NORMS), default="vertex", show_default=True, help="Gradient norm.")
@click.option("--fix-border", is_flag=True, help="Keep the border vertices of an open mesh fixed.")
@click.option("--max-displacement", type=float, help="Largest displacement of a vertex.")
@click.option(
    "--simplify",
    is_flag=True,
    help="Remove vertices instead of noise: those that meet for p < 1 are merged.  [p: 0.1, lam: 0.001]",
)
@click.option("--n-vertices", type=int, help="Simplify to this number of vertices.")
@options.solver
@click.option(
    "--max-iter",
    type=int,
    help="Maximum number of iterations.  [default: 30 in each of 3 rounds (normals), 100 (positions), 500 (simplify)]",
)
@options.tol
@options.eps
@options.backend
@options.dtype
@click.option("--reference", type=FILE, help="Clean mesh, or a folder of them: report the errors.")
@click.option("--picture", type=FILE, help="Picture of the mesh before and after.")
@click.option(
    "--view",
    type=options.view,
    metavar="AZIMUTH,ELEVATION",
    help="Where the picture's viewer is, in degrees.  [default: auto]",
)
@click.option("--up", type=click.Choice(["x", "y", "z"]), help="The axis that is up in the picture.  [default: y]")
@options.as_json
@options.quiet
@options.progress
def mesh(
    paths: tuple[str, ...],
    as_json: bool,
    quiet: bool,
    progress: bool | None,
    **given: Any,
) -> None:
    """Denoise the mesh IN, or simplify it, and write it to OUT.

    Several files, or a pattern such as 'scans/*.ply', go to the folder OUT. The extension gives the format: PLY, OBJ,
    OFF, STL, GLB, glTF or 3MF. Colours, textures, values, polygons, names and comments are copied, normals are computed
    again; the report names what OUT has no place for. By default the noise is estimated and creases are preserved. The
    files of one IN are written completely, or not at all; OUT may be IN.
    """
    names, out, many = options.inputs(paths)
    show = (sys.stderr.isatty() if progress is None else progress) and not quiet
    given["view"] = given["view"] or "auto"

    if many:
        tell_many(
            sentences(lambda: mesh_files(expand(names), Path(out), MeshSettings(**given), progress=show)),
            as_json,
            quiet,
        )
    report = sentences(lambda: mesh_file(Path(names[0]), Path(out), MeshSettings(**given), progress=show))
    tell(report, as_json, quiet)
