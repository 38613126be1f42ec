"""The command line: ``gpureg denoise``, ``simplify``, ``mesh``, ``points``, ``demo``, ``backends``; a file for each."""

from .backends import list_backends
from .demo import demo
from .denoise import denoise
from .group import main
from .mesh import mesh
from .points import points
from .simplify import simplify

__all__ = ["demo", "denoise", "list_backends", "main", "mesh", "points", "simplify"]

for command in (denoise, simplify, mesh, points, demo, list_backends):
    main.add_command(command)
