"""Print text and reports on a terminal."""

from __future__ import annotations

import json
import re
import shutil
import sys
import textwrap
from typing import Any, NoReturn, Protocol

import click

from ..jobs.many import Many


class Report(Protocol):
    """The report of a job."""

    def as_json(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON."""

    def lines(self) -> list[str]:
        """Return the report as lines of text."""


def tell(report: Report, as_json: bool, quiet: bool) -> None:
    """Print a report to standard output as JSON or as text, unless `quiet`."""
    if as_json:
        click.echo(json.dumps(report.as_json(), indent=2))
    elif not quiet:
        say("\n".join(report.lines()))


def tell_many(outcome: Many, as_json: bool, quiet: bool) -> NoReturn:
    """Print what was done with many files, and exit; failures go to standard error."""
    if outcome.failed:
        click.echo(f"gpureg: {outcome.failures()}", err=True)
    if outcome.interrupted:
        click.echo(f"gpureg: interrupted, {len(outcome.done)} of {outcome.count} files were done", err=True)
        raise click.exceptions.Exit(130)
    tell(outcome, as_json, quiet)
    raise click.exceptions.Exit(1 if outcome.failed else 0)


def say(text: str, *, err: bool = False) -> None:
    """Print text; on a terminal wrap long lines, and indent the rest of a line to its last column."""
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
