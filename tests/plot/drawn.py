"""A picture for the tests of plots, and what was drawn."""

from __future__ import annotations

import numpy as np
import pytest
from cases import rng

pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")
pytest.importorskip("skimage", reason="scikit-image, of the extra 'plot', is not installed")


def picture(shape, seed=7):
    """Values in 0..1 with some structure, and the same with noise."""
    clean = sum(np.sin(x) for x in np.meshgrid(*(np.linspace(0, 5, s) for s in shape), indexing="ij")) / 8 + 0.5
    return clean, clean + 0.1 * rng(seed).standard_normal(shape)
