"""Pictures of results: :mod:`gpureg.plot`. Matplotlib draws them (extra ``plot``), imported when the first is drawn."""

from .clouds import points
from .comparison import compare, quality
from .energies import energy
from .neighbourhood import neighbours
from .partitions import simplification
from .polygons import curves, skeleton
from .surfaces import meshes

__all__ = ["compare", "curves", "energy", "meshes", "neighbours", "points", "quality", "simplification", "skeleton"]
