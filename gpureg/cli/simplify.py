"""``gpureg simplify``: simplify a picture to a few regions, and write its partition."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from ..files.picture import checked_axes
from ..jobs.denoise_settings import as_spacing
from ..jobs.simplify import simplify_file
from ..jobs.simplify_report import SimplifyReport
from ..jobs.simplify_settings import Simplification
from ..model.problem import NORMS
from ..regions.graph import METRICS
from ..regions.options import WEIGHTS
from ..regions.simplify import SOURCES
from ..regions.values import MODELS
from . import options
from .group import sentences
from .options import FILE
from .terminal import say

# The options that belong to one weight function only.
_OPTIONS_OF_WEIGHTS = {"h": "similarity", "sigma_space": "bilateral", "sigma_value": "bilateral"}


def _sources(text: str) -> str | int:
    """Parse the name of a kind of sources, or the distance of seeds in pixels."""
    word = text.strip().lower()
    if word in SOURCES:
        return word
    if word.isdecimal() and int(word) >= 1:
        return int(word)
    raise click.BadParameter(
        f"{text!r} is neither one of {', '.join(SOURCES)} nor a number of pixels >= 1 between seeds."
    )


@click.command(
    epilog=options.examples(
        "gpureg simplify photo.png simple.png --labels regions.tif",
        "gpureg simplify photo.png simple.png --smooth 0 --lam 0    # Fig. 4",
    ),
    short_help="Simplify a picture to a few regions.",
)
@click.argument("source", metavar="IN", type=FILE)
@click.argument("target", metavar="OUT", type=FILE)
@click.option(
    "--sources",
    type=_sources,
    metavar=f"{'|'.join(SOURCES)}|STEP",
    help="What zones grow from: extrema of the intensity, minima of the gradient, or seeds STEP pixels apart.  "
    "[default: extrema]",
)
@click.option(
    "--markers", type=FILE, help="Picture of sources, one for each number above 0. PNG, or TIFF of any integer type."
)
@click.option(
    "--smooth",
    type=float,
    help="Gaussian that smooths the picture for the partition, in pixels.  [default: the smallest of 0, 0.5, 0.75, 1, "
    "1.5, 2 with at most one region per 10 pixels; 0 for seeds and markers]",
)
@click.option(
    "--metric",
    type=click.Choice(METRICS),
    default="cityblock",
    show_default=True,
    help="Pixels are neighbours across edges, or also across corners.",
)
@click.option(
    "--compactness",
    type=float,
    default=0.0,
    show_default=True,
    help="Constant cost of a step, in pixel values, added to its variation: larger makes rounder zones.",
)
@click.option("--model", type=click.Choice(MODELS), default="mean", show_default=True, help="Value of a region.")
@click.option(
    "--p",
    type=float,
    default=2.0,
    show_default=True,
    help="Degree of regularity > 0: 2 smooth, 1 total variation, < 1 flat.",
)
@click.option(
    "--lam", type=float, default=0.05, show_default=True, help="Fidelity >= 0: larger stays closer to the regions."
)
@click.option("--by-size/--no-by-size", help="Scale lam with a region's size, so that all pixels count equally.")
@click.option(
    "--weights",
    type=click.Choice([*WEIGHTS, "bilateral"]),
    default="similarity",
    show_default=True,
    help="Weights between neighbouring regions; the options below belong to them. border: its length.",
)
@click.option("--h", type=float, help="similarity: filtering parameter.  [default: twice the median difference]")
@click.option("--sigma-space", type=float, help="bilateral: spatial scale, in pixels or units of --spacing.")
@click.option("--sigma-value", type=float, help="bilateral: scale in pixel values.")
@click.option(
    "--norm",
    type=click.Choice(NORMS),
    default="vertex",
    show_default=True,
    help="One gradient norm at each region, or one along each edge (anisotropic).",
)
@click.option(
    "--rings", type=int, default=1, show_default=True, help="Regions up to this number of steps apart are neighbours."
)
@options.solver
@click.option(
    "--max-iter", type=int, default=30, show_default=True, help="Maximum number of iterations; 0 changes no region."
)
@options.tol
@options.eps
@click.option("--merge-tol", type=float, help="Merge regions whose final values differ by at most this.")
@options.backend
@options.dtype
@options.axes
@options.each
@options.spacing
@options.mask
@click.option("--labels", type=FILE, help="TIFF for the label of each pixel's region, from 0; -1 for none.")
@click.option("--random-colours", type=FILE, help="File for the regions in random colours.")
@click.option("--fine", type=FILE, help="File for the regions before regularization and merging.")
@options.as_json
@options.quiet
@options.progress
def simplify(
    source: Path,
    target: Path,
    as_json: bool,
    quiet: bool,
    progress: bool | None,
    **given: Any,
) -> None:
    """Divide the picture IN into zones around its extrema, regularize the zones on their graph, and write OUT.

    PNG, TIFF and JPEG, 8 or 16 bits, grey or RGB; alpha is copied. TIFF stacks are volumes or series, also of float
    values; pixels that are NaN are left out. All files are written, or none.
    """
    for name, owner in _OPTIONS_OF_WEIGHTS.items():
        if given[name] is not None and owner != given["weights"]:
            raise click.UsageError(f"--{name.replace('_', '-')} needs --weights {owner}")
    if given["markers"] is not None and given["sources"] is not None:
        raise click.UsageError("--markers are the sources: leave --sources out")
    show = (sys.stderr.isatty() if progress is None else progress) and not quiet

    def work() -> SimplifyReport:
        read = {"spacing": as_spacing, "axes": checked_axes}
        asked = given | {"sources": given["sources"] or Simplification.sources}
        settings = Simplification(
            **asked | {name: as_(given[name]) for name, as_ in read.items() if given[name] is not None}
        )
        return simplify_file(source, target, settings, progress=show)

    report = sentences(work)
    if as_json:
        click.echo(json.dumps(report.as_json(), indent=2))
    elif not quiet:
        say("\n".join(report.lines()))
