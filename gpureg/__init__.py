"""Denoise, simplify and cluster discrete data by p-Laplacian regularization on weighted graphs."""

from __future__ import annotations

import lazy_loader

from ._version import __version__ as __version__

# A name is loaded when it is first used: `__init__.pyi` says where each lives. `import gpureg` itself loads no numpy.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
