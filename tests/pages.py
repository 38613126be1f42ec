"""Pages whose Python blocks run one after the other, and say in the text block that follows what they print.

``python tests/pages.py docs/images.md`` runs a page where it lies: its pictures are drawn anew, and what it says is
printed is written into it.
"""

from __future__ import annotations

import io
import math
import os
import re
import sys
from collections.abc import Iterator
from contextlib import chdir, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_BLOCK = re.compile(r"```python\n(?P<code>.*?)```(?:\s+```text\n(?P<said>.*?)```)?", re.S)
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Block:
    """A block that was run."""

    line: int
    section: str
    said: str
    printed: str


def run(page: Path, folder: Path) -> Iterator[Block]:
    """Run a page in a folder, all blocks in one scope."""
    text = page.read_text("utf-8")
    scope: dict[str, Any] = {}
    for found in _BLOCK.finditer(text):
        line = text.count("\n", 0, found.start("code")) + 1
        out = io.StringIO()
        # so that a traceback names the page's own line
        code = compile("\n" * (line - 1) + found["code"], str(page), "exec")
        with chdir(folder), redirect_stdout(out):
            exec(code, scope)
        heading = text.rfind("\n## ", 0, found.start())
        section = text[heading + 4 : text.index("\n", heading + 4)]
        yield Block(line, section, found["said"] or "", out.getvalue())


def same(said: str, printed: str, rtol: float) -> bool:
    """Whether two outputs have the same words, and numbers that agree."""
    words = [" ".join(_NUMBER.sub("#", text).split()) for text in (said, printed)]
    numbers = [[float(number) for number in _NUMBER.findall(text)] for text in (said, printed)]
    return words[0] == words[1] and all(
        math.isclose(a, b, rel_tol=rtol, abs_tol=1e-9) for a, b in zip(*numbers, strict=True)
    )


def differing(ran: list[Block], rtol: float) -> list[str]:
    """Where a page prints something else than it says."""
    return [
        f"line {block.line}: said\n{block.said}printed\n{block.printed}"
        for block in ran
        if not same(block.said, block.printed, rtol)
    ]


def renew(page: Path) -> None:
    """Run a page beside itself, and write what its blocks print into it."""
    printed = iter([block.printed for block in run(page, page.parent)])

    def renewed(found: re.Match[str]) -> str:
        output = "\n".join(line.rstrip() for line in next(printed).splitlines())
        if found["said"] is None:
            return found[0]
        begin, end = (place - found.start() for place in found.span("said"))
        return f"{found[0][:begin]}{output}\n{found[0][end:]}"

    page.write_text(_BLOCK.sub(renewed, page.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    os.environ.setdefault("MPLBACKEND", "agg")
    for name in sys.argv[1:]:
        renew(Path(name).resolve())
