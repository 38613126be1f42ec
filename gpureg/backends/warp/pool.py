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

# On the CPU: bytes of a pack of neighbouring cells, the speed-up per edge by packs, and vertices in a run.
PACK_BYTES, PACK_SPEED, RUN = 64, 4, 256
# Pieces per thread, so that other threads take over from a slow one; and the smallest work of a piece, in edges and
# vertices: 0.1 ms or more, a few times the cost to pass a piece to a thread.
PIECES, LEAST_WORK = 4, 1 << 17


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Silence the messages of Warp on start and on modules, but not its warnings."""
    level = wp.config.log_level
    if level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_WARNING
    try:
        yield
    finally:
        wp.config.log_level = level


class CompileError(Exception):
    """A kernel that Warp cannot compile: its name, and what the compiler said."""

    def __init__(self, kernel: str, log: str) -> None:
        super().__init__(log)
        self.kernel = kernel


_compiling = threading.RLock()


@functools.cache
def compiled(alias: str, make: Callable[..., Any], *options: Any) -> Any:
    """Return the kernel that `make` makes for these options, compiled and loaded; cached."""
    with _compiling, quiet():
        kernel = make(*options)
        try:
            wp.load_module(kernel.module, alias, block_dim=getattr(kernel, "threads", None))
        except MemoryError:
            raise
        except Exception as error:  # Warp raises many kinds: of its own, of the compiler, of the system
            raise CompileError(make.__module__.rpartition(".")[2], f"{type(error).__name__}: {error}") from error
        return kernel


def cores() -> int:
    """Return the number of cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


class _Pool:
    """Threads that help the launching thread; made at first use, and made again in a forked child."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._threads: ThreadPoolExecutor | None = None
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._forget)

    def _forget(self) -> None:
        self._lock, self._threads = threading.Lock(), None

    def run(self, commands: list[Any]) -> None:
        """Launch all commands, on this thread and the others, and wait for them."""

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
        with contextlib.suppress(RuntimeError):  # no new threads while Python exits: this thread does all
            futures = [self._threads.submit(work) for _ in range(helpers)]
        try:
            work()
        finally:
            # also after an interrupt, nothing is written after the return
            waiting.clear()
            wait(futures)
        for future in futures:
            future.result()


_pool = _Pool()


def launch_all(commands: list[Any]) -> None:
    """Launch the pieces of a launch; those of a GPU are bands, in their order."""
    if len(commands) == 1 or not commands[0].device.is_cpu:
        for command in commands:
            command.launch()
    else:
        _pool.run(commands)
