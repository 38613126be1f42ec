"""Denoise, simplify and cluster discrete data by p-Laplacian regularization on weighted graphs."""

from __future__ import annotations

from . import operators, weights
from .backends import BackendUnavailable
from .graph import Graph, GridGraph
from .image import denoise_image, run_plan
from .noise import estimate_noise
from .plan import DenoisePlan, plan_denoising
from .regularization import regularize
from .result import Interrupted, Result, Stop
from .solvers import Check, Jacobi

__version__ = "0.1.0"

__all__ = [
    "BackendUnavailable",
    "Check",
    "DenoisePlan",
    "Graph",
    "GridGraph",
    "Interrupted",
    "Jacobi",
    "Result",
    "Stop",
    "__version__",
    "denoise_image",
    "estimate_noise",
    "operators",
    "plan_denoising",
    "regularize",
    "run_plan",
    "weights",
]
