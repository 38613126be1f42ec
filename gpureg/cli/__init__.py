"""The command line: a file for each command of ``gpureg``."""

from .backends import list_backends
from .curve import curve
from .demo import demo
from .denoise import denoise
from .figures import figures
from .group import main
from .mesh import mesh
from .points import points
from .simplify import simplify

__all__ = ["curve", "demo", "denoise", "figures", "list_backends", "main", "mesh", "points", "simplify"]

for command in (denoise, simplify, mesh, curve, points, demo, figures, list_backends):
    main.add_command(command)
