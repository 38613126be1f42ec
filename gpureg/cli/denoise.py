"""``gpureg denoise``: pictures in, pictures without their noise out."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import click

from ..files.picture import checked_axes
from ..graphs.edges import METRICS
from ..images.options import WEIGHTS
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
    """A number, or the name of a search for one."""
    word = text.strip().lower()
    if word in LAM_METHODS:
        return word
    try:
        return float(word)
    except ValueError:
        raise click.BadParameter(f"{text!r} is neither a number >= 0 nor one of {', '.join(LAM_METHODS)}.") from None


# Options that belong to one weight function alone.
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
@click.option("--sigma", type=float, help="Noise's standard deviation in pixel values.  [default: estimated]")
@click.option("--p", type=float, help="Degree of regularity > 0: 2 smooth, 1 total variation, < 1 flat.  [default: 2]")
@click.option(
    "--lam",
    type=_fidelity,
    metavar="FLOAT|METHOD",
    help="Fidelity >= 0: larger stays closer to the picture; or a search for it, in 5 to 15 runs: "
    f"{', '.join(LAM_METHODS)}.  [default: by rule, from the noise]",
)
@click.option("--radius", type=float, help="Reach of the window in pixels, or units of --spacing.")
@click.option("--metric", type=click.Choice(METRICS), help="Shape of the window: square, disk, diamond.")
@click.option(
    "--norm",
    type=click.Choice(NORMS),
    default="vertex",
    show_default=True,
    help="One gradient norm at each pixel, or one along each edge (anisotropic); p other than 2.",
)
@click.option(
    "--weights",
    type=click.Choice(WEIGHTS),
    help="Weight function; the options below belong to it.  [default: patch for p = 2, otherwise constant]",
)
@click.option("--patch-radius", type=int, help="patch: radius of a patch.  [default: 2]")
@click.option("--h", type=float, help="patch: filtering parameter.  [default: 0.6 sigma sqrt(samples)]")
@click.option("--patch-sigma", type=float, help="patch: Gaussian patch of this standard deviation.  [default: flat]")
@click.option("--sigma-space", type=float, help="bilateral: reach as --radius.  [default: 3 of the finest pixels]")
@click.option("--sigma-value", type=float, help="bilateral: reach in pixel values.  [default: 3 sigma]")
@click.option(
    "--centre",
    type=click.Choice(CENTRES),
    help="patch, bilateral, one sweep: a pixel itself counts with weight 1, the largest around it, or not at all.  "
    "[default: once]",
)
@click.option(
    "--average-patches",
    type=click.Choice(list(AVERAGING)),
    help="patch, one sweep: a pixel is the mean over all patches that cover it, plain or weighted by what they found.  "
    "[default: weighted in a picture without --weights, otherwise none]",
)
@click.option("--k", type=int, help="patch: keep so many of each pixel's edges, those to the nearest patches.")
@options.solver
@click.option("--max-iter", type=int, help="Iterations at most.")
@options.tol
@options.eps
@options.backend
@options.dtype
@click.option(
    "--memory",
    help="Bytes it may take on the device, such as 4GiB.  [default: half of a CPU's, 90 percent of a GPU's]",
)
@options.axes
@options.each
@options.spacing
@options.mask
@click.option(
    "--guide", type=FILE, help="Picture that the weights compare instead of IN; or a folder of such, by name."
)
@click.option("--reference", type=FILE, help="Clean picture, or a folder of them: PSNR and SSIM are reported.")
@click.option("--explain", is_flag=True, help="Print the plan first: what was chosen for each parameter, and why.")
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
    """Denoise the picture IN and write it to OUT; or several, or a pattern such as 'raw/*.tif', into the folder OUT.

    PNG, TIFF and JPEG, 8 or 16 bits, grey or RGB; alpha is carried through. TIFF stacks are volumes or series, of float
    values too; pixels that are NaN are left out. With no option the noise is estimated and the rest follows from it.
    """
    for name, owner in _OPTIONS_OF_WEIGHTS.items():
        is_given = context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        if is_given and owner != given["weights"]:
            raise click.UsageError(f"--{name.replace('_', '-')} needs --weights {owner}")
    if len(paths) < 2:
        raise click.UsageError("Missing IN and OUT." if not paths else f"Missing OUT: where is {paths[0]} to go?")
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
