"""Read and write tables of numbers as text, such as CSV, for points and curves."""

from __future__ import annotations

import gzip
import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from .pictures import PictureError


@dataclass(frozen=True, eq=False)
class Table:
    """A table of numbers.

    Attributes
    ----------
    rows : (n, c) float64 array
    names : tuple of str or None
        Names of the columns, None without a header.
    blocks : (n,) int array
        Number of gaps of blank lines before each row.
    delimiter : str
        The separator of two numbers.
    whole : (c,) bool array
        Whether all numbers of a column were written as integers.
    comments : tuple of str
        The lines that are comments, in order.
    behind : int
        Number of lines with a comment behind their numbers.
    """

    rows: FloatArray
    names: tuple[str, ...] | None
    blocks: npt.NDArray[np.int64]
    delimiter: str
    whole: npt.NDArray[np.bool_]
    comments: tuple[str, ...] = ()
    behind: int = 0


def read_text(path: str | os.PathLike[str], error: type[PictureError] = PictureError) -> str:
    """Read the text of a file, unpacked if its name ends in .gz.

    Raises
    ------
    error
        The file does not exist, cannot be read, is empty, or is not text.
    """
    try:
        data = Path(path).read_bytes()
        data = gzip.decompress(data) if Path(path).suffix.lower() == ".gz" else data
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except IsADirectoryError:
        raise error(f"{path} is a folder, not a file") from None
    except (gzip.BadGzipFile, zlib.error, EOFError) as fault:
        raise error(f"{path} is damaged, or not a gzip file: {fault}") from None
    except OSError as fault:
        raise error(f"{path} cannot be read: {fault.strerror}") from None
    if not data.strip():
        raise error(f"{path} is empty")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise error(f"{path} is not text in UTF-8") from None


def read_table(path: str | os.PathLike[str], error: type[PictureError] = PictureError) -> Table:
    """Read a table: one row on each line, separated by commas, semicolons, tabs or spaces; # begins a comment.

    Parameters
    ----------
    path : path
    error : type of PictureError
        The exception to raise.

    Raises
    ------
    error
        As :func:`read_text`; also a word that is not a number, or lines with different counts of numbers.
    """
    text = read_text(path, error)
    raw = text.splitlines()
    bare = [line.partition("#")[0] for line in raw] if "#" in text else raw
    lines = [line.strip() for line in bare]
    at = [k for k, line in enumerate(lines) if line]
    delimiter = next((sign for sign in ",;\t" if at and sign in lines[at[0]]), " ")
    names: tuple[str, ...] | None = None
    if at and not all(map(_is_number, first := _words(lines[at[0]], delimiter))):
        names = tuple(word.strip("\"'") for word in first)
        at = at[1:]
    if not at:
        raise error(f"{path} holds no numbers")
    rows = _numbers([lines[k] for k in at], delimiter)
    if rows is None:
        raise error(f"{path}, {_fault(lines, at, delimiter)}")
    if names is not None and len(names) != rows.shape[1]:
        raise error(f"{path}: its header names {len(names)} columns, and its lines have {rows.shape[1]}")
    whole = np.array([_is_whole(lines, at, delimiter, k, column) for k, column in enumerate(rows.T)])
    # the number of blank lines above each line; comments are not blank
    above = np.cumsum([not line.strip() for line in raw])[at]
    blocks = np.cumsum(np.diff(above, prepend=above[0]) > 0, dtype=np.int64)
    comments = tuple(line.strip() for line in raw if line.lstrip().startswith("#")) if bare is not raw else ()
    behind = sum("#" in line for line in raw) - len(comments) if bare is not raw else 0
    return Table(rows, names, blocks, delimiter, whole, comments, behind)


def _words(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else [word.strip() for word in line.split(delimiter)]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _numbers(lines: list[str], delimiter: str) -> FloatArray | None:
    """Parse the numbers in lines of text, (n, c); None if a word is not a number, or lines differ in length."""
    between = None if delimiter == " " else delimiter
    # numpy's parser does not read all numbers that Python reads, such as 1_000
    for converters in (None, float):
        try:
            return np.loadtxt(lines, delimiter=between, comments=None, ndmin=2, converters=converters)
        except ValueError:
            continue
    return None


def _fault(lines: list[str], at: list[int], delimiter: str) -> str:
    """Describe the first error; `at` are the lines with numbers."""
    count = 0
    for k in at:
        words = _words(lines[k], delimiter)
        wrong = next((word for word in words if not _is_number(word)), None)
        if wrong is not None:
            return f"line {k + 1}: {wrong!r} is not a number"
        count = count or len(words)
        if len(words) != count:
            return f"line {k + 1}: {len(words)} numbers where the first line has {count}"
    raise AssertionError("nothing is wrong with these lines")


def _is_whole(lines: list[str], at: list[int], delimiter: str, k: int, column: FloatArray) -> bool:
    """Return whether all numbers of column `k`, (n,), were written as integers, 3 and not 3.0."""
    if not (column == np.rint(column)).all():
        return False
    between = None if delimiter == " " else delimiter
    signs = set("".join([lines[row].split(between)[k] for row in at]))
    return all(sign.isdecimal() or sign.isspace() or sign in "+-" for sign in signs)


def encode_table(
    columns: Sequence[npt.NDArray[Any]], names: Sequence[str] | None, delimiter: str, gaps: npt.ArrayLike = ()
) -> bytes:
    """Encode columns (n,) as text, with the fewest digits that keep each number, and blank lines before rows `gaps`."""
    words = [[repr(value) for value in column.tolist()] for column in _shortest(columns)]
    lines = [delimiter.join(row) for row in zip(*words, strict=True)]
    for row in sorted(np.asarray(gaps, int).tolist(), reverse=True):
        lines.insert(row, "")
    head = [] if names is None else [delimiter.join(names)]
    return ("\n".join([*head, *lines]) + "\n").encode()


def _shortest(columns: Sequence[npt.NDArray[Any]]) -> list[npt.NDArray[Any]]:
    """Convert float32 columns (n,) to the float64 numbers with the same shortest digits."""
    return [
        np.array([float(str(value)) for value in column], np.float64) if column.dtype == np.float32 else column
        for column in columns
    ]
