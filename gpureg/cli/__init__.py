"""The command line: ``gpureg denoise``, ``simplify``, ``demo``, ``backends``; a file for each."""

from .backends import list_backends
from .demo import demo
from .denoise import denoise
from .group import main
from .simplify import simplify

__all__ = ["demo", "denoise", "list_backends", "main", "simplify"]

for command in (denoise, simplify, demo, list_backends):
    main.add_command(command)
