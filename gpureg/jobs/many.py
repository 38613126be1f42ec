"""Do the work of ``gpureg points`` on many files; a failure does not stop the others and is reported at the end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..files.pictures import PictureError
from ..progress import progress_bar
from .batch import FAILURES, sentence
from .report import ShapeReport


@dataclass
class ManyFiles:
    """The result for many files: reports of those that are done, messages of those that failed."""

    folder: Path
    count: int
    done: list[ShapeReport] = field(default_factory=list)
    failed: list[tuple[Path, str]] = field(default_factory=list)
    interrupted: bool = False

    def as_json(self) -> dict[str, Any]:
        """Return the reports as a dictionary for JSON."""
        failed = [{"input": str(source), "error": error} for source, error in self.failed]
        return {"files": [report.as_json() for report in self.done], "failed": failed}

    def lines(self) -> list[str]:
        """Return a line for each note and each file, and one for all, without the failures."""
        lines = []
        for report in self.done:
            told = [line for line in report.lines() if line.startswith(("note", "left out"))]
            lines += [f"{line} ({report.input})" for line in told]
        seconds = sum(report.seconds for report in self.done)
        on = ", ".join(sorted({report.backend for report in self.done if report.backend}))
        lines.append(
            f"done     {len(self.done)} of {self.count} files in {seconds:.2f} s{f' on {on}' if on else ''}"
            f" -> {self.folder}"
        )
        return lines

    def failures(self) -> str:
        """List the files that failed, and why."""
        told = (error if error.startswith(str(source)) else f"{source}: {error}" for source, error in self.failed)
        return "\n".join((f"{len(self.failed)} of {self.count} files failed:", *(f"  {line}" for line in told)))


def each_file(
    sources: Sequence[Path],
    targets: Sequence[Path],
    folder: Path,
    work: Callable[[Path, Path], ShapeReport],
    *,
    progress: bool = False,
) -> ManyFiles:
    """Do the work on each file; `targets` lie in `folder`, which is created if it does not exist.

    An interruption returns the result so far; no partial file is written.

    Raises
    ------
    PictureError
        The folder cannot be created.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise PictureError(f"{folder} cannot be created: {error.strerror}") from None
    outcome = ManyFiles(folder, len(sources))
    try:
        with progress_bar(progress, len(sources), "files") as report:
            report(0)
            for i, (source, target) in enumerate(zip(sources, targets, strict=True), start=1):
                try:
                    outcome.done.append(work(source, target))
                except FAILURES as error:
                    outcome.failed.append((source, sentence(error)))
                report(i)
    except KeyboardInterrupt:
        outcome.interrupted = True
    return outcome
