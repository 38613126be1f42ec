"""A curve as a document holds it: :class:`Line`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Line:
    """A curve in a document.

    Attributes
    ----------
    rows : (n, q) float array
        The vertices: two coordinates and other numbers, NaN where there is none.
    closed : bool
    name : str
        What a message calls it.
    fault : str or None
        Why it cannot be read.
    """

    rows: FloatArray
    closed: bool
    name: str
    fault: str | None = None

    def untreatable(self) -> str | None:
        """Say why this curve cannot be treated; None if it can."""
        if self.fault is not None:
            return f"{self.name}: {self.fault}"
        points, least = self.rows[:, :2], 3 if self.closed else 2
        if len(points) < least:
            return f"{self.name} has {len(points)} vertices, it needs {least}"
        if not np.isfinite(points).all():
            return f"{self.name} has a vertex that is not finite"
        different = len(np.unique(points, axis=0))
        if different == 1:
            return f"{self.name}: its vertices coincide"
        if different < least:
            return f"{self.name} has {different} different vertices, it needs {least}"
        return None
