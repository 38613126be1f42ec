"""Draw results: :mod:`gpureg.plot`. Needs Matplotlib (extra ``plot``), which is imported when a figure is drawn."""

from .clouds import points
from .comparison import compare, quality
from .energies import energy
from .neighbourhood import neighbours
from .partitions import simplification
from .polygons import curves, skeleton
from .surfaces import meshes

__all__ = ["compare", "curves", "energy", "meshes", "neighbours", "points", "quality", "simplification", "skeleton"]
