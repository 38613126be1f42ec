"""``gpureg curve``: denoise or simplify polygonal curves, and compute their skeletons."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ..curves.process import CURVE_FILTERS
from ..curves.simplify import CURVE_METHODS
from ..jobs.batch import expand
from ..jobs.curve import CurveSettings, curve_file, curve_files
from ..jobs.options import WEIGHTS
from ..model.problem import NORMS
from . import options
from .group import sentences
from .options import FILE
from .terminal import tell, tell_many


@click.command(
    epilog=options.examples(
        "gpureg curve coast.geojson simple.geojson --simplify --picture both.png",
        "gpureg curve outline.csv smooth.csv --skeleton bones.svg",
    ),
    short_help="Denoise or simplify polygonal curves; compute skeletons.",
)
@click.argument("paths", metavar="IN... OUT", nargs=-1)
@click.option("--simplify", is_flag=True, help="Remove vertices instead of noise; those that define the shape stay.")
@click.option("--n-vertices", type=int, help="Simplify each curve to this number of vertices.")
@click.option(
    "--tolerance",
    type=float,
    help="Simplify: remove vertices up to this height, in diagonals of a curve.  [default: 0.0015]",
)
@click.option("--valid", is_flag=True, help="Let no curves cross that did not before; common borders stay common.")
@click.option(
    "--method",
    type=click.Choice(CURVE_METHODS),
    help="Simplify: heights: remove the lowest vertices. process: the paper's, for p < 1.  "
    "[default: heights, without options of the process]",
)
@click.option(
    "--filter",
    type=click.Choice(CURVE_FILTERS),
    help="process: directions: keep the corners, merge straight parts. positions: thin the curves evenly.  "
    "[default: directions]",
)
@click.option("--p", type=float, help="Degree of regularity > 0.  [default: 2; 0.5 for the process that simplifies]")
@click.option("--lam", type=float, help="Fidelity >= 0: larger stays closer to IN.  [default: from the noise]")
@click.option("--sigma", type=float, help="Noise of each coordinate, in its units.  [default: estimated]")
@click.option("--weights", type=click.Choice(WEIGHTS), help="1, 1/|u-v|, 1/|u-v|^2.  [default: 1]")
@click.option("--norm", type=click.Choice(NORMS), help="Gradient norm.  [default: vertex; edge to simplify]")
@click.option(
    "--keep-ends/--no-keep-ends", default=None, help="Whether the ends of open curves stay fixed.  [default: yes]"
)
@click.option(
    "--closed/--open",
    default=None,
    help="Whether the curves of a CSV are closed.  [default: if the first vertex is repeated, or the ends are near]",
)
@click.option(
    "--degrees/--no-degrees",
    default=None,
    help="Coordinates are longitude and latitude: use distances on the ground.  [default: for GeoJSON and GPX]",
)
@click.option("--skeleton", type=FILE, metavar="FILE", help="File for the branches of the skeletons of closed curves.")
@click.option("--solver", type=click.Choice(["jacobi", "certified"]), help="[default: certified where p >= 1]")
@click.option("--max-iter", type=int, help="Maximum number of iterations.")
@options.tol
@options.eps
@options.backend
@options.dtype
@click.option("--reference", type=FILE, help="Clean curves, or a folder of them: report the distance from them.")
@click.option("--picture", type=FILE, help="Picture of the curves before and after, or of the skeletons.")
@options.as_json
@options.quiet
@options.progress
def curve(
    paths: tuple[str, ...],
    as_json: bool,
    quiet: bool,
    progress: bool | None,
    **given: Any,
) -> None:
    """Denoise the polygonal curves IN, or simplify them, and write them to OUT.

    Several files, or a pattern such as 'tracks/*.gpx', go to the folder OUT. The extension gives the format: CSV, SVG,
    GeoJSON or GPX. Other content of a file is copied if OUT has the same format. By default the noise of each curve is
    estimated. The files of one IN are written completely, or not at all; OUT may be IN.
    """
    names, out, many = options.inputs(paths)
    show = (sys.stderr.isatty() if progress is None else progress) and not quiet
    if many:
        tell_many(
            sentences(lambda: curve_files(expand(names), Path(out), CurveSettings(**given), progress=show)),
            as_json,
            quiet,
        )
    report = sentences(lambda: curve_file(Path(names[0]), Path(out), CurveSettings(**given), progress=show))
    tell(report, as_json, quiet)
