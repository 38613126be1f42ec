"""``gpureg points``: denoise or cluster a point cloud."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import click

from ..jobs.batch import expand, is_pattern
from ..jobs.options import WEIGHTS
from ..jobs.points import PointsSettings, points_file, points_files
from ..model.problem import NORMS
from ..points.filters import POINT_FILTERS
from . import options
from .group import sentences
from .options import FILE
from .terminal import tell, tell_many


def _names(text: str) -> tuple[str, ...]:
    """Split a list of names at its commas."""
    names = tuple(word.strip() for word in text.split(","))
    if not all(names):
        raise click.BadParameter(f"{text!r} is not a list of names between commas, such as x,y,z.")
    return names


@click.command(
    epilog=options.examples(
        "gpureg points scan.ply clean.ply --picture both.png", "gpureg points cells.csv labelled.csv --cluster"
    ),
    short_help="Denoise or cluster a point cloud.",
)
@click.argument("paths", metavar="IN... OUT", nargs=-1)
@click.option(
    "--filter",
    type=click.Choice(POINT_FILTERS),
    help="normals: regularize the normals of neighbourhoods and fit the points to them, which keeps creases. "
    "positions: regularize the points. surface: for 3D points, without parameters.  [default: surface; normals for 2D "
    "points and if another option is given]",
)
@click.option("--values", metavar="NAME", help="Denoise these values at the points instead: colours, or a column.")
@click.option("--columns", type=_names, metavar="NAMES", help="Coordinate columns of a CSV.  [default: x,y,z or all]")
@click.option("--cluster", is_flag=True, help="Cluster the points instead: those that meet for p < 1.")
@click.option("--n-clusters", type=int, help="Number of clusters.  [default: at the widest gap]")
@click.option("--min-size", type=int, help="Merge smaller clusters with others.  [default: 1 % of the points]")
@click.option("--k", type=int, help="Number of neighbours of each point.  [default: 8; 10 for clusters]")
@click.option(
    "--update-neighbours", type=int, metavar="N", help="Search the neighbours again every N steps.  [default: never]"
)
@click.option("--p", type=float, help="Degree of regularity > 0.  [default: 1, 2 for positions, 0.1 for clusters]")
@click.option("--lam", type=float, help="Fidelity >= 0: larger stays closer to IN.  [default: from the noise]")
@click.option("--sigma", type=float, help="Noise, in the units of the coordinates.  [default: estimated]")
@click.option(
    "--weights",
    type=click.Choice(WEIGHTS),
    help="1, 1/|u-v|, 1/|u-v|^2.  [default: 1; for normals by similarity; for clusters a Gaussian]",
)
@click.option("--norm", type=click.Choice(NORMS), default="vertex", show_default=True, help="Gradient norm.")
@click.option("--max-displacement", type=float, help="Largest displacement of a point.  [default: 3 sigma]")
@options.solver
@click.option("--max-iter", type=int, help="Maximum number of iterations.  [default: for normals 30 in each round]")
@options.tol
@options.eps
@options.backend
@options.dtype
@click.option("--reference", type=FILE, help="Clean points, or a mesh: report the distances before and after.")
@click.option("--picture", type=FILE, help="Picture of the points before and after.")
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
def points(
    paths: tuple[str, ...],
    as_json: bool,
    quiet: bool,
    progress: bool | None,
    **given: Any,
) -> None:
    """Denoise the points IN, or cluster them, and write them to OUT; or several, or a pattern, to the folder OUT.

    The extension gives the format: PLY, PCD, XYZ, CSV (also .csv.gz) or NPZ. Other columns of the file are copied;
    normals are computed again. By default the noise is estimated and creases are preserved. OUT may be IN; nothing is
    written if a file fails.
    """
    if len(paths) < 2:
        raise click.UsageError("Missing IN and OUT." if not paths else f"Missing OUT: where to write {paths[0]}?")
    *names, out = paths
    show = (sys.stderr.isatty() if progress is None else progress) and not quiet
    given["view"] = given["view"] or "auto"

    settings = PointsSettings(**given)
    if len(names) == 1 and not is_pattern(names[0]) and not os.path.isdir(out):
        tell(sentences(lambda: points_file(Path(names[0]), Path(out), settings, progress=show)), as_json, quiet)
        return
    tell_many(sentences(lambda: points_files(expand(names), Path(out), settings, progress=show)), as_json, quiet)
