"""The command line: ``gpureg denoise``, ``gpureg demo``, ``gpureg backends``.

Exit codes: 0 done, 1 the work failed (a file, a backend), 2 a wrong call, 130 interrupted.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np

from . import __version__, backends
from .batch import FAILURES, Outcome, denoise_files, expand, is_pattern, sentence
from .files import denoise_file
from .graph import METRICS
from .image import run_plan
from .io import PictureError, check_destination
from .memory import as_bytes
from .picture import checked_axes
from .plan import CENTRES
from .planning import plan_denoising
from .problem import NORMS
from .report import as_lines
from .settings import AVERAGING, Settings, as_spacing
from .tuning.fidelity import LAM_METHODS


class _Failure(click.ClickException):
    """The work failed: one sentence, exit code 1."""

    exit_code = 1

    def show(self, file: Any = None) -> None:
        click.echo(f"gpureg: {self.message}", err=True)


def _sentences(work: Callable[[], Any]) -> Any:
    """Run, and turn what can go wrong into a sentence and an exit code."""
    try:
        return work()
    except (ValueError, TypeError) as error:
        raise click.UsageError(sentence(error)) from None
    except FAILURES as error:
        raise _Failure(sentence(error)) from None


class _Group(click.Group):
    """Lets an interrupted run end quietly, with the shell's exit code for it."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        try:
            # Without its standalone mode click gives an exit code back instead of leaving with it.
            code = super().main(*args, **{**kwargs, "standalone_mode": False})
            sys.exit(code if isinstance(code, int) else 0)
        except (KeyboardInterrupt, click.Abort):
            click.echo("gpureg: interrupted, nothing was written", err=True)
            sys.exit(130)
        except click.ClickException as error:
            error.show()
            sys.exit(error.exit_code)
        except OSError as error:
            # Standard output refuses: its reader has gone, which needs no word, or its disk is full.
            if not isinstance(error, BrokenPipeError):
                click.echo(f"gpureg: standard output: {error.strerror}", err=True)
            # What is still buffered goes nowhere, or the interpreter would complain at its end.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(1)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="gpureg")
def main() -> None:
    """Denoise pictures by p-Laplacian regularization on weighted graphs, on the fastest device at hand."""


def _fidelity(text: str) -> float | str:
    """A number, or the name of a search for one."""
    word = text.strip().lower()
    if word in LAM_METHODS:
        return word
    try:
        return float(word)
    except ValueError:
        raise click.BadParameter(f"{text!r} is neither a number >= 0 nor one of {', '.join(LAM_METHODS)}.") from None


