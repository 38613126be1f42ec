"""The command line: a file for each command of ``gpureg``."""

from .commands import main

__all__ = ["main"]
