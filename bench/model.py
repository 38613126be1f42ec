"""What a case consists of, and what all cases share."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[Any]
T = TypeVar("T")

SEED = 7
EXTRA = "pip install 'gpureg[bench]'"
NEEDS_DATA = "set GPUREG_DATA to the folder of test data"

HOST, DEVICE = "in", "out"
"""Whether the transfers between host and device are in a row's time."""

# Operations of an exp: a product, a rounding and a difference, a polynomial of degree 5, and the power of 2 put on.
EXP = 16


def of_tests(name: str, room: str = "") -> ModuleType:
    """A module of the folder ``tests``, which is no package: under pytest it may be there already."""
    folder = Path(__file__).resolve().parents[1] / "tests"
    folders = [str(folder), str(folder / "backends"), str(folder / "gpu")]
    sys.path[:0] = folders
    try:
        found = importlib.import_module(name)
    finally:
        for each in folders:
            sys.path.remove(each)
    there = Path(found.__file__ or "").parent
    assert there == folder / room, f"{name} is {found.__file__}, not that of {folder / room}"
    return found


shared = of_tests("cases")
_primitives = of_tests("rows", "backends").ROWS

# Two correct implementations of a sweep may be so far apart, relative to the largest value: derived in tests/cases.py.
TOLERANCE: dict[str, float] = shared.TOLERANCES


def traffic(primitive: str, graph: Any, **sizes: Any) -> float:
    """Bytes that one call must move at least, each array once: tests/backends/primitives.py, for the whole graph.

    `sizes` are channels, norms, and the names of arguments that are arrays where they may be numbers.
    """
    stored = not hasattr(graph, "half_window")
    neighbours = graph.n_edges / graph.n_vertices if stored else 2 * graph.half_window
    return float(graph.n_vertices * sum(_primitives[primitive].traffic(neighbours, stored=stored, **sizes)))


@dataclass
class Setup:
    """What all cases share.

    Parameters
    ----------
    size : {"full", "quick", "tiny"}
        "quick" shows that everything runs; "tiny" is for the tests, which check and do not time.
    devices : list of str
        Names of our devices that are wanted, the one that "auto" prefers first.
    """

    size: Literal["full", "quick", "tiny"]
    devices: list[str]

    def pick(self, full: T, quick: T, tiny: T) -> T:
        """The value for this size."""
        return {"full": full, "quick": quick, "tiny": tiny}[self.size]

    def picture(self, side: int) -> tuple[Image, str]:
        """A clean picture of 0..255, (side, side) float32, and its name; drawn where scikit-image is missing."""
        skimage = peer("skimage.data")
        if skimage is None:
            y, x = np.mgrid[:side, :side].astype(np.float32) / side
            drawn = 40 + 120 * ((x - 0.5) ** 2 + (y - 0.4) ** 2 < 0.09) + 80 * (x + y > 1.2)
            return drawn.astype(np.float32), "a drawn disk and edge"
        camera = skimage.camera().astype(np.float32)
        if side <= len(camera):
            step = len(camera) // side
            return np.ascontiguousarray(camera[::step, ::step][:side, :side]), "camera"
        return np.tile(camera, (-(-side // len(camera)),) * 2)[:side, :side], "camera, tiled"

    def noisy(self, side: int) -> tuple[Image, Image, str]:
        """The clean picture and the same with noise of standard deviation 20, both float32 in 0..255, and a name."""
        clean, name = self.picture(side)
        noise = np.random.default_rng(SEED).standard_normal(clean.shape, np.float32)
        return clean, clean + 20 * noise, name

    def best_of_each(self) -> list[str]:
        """The best device of each backend."""
        best: dict[str, str] = {}
        for device in self.devices:
            best.setdefault(device.partition(":")[0], device)
        return list(best.values())


@dataclass(frozen=True)
class Bar:
    """A ratio that our least time must not pass.

    Parameters
    ----------
    over : str
        The peer, or a time that is no peer's: see `over_bytes` and `growth`.
    at_most : float
    on : str
        "best" is the device that "auto" prefers; otherwise the start of a device's name, and the best of those counts.
    transfers : {"in", "out"}
        The rows it is for.
    over_bytes : float, optional
        The time that so many bytes take at the device's measured bandwidth, in the place of a peer's.
    growth : bool
        Time per vertex over that of the same device at the case's smallest size.
    """

    over: str
    at_most: float
    on: str = "best"
    transfers: str = HOST
    over_bytes: float | None = None
    growth: bool = False


@dataclass
class Entry:
    """A row of the table: one way to do the work of a case.

    Parameters
    ----------
    who : str
        A device of ours, or a peer.
    call : callable or None
        Does the work once; None where it cannot be done, and `note` says why.
    finish : callable
        Waits until the work asked for is done.
    check : callable or None
        Gives whether the result agrees with the reference, and a sentence; called before timing.
    transfers : {"in", "out", "-"}
        Whether transfers are in the time; "-" for peers, which have none.
    bytes : float or None
        Bytes that one call must move at least, each array counted once per pass.
    operations : float or None
        Floating-point operations of one call, a multiply-add counting 2.
    is_peer : bool
        Whether our times are divided by this one's.
    note : str
    times : float
        How often the work of the case is that of one call, where it is too long to wait for.
    """

    who: str
    call: Callable[[], Any] | None
    finish: Callable[[], Any] = lambda: None
    check: Callable[[], tuple[bool, str]] | None = None
    transfers: str = "-"
    bytes: float | None = None
    operations: float | None = None
    is_peer: bool = False
    note: str = ""
    times: float = 1.0


@dataclass
class Case:
    """Rows that do the same work on data of one size.

    Parameters
    ----------
    name, work : str
        A short name, and what one call does.
    entries : list of Entry
    notes : list of str
        What a reader must know of the numbers.
    bars : list of Bar
    label : str
        The size in words. Consecutive cases of one name are one table, with a row per size.
    vertices : int
    """

    name: str
    work: str
    entries: list[Entry]
    notes: list[str] = field(default_factory=list)
    bars: list[Bar] = field(default_factory=list)
    label: str = ""
    vertices: int = 0


def peer(module: str) -> Any:
    """A peer's module, or None where it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        return None


def missing(who: str) -> Entry:
    """The row of a peer that is not installed."""
    return Entry(who, None, is_peer=True, note=f"not installed: {EXTRA}")


def skipped(who: str, why: str) -> Entry:
    """The row of work that cannot be done."""
    return Entry(who, None, note=f"skipped: {why}")


def data(*parts: str) -> Path | None:
    """A file of the test data, or None where the environment does not say where they are."""
    folder = os.environ.get("GPUREG_DATA", "").strip()
    path = Path(folder, *parts)
    return path if folder and path.exists() else None


def apart(value: Image, reference: Image, at_most: float, whom: str) -> tuple[bool, str]:
    """Whether a result agrees, by the largest difference relative to the largest reference value, and a sentence."""
    difference = float(np.abs(value - reference).max() / np.abs(reference).max())
    return difference <= at_most, f"{difference:.1e} from {whom} (at most {at_most:g})"
