"""``gpureg curve``: denoise or simplify polygonal curves, and compute their skeletons."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ..curves.process import CURVE_FILTERS
from ..jobs.curve import CurveSettings, curve_file
from ..jobs.options import WEIGHTS
from ..model.problem import NORMS
from . import options
from .group import sentences
from .options import FILE
from .terminal import tell


@click.command(
    epilog=options.examples(
        "gpureg curve coast.geojson simple.geojson --simplify --picture both.png",
        "gpureg curve outline.csv smooth.csv --skeleton bones.svg",
    ),
    short_help="Denoise or simplify polygonal curves; compute skeletons.",
)
@click.argument("source", metavar="IN", type=FILE)
@click.argument("target", metavar="OUT", type=FILE)
@click.option("--simplify", is_flag=True, help="Remove vertices instead of noise; those that define the shape stay.")
@click.option("--n-vertices", type=int, help="Simplify each curve to this number of vertices.")
@click.option(
    "--filter",
    type=click.Choice(CURVE_FILTERS),
    help="directions: keep the corners, merge straight parts. positions: thin the curves evenly.  "
    "[default: directions]",
)
@click.option("--p", type=float, help="Degree of regularity > 0.  [default: 2; 0.5 to simplify]")
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
    help="Coordinates are longitude and latitude: use distances on the ground.  [default: for GeoJSON]",
)
@click.option("--skeleton", type=FILE, metavar="FILE", help="File for the branches of the skeletons of closed curves.")
@click.option("--solver", type=click.Choice(["jacobi", "certified"]), help="[default: certified where p >= 1]")
@click.option("--max-iter", type=int, help="Maximum number of iterations.")
@options.tol
@options.eps
@options.backend
@options.dtype
@click.option("--reference", type=FILE, help="Clean curves: report the Hausdorff distance before and after.")
@click.option("--picture", type=FILE, help="Picture of the curves before and after, or of the skeletons.")
@options.as_json
@options.quiet
@options.progress
def curve(
    source: Path,
    target: Path,
    as_json: bool,
    quiet: bool,
    progress: bool | None,
    **given: Any,
) -> None:
    """Denoise the polygonal curves IN, or simplify them, and write them to OUT.

    The extension gives the format: CSV, SVG or GeoJSON. Other content of an SVG or GeoJSON is copied. By default the
    noise of each curve is estimated. All files are written, or none; OUT may be IN.
    """
    show = (sys.stderr.isatty() if progress is None else progress) and not quiet

    report = sentences(lambda: curve_file(source, target, CurveSettings(**given), progress=show))
    tell(report, as_json, quiet)
