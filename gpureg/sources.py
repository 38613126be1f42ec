"""Sources of the energy partition (section 5.2): the places that :func:`gpureg.simplify_image` grows zones from."""

from __future__ import annotations

from .regions.sources import extrema, gradient_minima, seeds

__all__ = ["extrema", "gradient_minima", "seeds"]
