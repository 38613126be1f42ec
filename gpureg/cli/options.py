"""Options that several commands share."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import click

from ..jobs.batch import is_pattern


def examples(*calls: str) -> str:
    """Return the examples for a command's help, one on each line: click must not join them."""
    return "\n".join(["\b", "Example:" if len(calls) == 1 else "Examples:", *(f"  {call}" for call in calls)])


FILE = click.Path(path_type=Path, readable=False)

solver = click.option(
    "--solver",
    type=click.Choice(["jacobi", "certified"]),
    default="jacobi",
    show_default=True,
    help="certified: compute the minimiser, for p >= 1, with a bound on its error.",
)
tol = click.option(
    "--tol",
    type=float,
    help="Stop at this largest change, relative to the spread; certified: at this gap, relative to the energy.",
)
eps = click.option("--eps", type=float, help="Smoothing of the gradient norm.  [default: 1e-3 of the spread]")
backend = click.option(
    "--backend",
    default="auto",
    show_default=True,
    help="auto, all, numpy, opencl, warp, or names from `gpureg backends`, joined by commas.",
)
dtype = click.option(
    "--dtype", type=click.Choice(["float32", "float64"]), help="Type of the computation.  [default: float32]"
)
axes = click.option(
    "--axes", help="Letters of a TIFF's axes: T time, Z, Y, X, C channels, such as TZYX.  [default: from the file]"
)
each = click.option(
    "--each",
    type=click.Choice(["T", "Z", "C"]),
    multiple=True,
    help="Treat the slices, or channels, of this axis alone.",
)
spacing = click.option(
    "--spacing", help="Size of a voxel along each axis except C, such as 3,1,1, or the word file.  [default: 1]"
)
mask = click.option("--mask", type=FILE, help="Picture, nonzero at pixels to use; or a folder with files named as IN.")
nodata = click.option(
    "--nodata",
    type=float,
    metavar="VALUE",
    help="Leave out pixels of this value; inf: of both infinities.  [default: what a TIFF of GDAL names]",
)
as_json = click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Write the report as JSON to standard output; errors are text on standard error.",
)
quiet = click.option("--quiet", is_flag=True, help="Print no report.")
progress = click.option("--progress/--no-progress", default=None, help="Show a progress bar.  [default: on a terminal]")


def inputs(paths: Sequence[str]) -> tuple[list[str], str, bool]:
    """Split the arguments IN... OUT; return IN, OUT, and whether OUT is a folder for many files."""
    if len(paths) < 2:
        raise click.UsageError("Missing IN and OUT." if not paths else f"Missing OUT: where to write {paths[0]}?")
    *names, out = paths
    return names, out, len(names) > 1 or is_pattern(names[0]) or os.path.isdir(out)


def view(text: str) -> tuple[float, float] | str:
    """Parse two angles, or the word auto."""
    if text.strip().lower() == "auto":
        return "auto"
    try:
        azimuth, elevation = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is neither auto nor two angles in degrees, such as 30,20.") from None
    return azimuth, elevation
