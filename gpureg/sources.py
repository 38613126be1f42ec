"""Sources of the energy partition (section 5.2): the places where the zones of :func:`gpureg.simplify_image` start."""

from __future__ import annotations

from .regions.sources import extrema, gradient_minima, seeds

__all__ = ["extrema", "gradient_minima", "seeds"]
