"""Do the tiles of a job: on one device or several at a time, and in halves where memory runs out."""

from __future__ import annotations

import contextvars
import gc
import itertools
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Generic, TypeVar

import numpy as np

from ..backends import Backend
from ..doors import warn
from ..model.memory import Budget, Need, readable
from .tiling import Tile, Tiling

R = TypeVar("R")

Work = Callable[[Backend, Tile], R]
"""Computes a tile on a device, and stores its interior. All memory on the device is free when it has returned."""


class Shared(Generic[R]):
    """A job on tiles, which several devices take from one queue.

    If memory runs out, the tile is done in halves, on whatever device is next; other tiles of its size are halved
    before they are tried. Tiles are exact, so that the values are the same.

    Parameters
    ----------
    devices : sequence of Backend
        With one of them all work is done in the calling thread, otherwise in a thread for each.
    tiling : Tiling
    need : callable
        Returns the memory that a tile needs.
    """

    def __init__(self, devices: Sequence[Backend], tiling: Tiling, need: Callable[[Tile], Need]) -> None:
        self.devices = tuple(devices)
        self.tiles = tiling.tiles
        self._tiling, self._need = tiling, need
        self._lock = threading.Lock()
        # how often memory ran out, and the devices on which it did
        self.halved = int(bool(tiling.full))
        self._full = dict.fromkeys([tiling.full] if tiling.full else [])

    def run(self, work: Work[R], report: Callable[[int, int], None] | None = None) -> list[R]:
        """Do all tiles, and return what `work` returned, in any order.

        `report` is called with the numbers of tiles done and of all tiles. After an interruption, the tiles that have
        begun are finished first.

        Raises
        ------
        MemoryError
            Memory has run out for a tile that is not much larger than its halo; the message says what it needed.
        """
        waiting = deque(self.tiles)
        results: list[R] = []
        done: list[Tile] = []

        def go_on(device: Backend) -> None:
            while True:
                with self._lock:
                    if not waiting:
                        return
                    tile = waiting.popleft()
                found, said = _attempt(work, device, tile)
                if said:
                    device.release()
                    with self._lock:
                        self._halve(waiting, tile, device, said)
                    continue
                with self._lock:
                    results.extend(found)
                    done.append(tile)
                    if report is not None:
                        report(len(done), len(done) + len(waiting))

        if len(self.devices) == 1:
            go_on(self.devices[0])
        else:
            self._in_threads(go_on, waiting)
        # the next round of sweeps begins with tiles that fit
        self.tiles = tuple(done)
        return results

    def _in_threads(self, go_on: Callable[[Backend], None], waiting: deque[Tile]) -> None:
        def guarded(device: Backend) -> None:
            try:
                with np.errstate(over="ignore", invalid="ignore"):
                    go_on(device)
            except BaseException:
                waiting.clear()  # the others stop
                raise

        with ThreadPoolExecutor(len(self.devices), thread_name_prefix="gpureg-tiles") as threads:
            # a copy for each thread: a context is entered by one thread at a time
            running = [threads.submit(contextvars.copy_context().run, guarded, device) for device in self.devices]
            try:
                wait(running)
            except BaseException:  # an interruption
                waiting.clear()
                raise
        for each in running:
            each.result()

    def _halve(self, waiting: deque[Tile], tile: Tile, device: Backend, said: str) -> None:
        """Put the halves of a tile first in the queue, and halve what is as large."""
        self.halved += 1
        self._full[device.device.id] = None
        halves = self._tiling.halves(tile)
        if not halves:
            need, shape = self._need(tile), " x ".join(map(str, tile.shape))
            raise MemoryError(
                f"the job needs {readable(need.total)} on {device.device.id} for a part of {shape} cells, "
                f"{readable(need.largest)} of them in one array; {readable(device.free_memory)} of "
                f"{readable(device.device.memory)} are free ({said}). End other programs that use the device, use a "
                "smaller window, fewer iterations or dtype float32, or another backend such as 'numpy'"
            )
        rest = [self._tiling.halves(other) or (other,) if other.size >= tile.size else (other,) for other in waiting]
        waiting.clear()
        waiting.extend([*halves, *itertools.chain.from_iterable(rest)])

    @property
    def told(self) -> str:
        """How often tiles were halved, as a clause that begins with a comma; empty if they were not."""
        if not self.halved:
            return ""
        times = "once" if self.halved == 1 else f"{self.halved} times"
        return f", halved {times} as the memory of {' and '.join(self._full)} ran out"

    def warn(self) -> None:
        """Warn if memory has run out.

        Warns
        -----
        UserWarning
        """
        if self.halved:
            warn(
                f"the memory of {' and '.join(self._full)} ran out: parts of the job were done again in halves, "
                f"{self.halved} time(s). The result is the same; memory=... or GPUREG_MEMORY saves the time"
            )

    @property
    def names(self) -> str:
        """Describe the devices for the result, with a note if not all of them round in the same way."""
        return described(self.devices)


def shares(count: int, need: Need, allowed: Budget, cut: Callable[[Budget], Tiling]) -> Tiling | None:
    """Cut a job for several devices, into two tiles for each, or one; None if its halos cost all the gain.

    `need` is that of the whole job; `cut` chooses tiles within a budget.
    """
    for tiles in (2 * count, count):
        limit = min(allowed.total, need.total // tiles)
        try:
            found = cut(Budget(limit, min(allowed.largest, limit), allowed.asked))
        except MemoryError:  # tiles of one row are larger
            continue
        if found.waste < count:
            return found
    return None


def described(devices: Sequence[Backend]) -> str:
    """Describe devices for a result, with a note if their bits may differ."""
    counts: dict[str, int] = {}
    for device in devices:
        counts[repr(device)] = counts.get(repr(device), 0) + 1
    named = " and ".join(name if n == 1 else f"{n} times {name}" for name, n in counts.items())
    kinds = {(one.device.backend, one.device.name, one.device.driver, one.device.vector_width) for one in devices}
    note = "; devices of several kinds may round differently, and which one computed a part is not known"
    return named + (note if len(kinds) > 1 else "")


def _attempt(work: Work[R], device: Backend, tile: Tile) -> tuple[list[R], str]:
    """Return the result of work on a tile, or what was said when memory ran out."""
    try:
        return [work(device, tile)], ""
    except MemoryError as error:
        said = str(error) or type(error).__name__
    # only now has the error with its frames let go of the arrays; circles of them are found by the collector
    gc.collect()
    return [], said
