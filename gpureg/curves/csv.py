"""Read and write polygonal curves as CSV: :class:`Csv`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..files.table import encode_table, read_table
from ..shapes.ends import ends_of
from .contents import CurveError, CurveInFile, CurvesFile, treated
from .lines import Line


@dataclass(frozen=True, eq=False)
class Csv:
    """The form of a CSV file: its header, its delimiter, how its curves are separated, and those not treated."""

    names: tuple[str, ...] | None
    delimiter: str
    by_column: IntArray | None
    repeated: list[bool]
    untreated: dict[int, CurveInFile] = field(default_factory=dict)

    def encode(self, curves: Sequence[CurveInFile]) -> bytes:
        """Encode the file with new curves, in the same order."""
        others = iter(curves)
        count = len(curves) + len(self.untreated)
        curves = [self.untreated[k] if k in self.untreated else next(others) for k in range(count)]
        rows: list[FloatArray] = []
        gaps: list[int] = []
        number: list[npt.NDArray[Any]] = []
        for k, (curve, again) in enumerate(zip(curves, self._repeats(curves), strict=True)):
            table = np.concatenate([curve.points, curve.more], axis=1)
            table = np.concatenate([table, table[:1]]) if again else table
            gaps.append(sum(len(part) for part in rows))
            number.append(np.full(len(table), k if self.by_column is None else self.by_column[k]))
            rows.append(table)
        columns = list(np.concatenate(rows).T)
        columns = [column.astype(np.int64) if (column == np.rint(column)).all() else column for column in columns]
        if self.by_column is not None:
            columns.insert(2, np.concatenate(number))
        return encode_table(columns, self.names, self.delimiter, [] if self.by_column is not None else gaps[1:])

    def _repeats(self, curves: Sequence[CurveInFile]) -> list[bool]:
        """Choose the curves that repeat their first vertex: as in the input, or all closed ones if that is wrong."""
        told = [k < len(self.repeated) and self.repeated[k] and curve.closed for k, curve in enumerate(curves)]
        closed = [curve.closed for curve in curves]
        read = told if any(told) else [ends_of(curve.points).closed for curve in curves]
        return told if read == closed else closed


def read_csv(path: str | os.PathLike[str], closed: bool | None) -> CurvesFile:
    """Read the curves of a CSV file; the parameters and errors are those of :func:`gpureg.read_curves`."""
    table = read_table(path, CurveError)
    rows, names = table.rows, table.names
    if rows.shape[1] < 2:
        raise CurveError(f"{path}: a vertex needs two coordinates, x and y")
    lower = [name.lower() for name in names] if names is not None else []
    x, y = (lower.index("x"), lower.index("y")) if {"x", "y"} <= set(lower) else (0, 1)
    which = lower.index("curve") if "curve" in lower else None
    rest = [k for k in range(rows.shape[1]) if k not in (x, y, which)]
    label = table.blocks if which is None else rows[:, which].astype(np.int64)
    numbers, first = np.unique(label, return_index=True)
    numbers = numbers[np.argsort(first)]
    parts = [rows[label == number] for number in numbers]
    ends = [ends_of(part[:, [x, y]], closed) for part in parts]
    if closed is None and any(one.repeated for one in ends):
        # if a file repeats the first vertex of some curves, the others are open
        ends = [one if one.repeated else replace(one, closed=False, why="source") for one in ends]
    lines = [
        Line((part[:-1] if one.repeated else part)[:, [x, y, *rest]], one.closed, f"curve {k}")
        for k, (part, one) in enumerate(zip(parts, ends, strict=True))
    ]
    curves = [
        CurveInFile(line.rows[:, :2], line.closed, line.rows[:, 2:], one) for line, one in zip(lines, ends, strict=True)
    ]
    head = None
    if names is not None:
        head = (names[x], names[y], *([] if which is None else [names[which]]), *(names[k] for k in rest))
    own, left = treated(path, lines)
    untreated = {k: curve for k, curve in enumerate(curves) if k not in own}
    repeated = [one.repeated for one in ends]
    document = Csv(head, table.delimiter, None if which is None else numbers, repeated, untreated)
    return CurvesFile([curves[k] for k in own], False, ".csv", document, left)
