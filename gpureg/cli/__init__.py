"""The command line: ``gpureg denoise``, ``gpureg demo``, ``gpureg backends``; a file for each."""

from .backends import list_backends
from .demo import demo
from .denoise import denoise
from .group import main

__all__ = ["demo", "denoise", "list_backends", "main"]

for command in (denoise, demo, list_backends):
    main.add_command(command)