def _say(text: str, *, err: bool = False) -> None:
    """Write text, its lines broken under their last column where a terminal would break them anywhere."""
    if (sys.stderr if err else sys.stdout).isatty():
        width = shutil.get_terminal_size().columns - 1
        lines = []
        for line in text.splitlines():
            columns = re.match(r".*\S {2,}", line)
            hanging = " " * min(len(columns[0]) if columns else 0, 2 * width // 3)
            whole: Any = {"break_long_words": False, "break_on_hyphens": False}
            lines += textwrap.wrap(line, width, subsequent_indent=hanging, **whole) or [""]
        text = "\n".join(lines)
    click.echo(text, err=err)


_FILE = click.Path(path_type=Path, readable=False)

# Options that belong to one weight function alone.
_OPTIONS_OF_WEIGHTS = {
    "patch_radius": "patch",
    "h": "patch",
    "patch_std": "patch",
    "sigma_space": "bilateral",
    "sigma_value": "bilateral",
}


@main.command(
    epilog="Example: gpureg denoise noisy.png clean.png    "
    "With total variation instead: gpureg denoise noisy.png clean.png --p 1"
)
@click.argument("paths", metavar="IN... OUT", nargs=-1)
@click.option("--sigma", type=float, help="Noise's standard deviation in pixel values.  [default: estimated]")
@click.option("--p", type=float, help="Degree of regularity > 0: 2 smooth, 1 total variation, < 1 flat.  [default: 2]")
@click.option(
    "--lam",
    type=_fidelity,
    metavar="FLOAT|METHOD",
    help="Fidelity >= 0: larger stays closer to the picture; or a search for it, in some 15 runs: "
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
    "kind",
    type=click.Choice(["constant", "bilateral", "patch"]),
    help="Weight function; the options below belong to it.  [default: patch for p = 2, otherwise constant]",
)
@click.option("--patch-radius", type=int, default=2, show_default=True, help="patch: radius of a patch.")
@click.option("--h", type=float, help="patch: filtering parameter.  [default: 0.6 sigma sqrt(samples)]")
@click.option("--patch-std", type=float, help="patch: Gaussian patch of this standard deviation.  [default: flat]")
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
@click.option("--nearest", type=int, help="patch: keep so many of each pixel's edges, those to the nearest patches.")
@click.option(
    "--solver",
    type=click.Choice(["jacobi", "certified"]),
    default="jacobi",
    show_default=True,
    help="certified: the minimiser, for p >= 1, with a bound on how far off it is.",
)
@click.option("--max-iter", type=int, help="Iterations at most.")
@click.option(
    "--tol",
    type=float,
    help="Stop when the largest change is this share of the range; certified: the gap this share of the energy.",
)
@click.option("--eps", type=float, help="Smoothing of the gradient norm.  [default: 1e-3 of the range]")
@click.option(
    "--backend", default="auto", show_default=True, help="auto, numpy, opencl, warp, or one of `gpureg backends`."
)
@click.option("--dtype", type=click.Choice(["float32", "float64"]), help="Type to compute in.  [default: float32]")
@click.option(
    "--memory",
    help="Bytes it may take on the device, such as 4GiB.  [default: half of a CPU's, 90 percent of a GPU's]",
)
@click.option(
    "--axes", help="Letters of a TIFF's axes: T time, Z, Y, X, C channels, such as TZYX.  [default: the file's]"
)
@click.option("--each", type=click.Choice(["T", "Z"]), multiple=True, help="Treat the slices of this axis one by one.")
@click.option(
    "--spacing", help="Size of a voxel along each axis but C, such as 3,1,1, or the word file.  [default: 1 along each]"
)
@click.option("--mask", type=_FILE, help="Picture, nonzero where pixels take part; or a folder of such, by name.")
@click.option(
    "--guide", type=_FILE, help="Picture that the weights compare instead of IN; or a folder of such, by name."
)
@click.option("--reference", type=_FILE, help="Clean picture, or a folder of them: PSNR and SSIM are reported.")
@click.option("--explain", is_flag=True, help="Print the plan first: what was chosen for each parameter, and why.")
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Report as JSON on standard output; errors stay sentences on standard error.",
)
@click.option("--quiet", is_flag=True, help="Report nothing.")
@click.option("--progress/--no-progress", default=None, help="Progress bar.  [default: on a terminal]")
@click.pass_context
def denoise(
    context: click.Context,
    /,
    paths: tuple[str, ...],
    as_json: bool,
    quiet: bool,
    progress: bool | None,
    **options: Any,
) -> None:
    """Denoise the picture IN and write it to OUT; or several, or a pattern such as 'raw/*.tif', into the folder OUT.

    PNG, TIFF and JPEG, 8 or 16 bits, grey or RGB; alpha is carried through. TIFF stacks are volumes or series, of float
    values too; pixels that are NaN are left out. With no option the noise is estimated and the rest follows from it.
    """
    for name, owner in _OPTIONS_OF_WEIGHTS.items():
        given_here = context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        if given_here and owner != options["kind"]:
            raise click.UsageError(f"--{name.replace('_', '-')} needs --weights {owner}")
    if len(paths) < 2:
        raise click.UsageError("Missing IN and OUT." if not paths else f"Missing OUT: where is {paths[0]} to go?")
    if quiet and options["explain"]:
        raise click.UsageError("--explain and --quiet contradict each other")
    *names, out = paths
    show = (sys.stderr.isatty() if progress is None else progress) and not quiet
    many = len(names) > 1 or is_pattern(names[0]) or os.path.isdir(out)

    def tell(plan: str) -> None:
        _say(plan, err=as_json)

    def settings() -> Settings:
        read = {"memory": as_bytes, "spacing": as_spacing, "axes": checked_axes}
        return Settings(
            **options | {name: as_(options[name]) for name, as_ in read.items() if options[name] is not None}
        )

    def one() -> dict[str, Any]:
        return denoise_file(Path(names[0]), Path(out), settings(), progress=show, tell=tell)

    def all_of_them() -> Outcome:
        return denoise_files(expand(names), Path(out), settings(), progress=show, tell=tell)

    if not many:
        report = _sentences(one)
        if as_json:
            click.echo(json.dumps(report, indent=2))
        elif not quiet:
            _say(as_lines(report))
        return
    outcome = _sentences(all_of_them)
    if outcome.failed:
        click.echo(f"gpureg: {outcome.failures()}", err=True)
    if outcome.interrupted:
        click.echo(f"gpureg: interrupted, {len(outcome.done)} of {outcome.count} files were done", err=True)
        raise click.exceptions.Exit(130)
    if as_json:
        click.echo(json.dumps(outcome.as_json(), indent=2))
    elif not quiet:
        _say(outcome.as_lines())
    raise click.exceptions.Exit(1 if outcome.failed else 0)


