"""Recorded launches of Warp kernels: commands with their arguments, launched again and again.

On a CUDA device several launches become a graph, one launch for the driver, once they are repeated with the same
numbers: those are part of a graph.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from ..recorded import places
from .pool import launch_all


class Record:
    """Launches in their order, each as the commands of its pieces.

    Parameters
    ----------
    device : warp.Device
    """

    def __init__(self, device: Any) -> None:
        self._device = device
        # Whether the driver takes graphs; the graph of the last numbers, if there is one.
        self._graphs = bool(device.is_cuda)
        self._graph: Any = None
        self._numbers: tuple[float, ...] | None = None
        self._launches: list[list[Any]] = []
        # (command, place of the argument, place of the parameter)
        self._varying: list[tuple[Any, int, int]] = []
        # A command does not keep its arrays.
        self._args: list[list[Any]] = []

    def add(self, commands: list[Any], args: list[Any]) -> None:
        """Add a launch."""
        self._launches.append(commands)
        self._args.append(args)
        self._varying += [(command, at, number) for at, number in places(args) for command in commands]

    def replay(self, *numbers: float) -> None:
        """Launch all, with these numbers as the parameters."""
        again = numbers == self._numbers
        if again and self._graph is not None:
            wp.capture_launch(self._graph)
            return
        for command, at, number in self._varying:
            command.set_param_at_index(at, numbers[number])
        self._graph, self._numbers = None, numbers
        if again and self._graphs and len(self._launches) > 1:
            self._graph = self._captured()
        if self._graph is not None:
            wp.capture_launch(self._graph)
            return
        self._launch()

    def _launch(self) -> None:
        for commands in self._launches:
            launch_all(commands)

    def _captured(self) -> Any:
        """Return a graph of all launches, or None where the driver cannot make one."""
        try:
            with wp.ScopedCapture(device=self._device, force_module_load=False) as capture:
                self._launch()
        except Exception:  # Warp raises errors of several types; the launches themselves still work
            self._graphs = False
            return None
        return capture.graph
