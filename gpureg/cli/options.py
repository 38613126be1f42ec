"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path

import click


def examples(*calls: str) -> str:
    """Calls under a command's help, a line each, which click would run together."""
    return "\n".join(["\b", "Example:" if len(calls) == 1 else "Examples:", *(f"  {call}" for call in calls)])


FILE = click.Path(path_type=Path, readable=False)

solver = click.option(
    "--solver",
    type=click.Choice(["jacobi", "certified"]),
    default="jacobi",
    show_default=True,
    help="certified: the minimiser, for p >= 1, with a bound on how far off it is.",
)
tol = click.option(
    "--tol",
    type=float,
    help="Stop when the largest change is this share of the range; certified: the gap this share of the energy.",
)
eps = click.option("--eps", type=float, help="Smoothing of the gradient norm.  [default: 1e-3 of the range]")
backend = click.option(
    "--backend", default="auto", show_default=True, help="auto, numpy, opencl, warp, or one of `gpureg backends`."
)
dtype = click.option(
    "--dtype", type=click.Choice(["float32", "float64"]), help="Type to compute in.  [default: float32]"
)
axes = click.option(
    "--axes", help="Letters of a TIFF's axes: T time, Z, Y, X, C channels, such as TZYX.  [default: the file's]"
)
each = click.option(
    "--each", type=click.Choice(["T", "Z"]), multiple=True, help="Treat the slices of this axis one by one."
)
spacing = click.option(
    "--spacing", help="Size of a voxel along each axis but C, such as 3,1,1, or the word file.  [default: 1 along each]"
)
mask = click.option("--mask", type=FILE, help="Picture, nonzero where pixels take part; or a folder of such, by name.")
as_json = click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Report as JSON on standard output; errors stay sentences on standard error.",
)
quiet = click.option("--quiet", is_flag=True, help="Report nothing.")
progress = click.option("--progress/--no-progress", default=None, help="Progress bar.  [default: on a terminal]")


def view(text: str) -> tuple[float, float] | str:
    """Two angles, or the word auto."""
    if text.strip().lower() == "auto":
        return "auto"
    try:
        azimuth, elevation = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is neither auto nor two angles in degrees, such as 30,20.") from None
    return azimuth, elevation
