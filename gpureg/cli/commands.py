"""The group of all commands of ``gpureg``."""

from __future__ import annotations

from .backends import list_backends
from .curve import curve
from .demo import demo
from .denoise import denoise
from .figures import figures
from .group import main
from .mesh import mesh
from .noise import noise
from .points import points
from .simplify import simplify

__all__ = ["COMMANDS", "main"]

COMMANDS = (denoise, noise, simplify, mesh, curve, points, demo, figures, list_backends)

for command in COMMANDS:
    main.add_command(command)
