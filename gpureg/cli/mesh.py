"""``gpureg mesh``: a triangle mesh in, one with less noise or fewer vertices out."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ..jobs.mesh import MESH_WEIGHTS, MeshSettings, mesh_file
from ..meshes.filters import FILTERS
from ..model.problem import NORMS
from . import options
from .group import sentences
from .options import FILE
from .terminal import tell


@click.command(
    epilog=options.examples(
        "gpureg mesh scan.ply clean.ply --picture both.png",
        "gpureg mesh part.stl small.ply --n-vertices 5000",
        "gpureg mesh bunny.ply smooth.ply --filter positions --weights inverse-square --lam 0 --max-iter 8    # Fig. 6",
    ),
    short_help="Denoise or simplify a triangle mesh.",
)
@click.argument("source", metavar="IN", type=FILE)
@click.argument("target", metavar="OUT", type=FILE)
@click.option(
    "--filter",
    type=click.Choice(FILTERS),
    help="normals: regularize the normals of faces and fit the vertices to them, which keeps creases. positions: "
    "regularize the vertices.  [default: normals]",
)
@click.option("--taubin", is_flag=True, help="With --filter positions: Taubin's pair of steps instead of the model.")
@click.option(
    "--values", metavar="NAME", help="Denoise these numbers at the vertices instead: colours, or a PLY's name."
)
@click.option("--p", type=float, help="Degree of regularity > 0.  [default: 1 for normals and values, 2 for positions]")
@click.option("--lam", type=float, help="Fidelity >= 0: larger stays closer to IN.  [default: from the noise]")
@click.option("--sigma", type=float, help="Noise, in the units of the coordinates.  [default: estimated]")
@click.option(
    "--weights",
    type=click.Choice(MESH_WEIGHTS),
    help="1, 1/|u-v|, 1/|u-v|^2, or cotangents of the angles across.  [default: 1; for normals by their likeness]",
)
@click.option("--norm", type=click.Choice(NORMS), default="vertex", show_default=True, help="Gradient norm.")
@click.option("--fix-border", is_flag=True, help="Vertices on the border of an open mesh stay.")
@click.option("--max-displacement", type=float, help="No vertex moves further than this.")
@click.option(
    "--simplify",
    is_flag=True,
    help="Fewer vertices instead of less noise: those that meet for p < 1 become one.  [p: 0.1, lam: 0.001]",
)
@click.option("--n-vertices", type=int, help="Simplify until this many are left.")
@options.solver
@click.option(
    "--max-iter",
    type=int,
    help="Iterations at most.  [default: 30 in each of 3 rounds for normals, 100 for positions, 500 to simplify]",
)
@options.tol
@options.eps
@options.backend
@options.dtype
@click.option("--reference", type=FILE, help="Clean mesh: errors of normals and vertices, Hausdorff distance.")
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
    source: Path,
    target: Path,
    as_json: bool,
    quiet: bool,
    progress: bool | None,
    **given: Any,
) -> None:
    """Denoise the triangle mesh IN, or simplify it, and write it to OUT.

    PLY, OBJ, OFF and STL, by extension; colours and numbers at vertices go along where the format has them. With no
    option the noise is estimated and creases are kept. All files are written, or none; OUT may be IN.
    """
    show = (sys.stderr.isatty() if progress is None else progress) and not quiet
    given["view"] = given["view"] or "auto"

    report = sentences(lambda: mesh_file(source, target, MeshSettings(**given), progress=show))
    tell(report, as_json, quiet)
