"""What turns out when a device is used: it cannot build a kernel, or its memory ends; "auto" leaves the first out.

A failed build raises a :class:`BuildFailed`. If "auto" had chosen the device, the public function that the user called
runs again (``doors.py``), and "auto" then takes the next device.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from ..doors import warn
from .types import BackendUnavailable, Device

# Lines of a compiler's log in a message, and letters of a line.
_LINES, _WIDTH = 3, 200

_lock = threading.Lock()
# Devices with a type to compute in: why they cannot build kernels; those that "auto" has chosen; those told of.
_failed: dict[tuple[str, str], str] = {}
_chosen: set[tuple[str, str]] = set()
_told: set[tuple[str, str]] = set()


class BuildFailed(BackendUnavailable):
    """A device cannot build a kernel.

    Parameters
    ----------
    message : str
    again : tuple of str, optional
        The device and the type, if "auto" has chosen them: the public function that was called can run once again, as
        "auto" takes another device now.
    """

    # pickle passes the message alone
    def __init__(self, message: str, again: tuple[str, str] | None = None) -> None:
        super().__init__(message)
        self.again = again


def build_failed(device: Device, dtype: npt.DTypeLike, kernel: str, log: str) -> BuildFailed:
    """Note that a device cannot build a kernel, and return the error to raise; `log` is what the compiler said."""
    key, why = _key(device, dtype), f"it cannot build the kernel {kernel}: {first_lines(log)}"
    with _lock:
        # also if another thread has told of the device: this call has chosen it before
        again = key if key in _chosen else None
        _failed.setdefault(key, why)
    others = "use another backend (gpureg backends lists them), or a newer driver"
    return BuildFailed(f"{device.id} ({device.name}, {device.driver}): {why}. {others[0].upper()}{others[1:]}", again)


def why_not(device: Device, dtype: npt.DTypeLike) -> str | None:
    """Return why "auto" leaves out a device that has failed, as a clause; None if it has not."""
    return _failed.get(_key(device, dtype))


def chosen(device: Device, dtype: npt.DTypeLike, better: Iterable[Device]) -> None:
    """Note that "auto" has chosen a device, and warn once of each of the `better` ones that have failed.

    Warns
    -----
    UserWarning
    """
    with _lock:
        _chosen.add(_key(device, dtype))
        new = [one for one in better if _key(one, dtype) in _failed and _key(one, dtype) not in _told]
        _told.update(_key(one, dtype) for one in new)
    for one in new:
        warn(f"backend 'auto' goes on with {device.id}, and leaves out {one.id} ({one.name}): {why_not(one, dtype)}")


def first_lines(log: str) -> str:
    """Return the first lines of a compiler's log that say what is wrong."""
    lines = [line.strip()[:_WIDTH] for line in log.splitlines()]
    lines = [line for line in lines if line and not line.startswith("Build on <")]
    # the line of the library says no more than that the build failed
    after = lines[1:] if len(lines) > 1 and "BUILD_PROGRAM_FAILURE" in lines[0] else lines
    first = next((i for i, line in enumerate(after) if "error" in line.lower()), 0)
    return "; ".join(after[first : first + _LINES]) or "the compiler says nothing"


class OutOfMemory(MemoryError):
    """The memory of a device has ended, which other programs use as well; other MemoryErrors tell of limits."""


def out_of_memory(device: Any, said: str) -> OutOfMemory:
    """Return the error for a device whose memory has ended; `device` is a name, `said` what its library says."""
    return OutOfMemory(
        f"the memory of {device} has run out ({said}): use smaller data or a smaller window, dtype float32, "
        "or backend='numpy'"
    )


def _key(device: Device, dtype: npt.DTypeLike) -> tuple[str, str]:
    return device.id, np.dtype(dtype).name
