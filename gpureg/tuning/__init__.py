"""Choice of parameters from the noisy data alone.

The discrepancy principle finds lam on any graph. SURE and J-invariance estimate the error of any denoiser, and
:func:`calibrate` uses them to find the best of many parameters. :func:`nl_means_parameters` is a published table.
"""

from __future__ import annotations

from .calibration import Calibration, Trial, calibrate
from .nl_means import NlMeansParameters, nl_means_parameters
from .principle import Discrepancy, discrepancy
from .risk import j_invariance, sure

__all__ = [
    "Calibration",
    "Discrepancy",
    "NlMeansParameters",
    "Trial",
    "calibrate",
    "discrepancy",
    "j_invariance",
    "nl_means_parameters",
    "sure",
]
