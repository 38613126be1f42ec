"""Weight functions w(u, v): how alike two vertices are (section 5.2 and figures 5 to 8 of the paper).

A weight function is an object that, given a backend, a graph and the data, puts weights on the device. Those of the
form s(u, v) exp(-patch distance) derive from :class:`PatchWeights` and are computed there; any other derives from
:class:`EdgeWeights` and says in numpy what the weight between arrays of vertices is. To add one: a class, a function
below it, a name here, and a row in ``tests/weights/test_weights.py``.
"""

from .base import EdgeWeights, PatchWeights, PerVertex, Weights
from .distance import Constant, constant, gaussian, inverse_distance
from .guide import OPPONENT, Compared, Guided, Smoothed, blur_norm, guided, patch_weights, smoothed
from .similarity import Bilateral, Patch, bilateral, half, patch, recomputed
from .triangles import Cotangent, cotangent

__all__ = [
    "OPPONENT",
    "Bilateral",
    "Compared",
    "Constant",
    "Cotangent",
    "EdgeWeights",
    "Guided",
    "Patch",
    "PatchWeights",
    "PerVertex",
    "Smoothed",
    "Weights",
    "bilateral",
    "blur_norm",
    "constant",
    "cotangent",
    "gaussian",
    "guided",
    "half",
    "inverse_distance",
    "patch",
    "patch_weights",
    "recomputed",
    "smoothed",
]
