"""Recorded launches of Warp kernels: commands with their arguments, launched again and again."""

from __future__ import annotations

from typing import Any

from ..recorded import places
from .pool import launch_all


class Record:
    """Launches in their order, each as the commands of its pieces."""

    def __init__(self) -> None:
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
        for command, at, number in self._varying:
            command.set_param_at_index(at, numbers[number])
        for commands in self._launches:
            launch_all(commands)
