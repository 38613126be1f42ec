"""Tables of numbers in text, a row a line: CSV and its like, for points and curves."""

from __future__ import annotations

import gzip
import os
import re
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
    """Rows of numbers.

    Attributes
    ----------
    rows : (n, c) float64 array
    names : tuple of str or None
        The columns' names, where there is a header.
    blocks : (n,) int array
        How many gaps of blank lines come before each row.
    delimiter : str
        What stands between two numbers.
    whole : (c,) bool array
        Whether all numbers of a column were written without a point.
    """

    rows: FloatArray
    names: tuple[str, ...] | None
    blocks: npt.NDArray[np.int64]
    delimiter: str
    whole: npt.NDArray[np.bool_]


def read_text(path: str | os.PathLike[str], error: type[PictureError] = PictureError) -> str:
    """The text in a file, unpacked where its name ends in .gz.

    Raises
    ------
    error
        A file that is missing, may not be read, is empty, or holds no text.
    """
    try:
        data = Path(path).read_bytes()
        data = gzip.decompress(data) if Path(path).suffix.lower() == ".gz" else data
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except IsADirectoryError:
        raise error(f"{path} is a folder, not a file") from None
    except (gzip.BadGzipFile, zlib.error, EOFError) as fault:
        raise error(f"{path} is damaged, or not packed by gzip: {fault}") from None
    except OSError as fault:
        raise error(f"{path} cannot be read: {fault.strerror}") from None
    if not data.strip():
        raise error(f"{path} is empty")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise error(f"{path} holds no text in UTF-8") from None


def read_table(path: str | os.PathLike[str], error: type[PictureError] = PictureError) -> Table:
    """The table in a text file: numbers between commas, semicolons, tabs or spaces; lines after # are comments.

    Raises
    ------
    error
        As :func:`read_text`; a line with something that is no number, or with more or fewer numbers than the first.
    """
    names: tuple[str, ...] | None = None
    delimiter, block, gap = "", 0, False
    rows: list[list[float]] = []
    blocks: list[int] = []
    written: list[list[bool]] = []
    for number, raw in enumerate(read_text(path, error).splitlines(), 1):
        line = raw.partition("#")[0].strip()
        if not line:
            gap = gap or not raw.strip()
            continue
        if not delimiter:
            delimiter = next((sign for sign in ",;\t" if sign in line), " ")
        words = line.split() if delimiter == " " else [word.strip() for word in line.split(delimiter)]
        try:
            values = [float(word) for word in words]
        except ValueError:
            if rows or names is not None:
                wrong = next(word for word in words if not _is_number(word))
                raise error(f"{path}, line {number}: {wrong!r} is no number") from None
            names = tuple(word.strip("\"'") for word in words)
            continue
        if rows and len(values) != len(rows[0]):
            raise error(f"{path}, line {number}: {len(values)} numbers where the first line has {len(rows[0])}")
        block += gap and bool(rows)
        gap = False
        rows.append(values)
        blocks.append(block)
        if len(rows) == 1:
            written = [[] for _ in words]
        for column, word in zip(written, words, strict=True):
            column.append(re.fullmatch(r"[+-]?\d+", word) is not None)
    if not rows:
        raise error(f"{path} holds no numbers")
    if names is not None and len(names) != len(rows[0]):
        raise error(f"{path}: its header names {len(names)} columns, and its lines have {len(rows[0])}")
    whole = np.array([all(column) for column in written])
    return Table(np.array(rows), names, np.array(blocks), delimiter, whole)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def encode_table(
    columns: Sequence[npt.NDArray[Any]], names: Sequence[str] | None, delimiter: str, gaps: npt.ArrayLike = ()
) -> bytes:
    """Columns as text, each number in as few digits as give it back; blank lines before the rows `gaps`."""
    words = [[repr(value) for value in column.tolist()] for column in _shortest(columns)]
    lines = [delimiter.join(row) for row in zip(*words, strict=True)]
    for row in sorted(np.asarray(gaps, int).tolist(), reverse=True):
        lines.insert(row, "")
    head = [] if names is None else [delimiter.join(names)]
    return ("\n".join([*head, *lines]) + "\n").encode()


def _shortest(columns: Sequence[npt.NDArray[Any]]) -> list[npt.NDArray[Any]]:
    """Columns in float64, of single precision those doubles whose digits are as few."""
    return [
        np.array([float(str(value)) for value in column], np.float64) if column.dtype == np.float32 else column
        for column in columns
    ]
