"""``gpureg denoise``: denoise pictures, volumes and series."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any, Literal

import click

from ..files.picture import checked_axes
from ..graphs.edges import METRICS
from ..images.options import MOST_PASSES, WEIGHTS
from ..images.passes import QUALITIES
from ..images.plan import CENTRES
from ..jobs.batch import Outcome, denoise_files, expand, is_pattern
from ..jobs.denoise import denoise_file
from ..jobs.denoise_report import DenoiseReport
from ..jobs.denoise_settings import AVERAGING, Settings, as_spacing
from ..model.memory import as_bytes
from ..model.problem import NORMS
from ..tuning.fidelity import LAM_METHODS
from . import options
from .group import sentences
from .options import FILE
from .terminal import say


def _fidelity(text: str) -> float | str:
    """Parse a number, or the name of a search method."""
    word = text.strip().lower()
    if word in LAM_METHODS:
        return word
    try:
        return float(word)
    except ValueError:
        raise click.BadParameter(f"{text!r} is neither a number >= 0 nor one of {', '.join(LAM_METHODS)}.") from None


def _noise(text: str) -> float | tuple[float, ...] | Literal["photon"]:
    """Parse a number, numbers with commas, or the word photon."""
    if text.strip().lower() == "photon":
        return "photon"
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(
            f"{text!r} is neither a number >= 0, nor numbers such as 5,10,5, nor photon."
        ) from None
    return numbers[0] if len(numbers) == 1 else numbers


# The options that belong to one weight function only.
_OPTIONS_OF_WEIGHTS = {
    "patch_radius": "patch",
    "h": "patch",
    "patch_sigma": "patch",
    "sigma_space": "bilateral",
    "sigma_value": "bilateral",
}


@click.command(
    epilog=options.examples(
        "gpureg denoise noisy.png clean.png", "gpureg denoise noisy.png clean.png --p 1    # total variation"
    ),
    short_help="Denoise pictures, volumes, series.",
)
@click.argument("paths", metavar="IN... OUT", nargs=-1)
@click.option(
    "--sigma",
    type=_noise,
    metavar="FLOAT[,FLOAT...]|photon",
    help="Standard deviation of the noise, in pixel values; one for each channel; or photon: it grows with the value.  "
    "[default: estimated]",
)
@click.option("--offset", type=float, help="For --sigma photon: the camera's value without light.")
@click.option("--p", type=float, help="Degree of regularity > 0: 2 smooth, 1 total variation, < 1 flat.  [default: 2]")
@click.option(
    "--lam",
    type=_fidelity,
    metavar="FLOAT|METHOD",
    help="Fidelity >= 0, larger stays closer to the picture; or a method that searches for it in 5 to 15 runs: "
    f"{', '.join(LAM_METHODS)}.  [default: computed from the noise]",
)
@click.option("--radius", type=float, help="Radius of the window, in pixels or units of --spacing.")
@click.option("--metric", type=click.Choice(METRICS), help="Shape of the window: square, disk, diamond.")
@click.option(
    "--norm",
    type=click.Choice(NORMS),
    default="vertex",
    show_default=True,
    help="One gradient norm at each pixel, or one along each edge (anisotropic); for p other than 2.",
)
@click.option(
    "--weights",
    type=click.Choice(WEIGHTS),
    help="Weight function; the options below belong to it.  [default: patch for p = 2, otherwise constant]",
)
@click.option("--patch-radius", type=int, help="patch: radius of a patch.  [default: 2]")
@click.option("--h", type=float, help="patch: filtering parameter.  [default: 0.6 sigma sqrt(samples)]")
@click.option("--patch-sigma", type=float, help="patch: standard deviation of a Gaussian patch.  [default: flat patch]")
@click.option("--sigma-space", type=float, help="bilateral: scale in space, as --radius.  [default: 3 smallest pixels]")
@click.option("--sigma-value", type=float, help="bilateral: scale in pixel values.  [default: 3 sigma]")
@click.option(
    "--centre",
    type=click.Choice(CENTRES),
    help="patch, bilateral, one sweep: weight of a pixel itself: 1, the largest of its neighbours, or 0.  "
    "[default: once]",
)
@click.option(
    "--average-patches",
    type=click.Choice(list(AVERAGING)),
    help="patch, one sweep: average all patches that cover a pixel, plain or weighted.  "
    "[default: weighted for a picture without --weights, otherwise none]",
)
@click.option("--k", type=int, help="patch: number of edges to keep at each pixel, those to the most similar patches.")
@click.option(
    "--passes",
    type=click.IntRange(1, MOST_PASSES),
    help="1: the filter alone; 2, 3: and one or two passes on groups of similar patches.  "
    "[default: 3 for one sweep at p = 2 by the rule in white noise, otherwise 1]",
)
@click.option(
    "--quality",
    type=click.Choice(QUALITIES),
    help="How much work the default of --passes is: fast makes none, best finds groups at more pixels.  "
    "[default: balanced]",
)
@options.solver
@click.option("--max-iter", type=int, help="Maximum number of iterations.")
@options.tol
@options.eps
@options.backend
@options.dtype
@click.option(
    "--memory",
    help="Memory to use at most, such as 4GiB, on the device and in the process: a TIFF that needs more is read and "
    "written in parts.  [default: half of the machine's, 90 percent of a GPU's]",
)
@options.axes
@options.each
@options.spacing
@options.mask
@options.nodata
@click.option(
    "--guide", type=FILE, help="Picture that the weights compare instead of IN; or a folder with files named as IN."
)
@click.option("--reference", type=FILE, help="Clean picture, or a folder of them: report PSNR and SSIM.")
@click.option("--explain", is_flag=True, help="Print the plan first: the value of each parameter, and why.")
@options.as_json
@options.quiet
@options.progress
@click.pass_context
def denoise(
    context: click.Context,
    /,
    paths: tuple[str, ...],
    as_json: bool,
    quiet: bool,
    progress: bool | None,
    **given: Any,
) -> None:
    """Denoise the picture IN and write it to OUT; or several, or a pattern such as 'raw/*.tif', to the folder OUT.

    PNG, TIFF, JPEG, WebP, JPEG 2000, BMP, PNM and GIF, grey or RGB; alpha is copied. TIFF stacks are volumes or series,
    of any integers or floats; pixels that are NaN are left out. By default the noise is estimated, and the other
    parameters follow.
    """
    for name, owner in _OPTIONS_OF_WEIGHTS.items():
        is_given = context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        if is_given and owner != given["weights"]:
            raise click.UsageError(f"--{name.replace('_', '-')} needs --weights {owner}")
    if len(paths) < 2:
        raise click.UsageError("Missing IN and OUT." if not paths else f"Missing OUT: where to write {paths[0]}?")
    if quiet and given["explain"]:
        raise click.UsageError("--explain and --quiet contradict each other")
    *names, out = paths
    show = (sys.stderr.isatty() if progress is None else progress) and not quiet
    many = len(names) > 1 or is_pattern(names[0]) or os.path.isdir(out)

    def tell(plan: str) -> None:
        say(plan, err=as_json)

    def settings() -> Settings:
        read = {"memory": as_bytes, "spacing": as_spacing, "axes": checked_axes}
        return Settings(**given | {name: as_(given[name]) for name, as_ in read.items() if given[name] is not None})

    def one() -> DenoiseReport:
        return denoise_file(Path(names[0]), Path(out), settings(), progress=show, tell=tell)

    def all_of_them() -> Outcome:
        return denoise_files(expand(names), Path(out), settings(), progress=show, tell=tell)

    if not many:
        report = sentences(one)
        if as_json:
            click.echo(json.dumps(report.as_json(), indent=2))
        elif not quiet:
            say("\n".join(report.lines()))
        return
    outcome = sentences(all_of_them)
    if outcome.failed:
        click.echo(f"gpureg: {outcome.failures()}", err=True)
    if outcome.interrupted:
        click.echo(f"gpureg: interrupted, {len(outcome.done)} of {outcome.count} files were done", err=True)
        raise click.exceptions.Exit(130)
    if as_json:
        click.echo(json.dumps(outcome.as_json(), indent=2))
    elif not quiet:
        say("\n".join(outcome.lines()))
    raise click.exceptions.Exit(1 if outcome.failed else 0)
