"""Pictures of results: :mod:`gpureg.plot`. Matplotlib draws them (extra ``plot``), imported when the first is drawn."""

from .comparison import compare, quality
from .curves import curves, skeleton
from .energies import energy
from .meshes import meshes
from .neighbourhood import neighbours
from .points import points
from .simplification import simplification

__all__ = ["compare", "curves", "energy", "meshes", "neighbours", "points", "quality", "simplification", "skeleton"]
