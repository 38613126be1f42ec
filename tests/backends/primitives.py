"""One struct a primitive: what it is called with, what it gives, and how far a device may be off.

A row says what a primitive is called with and what it writes. It serves the tests (checking.py: values within bounds,
the same bits on a second run, nothing written outside of an array; mutations must break the same comparison), the
table of what each device supports (support.py) and the traffic that bench/model.py counts. rows.py has the rows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from checking import On

# What an argument or a result is, and how many numbers per vertex that makes, of D neighbours, m channels, G gradient
# norms. A grid has a weight or a length once per pair, a stored graph for every directed edge.
FUNCTION, NORMS, EDGES = "function", "norms", "edges"  # m, G, D m
COLUMN = "column"  # one number, or 1; also m where it is divided by
HOST, GUIDE = "host", "guide"  # a host array of m; another one, or none
WEIGHTS, LENGTHS = "weights", "lengths"  # D or D/2
LABELS, ZONES = "labels", "zones"  # 1; a distance of two and a label
NUMBER, SETTING, SCRATCH = "number", "setting", "scratch"  # none


@dataclasses.dataclass(frozen=True, eq=False)
class Call:
    """One call of a primitive.

    Attributes
    ----------
    what : str
        What is special of it, in words.
    args : dict
        Arguments by name, on the host.
    bound : callable
        Of the exact result: how far a device may be off.
    place : str or None
        The argument that is also the output; None for an output of its own, full of NaN before.
    channels : int or None
        Of the output; None for those of the problem.
    also : callable or None
        More to hold, of a device (:class:`On`), its result on the host and the device's own result.
    """

    what: str
    args: dict[str, Any]
    bound: Callable[[Any], Any]
    place: str | None = None
    channels: int | None = None
    also: Callable[[On, Any, Any], None] | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Primitive:
    """A primitive of the protocol.

    Attributes
    ----------
    name : str
        The method of :class:`gpureg.backends.Backend`.
    args : dict
        What each argument is, by name, but the first one: weights or a graph.
    result : str
        What it gives.
    calls : callable
        The calls to make for a problem.
    weights : bool
        Whether its first argument is a graph with its weights, which it reads.
    out : bool
        Whether it takes an output.
    graphs : tuple of str
        The kinds of graph it is for: "grid", "stored".
    parts : tuple of str
        The primitives that it is made of, where it is no kernel of its own.
    columns : tuple of str
        The arguments of one channel that are never a number.
    """

    name: str
    args: dict[str, str]
    result: str
    calls: Callable[[Any], Iterator[Call]]
    weights: bool = True
    out: bool = True
    graphs: tuple[str, ...] = ("grid", "stored")
    parts: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()

    def traffic(
        self,
        neighbours: float,
        *,
        channels: int = 1,
        norms: int = 1,
        stored: bool = False,
        arrays: tuple[str, ...] = (),
        itemsize: int = 4,
    ) -> tuple[float, float]:
        """Bytes read and bytes written per vertex of so many neighbours, each array once.

        Arguments that may be numbers or left out are, but for those named in `arrays`. A stored graph has an index for
        every weight, and a pointer per vertex.
        """
        if self.parts:
            settings = {"channels": channels, "norms": norms, "stored": stored, "itemsize": itemsize}
            found = [ROWS[part].traffic(neighbours, arrays=arrays, **settings) for part in self.parts]
            return sum(read for read, _ in found), sum(written for _, written in found)
        pairs = neighbours if stored else neighbours / 2
        sizes = {
            FUNCTION: channels, NORMS: norms, EDGES: neighbours * channels, COLUMN: 1, HOST: channels, GUIDE: channels,
            WEIGHTS: pairs, LENGTHS: pairs, LABELS: 1, ZONES: 3, NUMBER: 0, SETTING: 0, SCRATCH: 0,
        }  # fmt: skip
        read = sum(
            sizes[kind]
            for name, kind in self.args.items()
            if kind not in (COLUMN, GUIDE) or name in (*self.columns, *arrays)
        )
        if self.weights:
            read += 2 * neighbours + 1 if stored else pairs
        return read * itemsize, sizes[self.result] * itemsize


ROWS: dict[str, Primitive] = {}
"""Every primitive by its name; tests/backends/rows.py fills it."""


def assert_within(actual: Any, exact: Any, bound: Any, what: str) -> None:
    """NaN fails too: it is not <= anything."""
    actual, exact = np.asarray(actual, float), np.asarray(exact)
    assert actual.shape == exact.shape
    with np.errstate(invalid="ignore"):
        off = np.where(actual == exact, 0, np.abs(actual - exact))
    bad = ~(off <= bound)
    if bad.any():
        at = tuple(int(i[0]) for i in np.nonzero(np.atleast_1d(bad)))
        worst = np.nanmax(np.where(bad, off, 0), initial=0)
        raise AssertionError(
            f"{what}: {int(bad.sum())} of {bad.size} numbers are out of bounds, the first at {at}: "
            f"{np.atleast_1d(actual)[at]} for {np.atleast_1d(exact)[at]}, "
            f"allowed {np.atleast_1d(np.broadcast_to(bound, off.shape))[at]:.2g}; the worst is off by {worst:.2g}"
        )
