"""The command line: ``gpureg denoise``, ``gpureg demo``, ``gpureg backends``.

Exit codes: 0 done, 1 the work failed (a file, a backend), 2 a wrong call, 130 interrupted.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from . import __version__, backends, weights
from .graph import METRICS
from .image import run_plan
from .io import Picture, PictureError, check_destination, read_picture, write_picture
from .memory import as_bytes
from .noise import estimate_noise
from .plan import DenoisePlan, plan_denoising
from .result import Result


class _Failure(click.ClickException):
    """The work failed: one sentence, exit code 1."""

    exit_code = 1

    def show(self, file: Any = None) -> None:
        click.echo(f"gpureg: {self.message}", err=True)


def _sentences(work: Callable[[], Any]) -> Any:
    """Run, and turn what can go wrong into a sentence and an exit code."""
    try:
        return work()
    except (PictureError, backends.BackendUnavailable, FloatingPointError) as error:
        raise _Failure(str(error)) from None
    except MemoryError as error:
        raise _Failure(f"not enough memory: {error}" if str(error) else "not enough memory") from None
    except (ValueError, TypeError) as error:
        raise click.UsageError(str(error)) from None


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


def _number(value: float) -> float | str:
    """A number as JSON can hold it."""
    return value if math.isfinite(value) else str(value)


def _report(plan: DenoisePlan, result: Result, source: Path, target: Path, picture: Picture) -> dict[str, Any]:
    height, width = picture.pixels.shape[:2]
    return {
        "input": str(source),
        "output": str(target),
        "width": width,
        "height": height,
        "channels": 1 if picture.pixels.ndim == 2 else picture.pixels.shape[2],
        "dtype": str(picture.pixels.dtype),
        "alpha": picture.alpha is not None,
        "sigma": plan.sigma,
        "sigma_estimated": plan.estimated,
        "filter": plan.describe(),
        "p": plan.p,
        "lam": _number(float(np.asarray(plan.lam))),
        "radius": plan.radius,
        "metric": plan.metric,
        "iterations": result.iterations,
        "stop": result.stop.name.lower(),
        "energy": [_number(energy) for energy in result.energy.tolist()],
        "eps": result.eps,
        "backend": result.backend,
        "seconds": round(result.seconds, 4),
        "version": __version__,
    }


def _three_lines(report: dict[str, Any]) -> str:
    white = {"uint8": " of 255", "uint16": " of 65535"}.get(report["dtype"], "")
    origin = "estimated" if report["sigma_estimated"] else "as given"
    size = (
        f"{report['width']} x {report['height']}, {report['channels']} channel(s){', alpha' if report['alpha'] else ''}"
    )
    return "\n".join(
        (
            f"noise    sigma = {report['sigma']:.4g}{white}, {origin}",
            f"filter   {report['filter']}",
            f"done     {report['seconds']:.2f} s on {report['backend']}; {size} -> {report['output']}",
        )
    )


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
@click.argument("source", metavar="IN", type=click.Path(path_type=Path, readable=False))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path, readable=False))
@click.option("--sigma", type=float, help="Noise's standard deviation in pixel values.  [default: estimated]")
@click.option("--p", type=float, help="Degree of regularity > 0: 2 smooth, 1 total variation, < 1 flat.  [default: 2]")
@click.option("--lam", type=float, help="Fidelity >= 0: larger stays closer to the picture.")
@click.option("--radius", type=float, help="Reach of the window in pixels.")
@click.option("--metric", type=click.Choice(METRICS), help="Shape of the window: square, disk, diamond.")
@click.option(
    "--weights",
    "kind",
    type=click.Choice(["constant", "bilateral", "patch"]),
    help="Weight function; the options below belong to it.  [default: patch for p = 2, otherwise constant]",
)
@click.option("--patch-radius", type=int, default=2, show_default=True, help="patch: radius of a patch.")
@click.option("--h", type=float, help="patch: filtering parameter.  [default: 0.6 sigma sqrt(samples)]")
@click.option("--patch-std", type=float, help="patch: Gaussian patch of this standard deviation.  [default: flat]")
@click.option("--sigma-space", type=float, default=3.0, show_default=True, help="bilateral: reach in pixels.")
@click.option("--sigma-value", type=float, help="bilateral: reach in pixel values.  [default: 3 sigma]")
@click.option("--max-iter", type=int, help="Iterations at most.")
@click.option("--tol", type=float, help="Stop when the largest change is this share of the range.")
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
    source: Path,
    target: Path,
    sigma: float | None,
    p: float | None,
    lam: float | None,
    radius: float | None,
    metric: Any,
    kind: str | None,
    patch_radius: int,
    h: float | None,
    patch_std: float | None,
    sigma_space: float,
    sigma_value: float | None,
    max_iter: int | None,
    tol: float | None,
    eps: float | None,
    backend: str,
    dtype: str | None,
    memory: str | None,
    as_json: bool,
    quiet: bool,
    progress: bool | None,
) -> None:
    """Denoise the picture IN and write it to OUT.

    PNG, TIFF and JPEG, 8 or 16 bits, grey or RGB; alpha is carried through. With no option the noise is estimated and
    the rest follows from it.
    """
    for name, owner in _OPTIONS_OF_WEIGHTS.items():
        given_here = context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        if given_here and owner != kind:
            raise click.UsageError(f"--{name.replace('_', '-')} needs --weights {owner}")

    def work() -> dict[str, Any]:
        picture = read_picture(source)
        check_destination(target, picture)
        axis = picture.channel_axis
        given: dict[str, Any] = {"sigma": sigma, "p": p, "lam": lam, "radius": radius, "metric": metric}
        given |= {"max_iter": max_iter, "tol": tol, "eps": eps}
        function = None
        lacks = {"bilateral": sigma_value is None, "patch": h is None}.get(kind or "", False)
        if kind is not None:
            noise = estimate_noise(picture.pixels, channel_axis=axis) if sigma is None else sigma
            samples = (2 * patch_radius + 1) ** 2 if patch_std is None else 1
            channels = 1 if axis is None else picture.pixels.shape[axis]
            if lacks and noise == 0:
                pass  # nothing to choose from, and nothing to do
            elif kind == "constant":
                function = weights.constant()
            elif kind == "bilateral":
                function = weights.bilateral(sigma_space, 3 * noise if sigma_value is None else sigma_value)
            else:
                reach = 0.6 * noise * math.sqrt(samples * channels) if h is None else h
                function = weights.patch(patch_radius, reach, sigma=noise, a=patch_std)
        plan = plan_denoising(picture.pixels, weights=function, channel_axis=axis, **given)
        if plan.sigma is None:  # it decided nothing, but is reported
            plan = replace(plan, sigma=estimate_noise(picture.pixels, channel_axis=axis), estimated=True)
        show = sys.stderr.isatty() if progress is None else progress
        result = run_plan(
            plan,
            picture.pixels,
            channel_axis=axis,
            backend=backend,
            dtype=dtype,
            progress=show and not quiet,
            memory=None if memory is None else as_bytes(memory),
        )
        write_picture(target, Picture(result.value, picture.alpha, picture.icc_profile))
        return _report(plan, result, source, target, picture)

    report = _sentences(work)
    if as_json:
        click.echo(json.dumps(report, indent=2))
    elif not quiet:
        click.echo(_three_lines(report))


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
        click.echo(f"noise    sigma = {plan.sigma:.4g} of 255, estimated (added: {sigma:g})")
        click.echo(f"filter   {plan.describe()}")
        click.echo(f"done     {result.seconds:.2f} s on {result.backend}; PSNR {before:.2f} -> {after:.2f} dB")
        click.echo(f"picture  {target.resolve()}")

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
