"""Launches cut into bands of about 50 ms, for devices on which the system ends a launch that takes seconds.

Such a device draws the screen, which stands still during a launch (``Device.watched``).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Hashable

# Kernels of both languages that find their cells by the numbers of their work items: they may run on a part of all.
BY_ROWS = frozenset(
    "aggregate dual_step euler_step gradient_norm jacobi_step p_laplacian patch_distance primal similarity_step".split()
)

# Seconds of a band, and seconds of a launch from which its speed is known, which are not worth a cut.
_LONG, _SHORT = 0.05, 0.01

# Work items of the first band of a kernel that was never timed, and by how much the next one may be larger.
_FIRST, _GROWTH = 1 << 14, 4


class Bands:
    """The speeds of kernels on a device, from launches that were timed.

    Parameters
    ----------
    clock : callable
        Returns seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._speeds: dict[Hashable, float] = {}  # work items per second
        self._lock = threading.Lock()

    def known(self, kernel: Hashable, count: int, items: int) -> list[tuple[int, int]]:
        """Return where to cut `count` units of `items` work items each, without timing: not at all if it is not known.

        The pairs are the first unit of a band and the one after its last.
        """
        speed = self._speeds.get(kernel)
        band = count if speed is None or count * items <= speed * _SHORT else self._units(speed, _LONG, items)
        return [(first, min(first + band, count)) for first in range(0, count, max(band, 1))]

    def run(
        self,
        kernel: Hashable,
        count: int,
        items: int,
        launch: Callable[[int, int], None],
        finish: Callable[[], None],
    ) -> None:
        """Call ``launch(first, last)`` for bands of `count` units of `items` work items each.

        The first bands of a launch that may be long are timed: `finish` waits for the device. The same kernel may have
        more work for an item than the last time.
        """
        speed = self._speeds.get(kernel)
        if speed is not None and count * items <= speed * _SHORT:
            launch(0, count)
            return
        done, seconds = 0, 0.0
        band = max(1, _FIRST // items) if speed is None else self._units(speed, _SHORT, items)
        finish()  # only the band is timed
        while done < count and seconds < _SHORT:
            last = min(done + band, count)
            begin = self._clock()
            launch(done, last)
            finish()
            seconds = max(self._clock() - begin, 1e-9)
            speed = (last - done) * items / seconds
            done, band = last, min(band * _GROWTH, self._units(speed, _LONG, items))
        assert speed is not None
        with self._lock:
            self._speeds[kernel] = speed
        for first in range(done, count, band):
            launch(first, min(first + band, count))

    @staticmethod
    def _units(speed: float, seconds: float, items: int) -> int:
        """Return the units of a band of so many seconds."""
        return max(1, int(speed * seconds / items))
