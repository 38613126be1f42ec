"""The command line, with one file for each command of ``gpureg``."""

from .commands import main

__all__ = ["main"]