@main.command(epilog="Example: gpureg demo")
@click.argument("target", metavar="[OUT]", default="gpureg-demo.png", type=click.Path(path_type=Path, readable=False))
@click.option("--sigma", type=float, default=20.0, show_default=True, help="Noise to add, of 255.")
@click.option("--backend", default="auto", show_default=True, help="Where to run.")
def demo(target: Path, sigma: float, backend: str) -> None:
    """Add noise to scikit-image's camera picture, denoise it, and draw noisy | denoised | difference to OUT."""

    def work() -> None:
        check_destination(target)
        if not (math.isfinite(sigma) and sigma >= 1):
            raise ValueError(f"--sigma must be finite and >= 1 (less drowns in rounding to 8 bits), got {sigma}")
        try:
            from skimage import data

            from . import plot
        except ImportError as error:
            raise PictureError(f"the demo needs {error.name}: pip install 'gpureg[plot]'") from None
        clean = data.camera()
        noise = np.random.default_rng(0).standard_normal(clean.shape) * sigma
        noisy = np.clip(np.rint(clean + noise), 0, 255).astype(np.uint8)
        plan = plan_denoising(noisy)
        result = run_plan(plan, noisy, backend=backend, progress=sys.stderr.isatty())
        caption = f"{plan.describe()}\n{result.seconds:.2f} s on {result.backend}"
        try:
            before, after = (plot.quality(picture, clean)[0] for picture in (noisy, result.value))
            plot.compare(noisy, result.value, reference=clean, path=target, caption=caption)
        except ImportError as error:
            raise PictureError(f"the demo needs {error.name}: pip install 'gpureg[plot]'") from None
        _say(
            f"noise    sigma = {plan.sigma:.4g} of 255, estimated (added: {sigma:g})\n"
            f"filter   {plan.describe()}\n"
            f"done     {result.seconds:.2f} s on {result.backend}; PSNR {before:.2f} -> {after:.2f} dB\n"
            f"picture  {target.resolve()}"
        )

    _sentences(work)


def _gibibytes(count: int) -> str:
    return f"{count / 2**30:.1f} GiB" if count else "?"


@main.command("backends", epilog="Example: GPUREG_BACKEND=warp:cpu gpureg denoise noisy.png clean.png")
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def list_backends(as_json: bool) -> None:
    """List the devices gpureg can use, which one `auto` takes, and what would bring the absent ones."""
    found, absent = backends.devices(), backends.absent()
    code = 0
    try:
        taken, why = backends.get("auto").device.id, backends.why_auto()
    except (ValueError, backends.BackendUnavailable) as error:
        # GPUREG_BACKEND names what is not there: the table is what helps then.
        taken, why, code = "", str(error), 2 if isinstance(error, ValueError) else 1
    if as_json:
        rows = [
            {
                "id": device.id,
                "device": device.name,
                "driver": device.driver,
                "kind": device.kind,
                "memory_bytes": device.memory,
                "vector_width": device.vector_width,
                "float64": device.float64,
                "auto": device.id == taken,
            }
            for device in found
        ]
        click.echo(json.dumps({"devices": rows, "absent": absent, "auto": why}, indent=2))
        raise click.exceptions.Exit(code)
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("", "name", "device", "driver", "kind", "memory", "vector", "float64"):
        table.add_column(heading, overflow="fold")
    for device in found:
        table.add_row(
            "*" if device.id == taken else "",
            device.id,
            device.name,
            device.driver,
            device.kind,
            _gibibytes(device.memory),
            str(device.vector_width),
            "yes" if device.float64 else "no",
        )
    console = Console(width=None if sys.stdout.isatty() else 140, highlight=False, markup=False)
    console.print(table)
    click.echo(f"\n* {why}")
    for name, problem in absent.items():
        click.echo(f"  {name}: {problem}")
    raise click.exceptions.Exit(code)
