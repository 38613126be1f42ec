"""The group of all commands, and its errors: one sentence and an exit code.

The exit code is 0 after success, 1 after a failure (a file, a backend), 2 after a wrong call, 130 if interrupted.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import click

from .._version import __version__
from ..doors import without_names
from ..jobs.batch import FAILURES, sentence

# Options that had another name before.
RENAMED = {
    "--free-ends": "--no-keep-ends",
    "--function": "--filter",
    "--merge": "--merge-tol",
    "--nearest": "--k",
    "--patch-std": "--patch-sigma",
}


class _Failure(click.ClickException):
    """A failure, printed as one sentence, with exit code 1."""

    exit_code = 1

    def show(self, file: Any = None) -> None:
        """Print the message to standard error."""
        click.echo(f"gpureg: {self.message}", err=True)


def sentences(work: Callable[[], Any]) -> Any:
    """Call `work`, and turn its exceptions into a sentence and an exit code."""
    try:
        with without_names(), _warnings_as_lines():
            return work()
    except (ValueError, TypeError) as error:
        raise click.UsageError(sentence(error)) from None
    except FAILURES as error:
        raise _Failure(sentence(error)) from None


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print warnings as sentences on standard error, without a line of code."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        click.echo(f"gpureg: {message}", err=True)

    with warnings.catch_warnings():
        warnings.filterwarnings("always", category=UserWarning)
        warnings.showwarning = show
        yield


class _Group(click.Group):
    """A group that ends without a traceback, also when interrupted."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run a command and exit."""
        try:
            # In standalone mode click would exit itself; otherwise it returns the exit code.
            code = super().main(*args, **{**kwargs, "standalone_mode": False})
            sys.exit(code if isinstance(code, int) else 0)
        except (KeyboardInterrupt, click.Abort):
            click.echo("gpureg: interrupted, nothing was written", err=True)
            sys.exit(130)
        except click.ClickException as error:
            if isinstance(error, click.NoSuchOption) and error.option_name in RENAMED:
                old = error.option_name
                error = click.UsageError(f"{old} is called {RENAMED[old]} now", error.ctx)
            error.show()
            sys.exit(error.exit_code)
        except OSError as error:
            # Writing to standard output failed: the pipe is closed, which is no error, or the disk is full.
            if not isinstance(error, BrokenPipeError):
                click.echo(f"gpureg: standard output: {error.strerror}", err=True)
            # Discard the buffered output, or the interpreter would report an error at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(1)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="gpureg")
def main() -> None:
    """Denoise, simplify and cluster pictures, volumes, meshes, curves and point clouds.

    The method is p-Laplacian regularization on weighted graphs, on the fastest available device.
    """
