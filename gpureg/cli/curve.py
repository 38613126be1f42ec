"""``gpureg curve``: polygonal curves in, ones with less noise or fewer vertices out, and their skeletons."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ..curves.simplify import CURVE_FILTERS
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
    short_help="Denoise or simplify polygonal curves; their skeletons.",
)
@click.argument("source", metavar="IN", type=FILE)
@click.argument("target", metavar="OUT", type=FILE)
@click.option("--simplify", is_flag=True, help="Fewer vertices instead of less noise: those that tell the shape stay.")
@click.option("--n-vertices", type=int, help="Simplify each curve to so many vertices.")
@click.option(
    "--filter",
    type=click.Choice(CURVE_FILTERS),
    help="What is simplified. directions: corners stay, straight runs go. positions: curves are thinned evenly.  "
    "[default: directions]",
)
@click.option("--p", type=float, help="Degree of regularity > 0.  [default: 2; 0.5 to simplify]")
@click.option("--lam", type=float, help="Fidelity >= 0: larger stays closer to IN.  [default: from the noise]")
@click.option("--sigma", type=float, help="Noise of each coordinate, in their units.  [default: estimated]")
@click.option("--weights", type=click.Choice(WEIGHTS), help="1, 1/|u-v|, 1/|u-v|^2.  [default: 1]")
@click.option("--norm", type=click.Choice(NORMS), help="Gradient norm.  [default: vertex; edge to simplify]")
@click.option(
    "--keep-ends/--no-keep-ends", default=None, help="Whether the ends of open curves keep their place.  [default: yes]"
)
@click.option(
    "--closed/--open",
    default=None,
    help="Whether the curves of a CSV are closed.  [default: where the first vertex is repeated, or the ends are near]",
)
@click.option(
    "--degrees/--no-degrees",
    default=None,
    help="Coordinates are longitude and latitude: distances on the ground count.  [default: for GeoJSON]",
)
@click.option("--skeleton", type=FILE, metavar="FILE", help="The skeletons of closed curves, branch by branch.")
@click.option("--solver", type=click.Choice(["jacobi", "certified"]), help="[default: certified where p >= 1]")
@click.option("--max-iter", type=int, help="Iterations at most.")
@options.tol
@options.eps
@options.backend
@options.dtype
@click.option("--reference", type=FILE, help="Clean curves: Hausdorff distance before and after.")
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

    CSV, SVG and GeoJSON, by extension; what else an SVG or GeoJSON holds goes along. With no option the noise of each
    curve is estimated. All files are written, or none; OUT may be IN.
    """
    show = (sys.stderr.isatty() if progress is None else progress) and not quiet

    report = sentences(lambda: curve_file(source, target, CurveSettings(**given), progress=show))
    tell(report, as_json, quiet)
