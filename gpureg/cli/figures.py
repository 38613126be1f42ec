"""``gpureg figures``: draw the figures of the paper."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ..files.picture import PictureError
from ..progress import progress_bar
from . import options
from .group import sentences
from .options import FILE
from .terminal import say


@click.command(
    epilog=options.examples(
        "gpureg figures paper/ --quick", "gpureg figures paper/ --only 6 --only 8 --mesh bunny.ply"
    ),
    short_help="Draw the figures of the paper.",
)
@click.argument("folder", metavar="DIR", type=FILE)
@click.option("--only", type=click.IntRange(1, 9), multiple=True, metavar="N", help="Only this figure; repeatable.")
@click.option("--quick", is_flag=True, help="Smaller pictures and shapes: all figures within a minute.")
@click.option(
    "--image",
    type=FILE,
    help="Picture for figures 1 to 4; alpha is ignored.  [default: scikit-image's camera, astronaut]",
)
@click.option("--mesh", type=FILE, help="Mesh for figures 6 and 8, such as the Stanford bunny.  [default: generated]")
@click.option(
    "--curve", type=FILE, help="Closed curve for figures 5, 7, 9.  [default: scikit-image's horse, generated coast]"
)
@click.option(
    "--noise/--no-noise",
    default=True,
    show_default=True,
    help="Add noise in figures 3, 5 and 6; --no-noise for inputs that are noisy already.",
)
@options.backend
@options.quiet
@options.progress
def figures(
    folder: Path,
    only: tuple[int, ...],
    quick: bool,
    image: Path | None,
    mesh: Path | None,
    curve: Path | None,
    noise: bool,
    backend: str,
    quiet: bool,
    progress: bool | None,
) -> None:
    """Draw the figures of Bougleux, Elmoataz and Melkemi (2009) into DIR.

    Write fig1.png to fig9.png, each with its parameters and a description, and its numbers as fig1.json to fig9.json.
    The pictures come with scikit-image, the meshes and the coast are generated; options replace them by files. DIR is
    created if it does not exist.
    """
    show = (sys.stderr.isatty() if progress is None else progress) and not quiet

    def work() -> None:
        try:
            import matplotlib  # noqa: F401
            import skimage  # noqa: F401
        except ImportError as error:
            raise click.ClickException(f"the figures need {error.name}: pip install 'gpureg[plot]'") from None
        from ..figures import FIGURES, Inputs, draw_figures

        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise PictureError(f"{folder}: the folder cannot be created, {error.strerror}") from None
        inputs = Inputs(image, mesh, curve, noise, quick, backend)
        written: list[str] = []
        try:
            figures = draw_figures(folder, inputs, only)
            while True:
                # remove the bar before text is printed
                with progress_bar(show, len(set(only)) or len(FIGURES), "figures") as report:
                    report(len(written))
                    found = next(figures, None)
                if found is None:
                    return
                drawn, path, seconds = found
                written.append(path.name)
                if not quiet:
                    say(f"{drawn.title}\n{drawn.see}\n{path}, {seconds:.1f} s\n")
        except KeyboardInterrupt:
            click.echo(f"gpureg: interrupted; written: {', '.join(written) or 'nothing'}", err=True)
            sys.exit(130)

    sentences(work)
