"""Text and reports on a terminal."""

from __future__ import annotations

import json
import re
import shutil
import sys
import textwrap
from typing import Any, Protocol

import click


class Report(Protocol):
    """What a job did."""

    def as_json(self) -> dict[str, Any]:
        """The report as JSON can hold it."""

    def lines(self) -> list[str]:
        """The report for a reader."""


def tell(report: Report, as_json: bool, quiet: bool) -> None:
    """Write a report on standard output, as JSON or in a few lines, or not at all."""
    if as_json:
        click.echo(json.dumps(report.as_json(), indent=2))
    elif not quiet:
        say("\n".join(report.lines()))


def say(text: str, *, err: bool = False) -> None:
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
