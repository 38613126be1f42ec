"""Launches of Warp kernels on the CPU, spread over a pool of threads."""

from __future__ import annotations

import contextlib
import functools
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import warp as wp

# On the CPU: bytes of a pack of neighbouring cells, how much faster an edge is in packs, and vertices in a run.
PACK_BYTES, PACK_SPEED, RUN = 64, 4, 256
# Pieces per thread, so that a thread that is held up leaves the rest to the others; and the least work of a piece, in
# edges and vertices: a tenth of a millisecond or more, a few times what it costs to hand a piece over.
PIECES, LEAST_WORK = 4, 1 << 17


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Warp without its greeting and its lines on modules; its warnings stay."""
    level = wp.config.log_level
    if level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_WARNING
    try:
        yield
    finally:
        wp.config.log_level = level


_compiling = threading.RLock()


@functools.cache
def compiled(alias: str, make: Callable[..., Any], *options: Any) -> Any:
    """The kernel that `make` gives for these options, compiled and loaded."""
    with _compiling, quiet():
        kernel = make(*options)
        wp.load_module(kernel.module, alias)
        return kernel


def cores() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # a system without it
        return os.cpu_count() or 1


class _Pool:
    """The threads that help the one that launches; made when they are first needed, in a forked child anew."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._threads: ThreadPoolExecutor | None = None
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._forget)

    def _forget(self) -> None:
        self._lock, self._threads = threading.Lock(), None

    def run(self, commands: list[Any]) -> None:
        """Launch all commands, here and on the other threads, and wait for them."""

        def work() -> None:
            with contextlib.suppress(IndexError):
                while True:
                    waiting.popleft().launch()

        waiting = deque(commands)
        with self._lock:
            if self._threads is None:
                self._threads = ThreadPoolExecutor(max(cores() - 1, 1), thread_name_prefix="gpureg-warp")
        helpers = min(cores(), len(commands)) - 1
        futures = []
        with contextlib.suppress(RuntimeError):  # no new threads while Python exits: all is done here
            futures = [self._threads.submit(work) for _ in range(helpers)]
        try:
            work()
        finally:
            # after an interrupt too: nothing is written once this returns
            waiting.clear()
            wait(futures)
        for future in futures:
            future.result()


_pool = _Pool()


def launch_all(commands: list[Any]) -> None:
    """Launch the commands that a launch was cut into."""
    if len(commands) == 1:
        commands[0].launch()
    else:
        _pool.run(commands)
