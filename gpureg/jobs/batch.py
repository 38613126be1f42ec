"""Denoise many picture files into a folder; a failure does not stop the others and is reported at the end."""

from __future__ import annotations

import glob
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from statistics import fmean as mean
from typing import Any, Generic, Protocol, TypeVar

from ..backends import BackendUnavailable
from ..files.pictures import FORMATS, PictureError
from ..progress import progress_bar
from .denoise import beside_of, denoise_file
from .denoise_report import DenoiseReport
from .denoise_settings import Settings, rehearse
from .report import axes_line, left_out, quality_line

# Exceptions that one file may raise, reported in one sentence.
FAILURES = (PictureError, BackendUnavailable, FloatingPointError, MemoryError, ValueError, TypeError)


def sentence(error: BaseException) -> str:
    """Return the message of an error."""
    if isinstance(error, MemoryError):
        return f"not enough memory: {error}" if str(error) else "not enough memory"
    return str(error)


class AsJson(Protocol):
    """The report on one file."""

    def as_json(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON."""


R = TypeVar("R", bound=AsJson)


@dataclass
class Files(Generic[R]):
    """The result for many files: reports of those that are done, messages of those that failed."""

    folder: Path
    count: int
    done: list[R] = field(default_factory=list)
    failed: list[tuple[Path, str]] = field(default_factory=list)
    interrupted: bool = False

    def as_json(self) -> dict[str, Any]:
        """Return the outcome as a dictionary for JSON."""
        failed = [{"input": str(source), "error": error} for source, error in self.failed]
        return {"files": [report.as_json() for report in self.done], "failed": failed}

    def failures(self) -> str:
        """List the files that failed, and why."""
        told = (error if error.startswith(str(source)) else f"{source}: {error}" for source, error in self.failed)
        return "\n".join((f"{len(self.failed)} of {self.count} files failed:", *(f"  {line}" for line in told)))


@dataclass
class Outcome(Files[DenoiseReport]):
    """The result for many pictures."""

    def lines(self) -> list[str]:
        """Return the outcome, without the failures, as lines of text."""
        lines = []
        guessed = [report for report in self.done if report.axes_guessed]
        if guessed:
            lines.append(f"{axes_line(guessed[0].as_json())} ({len(guessed)} file(s))")
        nans, outside = sum(report.nan for report in self.done), sum(report.outside_mask for report in self.done)
        nodata = sum(report.nodata for report in self.done)
        if nans or outside or nodata:
            lines.append(left_out(nans, outside, nodata))
        measured = [report.measured() for report in self.done if report.quality is not None]
        if measured:
            psnr, ssim = (
                {which: mean(float(report[name][which]) for report in measured) for which in ("input", "output")}
                for name in ("psnr", "ssim")
            )
            lines.append(f"{quality_line(psnr, ssim)} on average")
        told = Counter(note for report in self.done for note in report.files.get("notes", ()))
        lines += [f"note     {note} ({count} file(s))" for note, count in told.items()]
        seconds = sum(report.seconds for report in self.done)
        on = ", ".join(sorted({report.backend for report in self.done}))
        lines.append(
            f"done     {len(self.done)} of {self.count} files in {seconds:.2f} s{f' on {on}' if on else ''}"
            f" -> {self.folder}"
        )
        return lines


def is_pattern(text: str) -> bool:
    """Return whether a name is a pattern: it has ``*``, ``?`` or ``[``, and no file has this name."""
    return any(sign in text for sign in "*?[") and not os.path.lexists(text)


def expand(names: Sequence[str]) -> list[Path]:
    """List the files of names and patterns, each once.

    Raises
    ------
    PictureError
        A pattern matches no file.
    """
    found: dict[Path, None] = {}
    for name in names:
        fitting = [name]
        if is_pattern(name):
            fitting = sorted(path for path in glob.glob(name, recursive=True) if not os.path.isdir(path))
            if not fitting:
                raise PictureError(f"{name}: no file matches this pattern")
        found |= dict.fromkeys(Path(os.path.normpath(path)) for path in fitting)
    return list(found)


def targets_in(folder: Path, sources: Sequence[Path], settings: Settings) -> list[Path]:
    """List the pictures to write, as :func:`targets_of`; `settings` names the files that are read beside `sources`."""
    return targets_of(folder, sources, [path for source in sources for path in beside_of(source, settings)])


def targets_of(
    folder: Path, sources: Sequence[Path], others: Iterable[Path] = (), *, formats: Iterable[str] = FORMATS
) -> list[Path]:
    """List the files to write: the names of `sources` in `folder`.

    Parameters
    ----------
    folder : Path
    sources : sequence of Path
    others : iterable of Path
        Files that are read beside `sources`.
    formats : iterable of str
        Extensions of files; a new folder with one of these is refused.

    Raises
    ------
    PictureError, ValueError
        `folder` is a file or has no parent, two files have the same name, or an output would overwrite an input.
    """
    is_there = os.path.exists(folder)
    if is_there and not folder.is_dir():
        raise ValueError(f"{folder} is a file; several inputs, or a pattern, need a folder as OUT")
    if not is_there and folder.suffix.lower() in formats:
        what = "a picture" if formats is FORMATS else "a file"
        raise ValueError(f"{folder} is named like {what}; several inputs, or a pattern, need a folder as OUT")
    if not is_there and not os.path.isdir(folder.parent):
        raise PictureError(f"{folder} cannot be created: the folder {folder.parent} does not exist")
    owner: dict[str, Path] = {}
    for source in sources:
        name = os.path.normcase(source.name)
        if name in owner:
            raise ValueError(
                f"{owner[name]} and {source} would both be written to {folder / source.name}; give them in two calls"
            )
        owner[name] = source
    targets = [folder / source.name for source in sources]
    known = {_identity(path): path for path in (*sources, *others) if os.path.exists(path)}
    for target in targets:
        if os.path.exists(target) and (path := known.get(_identity(target))):
            raise ValueError(f"{target} would overwrite {path}, which is read; give another folder")
    return targets


def make_folder(folder: Path) -> None:
    """Create a folder if it does not exist; raise PictureError if that fails."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise PictureError(f"{folder} cannot be created: {error.strerror}") from None


def _identity(path: Path) -> tuple[int, int]:
    """Return the device and inode, the same for all names of a file."""
    status = path.stat()
    return status.st_dev, status.st_ino


def _tell_of(tell: Callable[[str], None], source: Path, plan: str) -> None:
    tell(f"{source}\n{plan}")


def denoise_files(
    sources: Sequence[Path],
    folder: Path,
    settings: Settings,
    *,
    progress: bool = False,
    tell: Callable[[str], None] = lambda text: None,
) -> Outcome:
    """Denoise files into a folder, which is created if it does not exist; the parameters are as in `denoise_file`.

    An interruption returns the outcome so far; no partial file is written.

    Raises
    ------
    PictureError, ValueError, TypeError, BackendUnavailable
        The options are wrong for all files; raised before any work.
    """
    targets = targets_in(folder, sources, settings)
    rehearse(settings)
    make_folder(folder)
    outcome = Outcome(folder, len(sources))
    try:
        # Printed plans would mix with the bar.
        with progress_bar(progress and not settings.explain, len(sources), "files") as report:
            report(0)
            for i, (source, target) in enumerate(zip(sources, targets, strict=True), start=1):
                try:
                    done = denoise_file(source, target, settings, tell=partial(_tell_of, tell, source))
                    outcome.done.append(done)
                except FAILURES as error:
                    outcome.failed.append((source, sentence(error)))
                report(i)
    except KeyboardInterrupt:
        outcome.interrupted = True
    return outcome
