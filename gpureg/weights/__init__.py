"""Weight functions w(u, v): the similarity of two vertices (section 5.2 and figures 5 to 8 of the paper).

A weight function is an object that computes weights for a graph and data on the device of a backend. Functions of the
form s(u, v) exp(-patch distance) derive from :class:`PatchWeights` and are computed there. Others derive from
:class:`EdgeWeights` and are computed in numpy. A new one needs a class, a function below it, a name here, and a row in
``tests/weights/test_weights.py``.
"""

from .base import EdgeWeights, PatchWeights, PerVertex, Weights
from .distance import Constant, constant, gaussian, inverse_distance
from .guide import OPPONENT, Compared, Guided, Smoothed, blur_norm, guided, patch_weights, smoothed
from .scaled import scaled_by
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
    "scaled_by",
    "smoothed",
]
