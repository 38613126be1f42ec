"""``gpureg noise``: describe the noise of pictures, volumes and series."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import click

from ..files.picture import checked_axes
from ..jobs.batch import FAILURES, expand, is_pattern, sentence
from ..jobs.noise import NoiseOptions, noise_of_file
from . import options
from .group import sentences
from .terminal import say


@click.command(
    epilog=options.examples("gpureg noise scan.tif", "gpureg noise 'raw/*.tif' --each T --json"),
    short_help="Describe the noise of pictures.",
)
@click.argument("paths", metavar="IN...", nargs=-1, required=True)
@click.option("--offset", type=float, help="The camera's value without light: tells its gain and its read noise.")
@options.axes
@options.each
@options.mask
@options.nodata
@options.as_json
def noise(
    paths: tuple[str, ...],
    offset: float | None,
    axes: str | None,
    each: tuple[str, ...],
    mask: Path | None,
    nodata: float | None,
    as_json: bool,
) -> None:
    """Describe the noise of the pictures IN in words: its strength in each channel, and whether it is white.

    Named are growth with the signal (photon noise), impulses, correlation, stripes, blocks of a JPEG, mosaics of a
    colour sensor, and what the measurement left out.
    """
    chosen = sentences(lambda: NoiseOptions(offset, None if axes is None else checked_axes(axes), each, mask, nodata))
    found, failed = [], 0
    for source in sentences(lambda: expand(paths)):
        if len(paths) == 1 and not is_pattern(paths[0]):
            found.append(sentences(partial(noise_of_file, source, chosen)))
            break
        try:
            found.append(noise_of_file(source, chosen))
        except FAILURES as error:
            failed += 1
            click.echo(f"gpureg: {sentence(error)}", err=True)
    if as_json:
        rows = [report.as_json() for report in found]
        click.echo(json.dumps(rows if len(paths) > 1 or len(rows) != 1 else rows[0], indent=2))
    else:
        say("\n".join(line for report in found for line in report.lines()))
    raise click.exceptions.Exit(1 if failed else 0)
