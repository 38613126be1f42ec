"""Treat many files of shapes one after another: :func:`treat_files`; a failure does not stop the others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..progress import progress_bar
from .batch import FAILURES, Files, make_folder, sentence, targets_of
from .report import ShapeReport


@dataclass
class Many(Files[ShapeReport]):
    """The result for many files of shapes."""

    def lines(self) -> list[str]:
        """Return the outcome, without the failures, as lines of text."""
        told = [f"{line} ({report.input})" for report in self.done for line in report.cautions()]
        seconds = sum(report.seconds for report in self.done)
        on = ", ".join(sorted({report.backend for report in self.done if report.backend}))
        count = f"{len(self.done)} of {self.count} files"
        return [*told, f"done     {count} in {seconds:.2f} s{f' on {on}' if on else ''} -> {self.folder}"]


def treat_files(
    sources: Sequence[Path],
    folder: Path,
    work: Callable[[Path, Path], ShapeReport],
    *,
    others: Iterable[Path] = (),
    formats: Iterable[str] = (),
    progress: bool = False,
) -> Many:
    """Treat files into a folder, which is created if it does not exist.

    Parameters
    ----------
    sources : sequence of Path
    folder : Path
    work : callable
        Treats one file: called with IN and OUT.
    others : iterable of Path
        Files that are read beside `sources`.
    formats : iterable of str
        Extensions of files; a new folder with one of these is refused.
    progress : bool, default False
        Whether to show a progress bar.

    Returns
    -------
    Many
        An interruption ends it early; no partial file is written.

    Raises
    ------
    PictureError, ValueError
        The folder, or two of the files, cannot be used; raised before any work.
    """
    targets = targets_of(folder, sources, others, formats=formats)
    make_folder(folder)
    outcome = Many(folder, len(sources))
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
