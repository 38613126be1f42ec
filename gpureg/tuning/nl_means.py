"""Parameters of nonlocal means published by IPOL: :func:`nl_means_parameters`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..checks import flag, number
from ..doors import door
from ..weights import Weights, patch

# largest sigma of the row, for a range of 255; radius of the patch; radius of the window; h as a multiple of sigma
_GREY = ((15, 1, 10, 0.40), (30, 2, 10, 0.40), (45, 3, 17, 0.35), (75, 4, 17, 0.35), (100, 5, 17, 0.30))
_COLOUR = ((25, 1, 10, 0.55), (55, 2, 17, 0.40), (100, 3, 17, 0.35))


@dataclass(frozen=True)
class NlMeansParameters:
    """Parameters of nonlocal means.

    Attributes
    ----------
    patch_radius : int
        Radius of the flat patch.
    radius : int
        Radius of the square window.
    h : float
        Filtering parameter of :func:`gpureg.weights.patch`: in the data's units times the square root of the number of
        samples in a patch, over all channels.
    sigma : float
        Standard deviation of the noise, in the data's units.
    """

    patch_radius: int
    radius: int
    h: float
    sigma: float

    @property
    def weights(self) -> Weights:
        """The weights with these parameters."""
        return patch(self.patch_radius, self.h, sigma=self.sigma)


@door
def nl_means_parameters(sigma: float, *, color: bool = False, data_range: float = 255.0) -> NlMeansParameters:
    """Return patch, window and h of nonlocal means for a noise level, from IPOL's table.

    Parameters
    ----------
    sigma : float
        Standard deviation of the noise in the data's units, up to 100/255 of `data_range`.
    color : bool, default False
        Whether the image has three channels.
    data_range : float, default 255
        Range from black to white in the data's units; the table is for 0..255.

    Raises
    ------
    TypeError, ValueError
        A sigma that is not > 0 or above the table, a data_range that is not > 0.

    Notes
    -----
    The table is from Buades, Coll, Morel, Non-Local Means Denoising, Image Processing On Line 1 (2011),
    doi:10.5201/ipol.2011.bcm_nlm. Ranges include their upper end, as in the program of the article:

    ===== ============ ======= ========= ==========
    image sigma        patch   window    h / sigma
    ===== ============ ======= ========= ==========
    grey  0 < s <= 15  3 x 3   21 x 21   0.40
    grey  .. 30        5 x 5   21 x 21   0.40
    grey  .. 45        7 x 7   35 x 35   0.35
    grey  .. 75        9 x 9   35 x 35   0.35
    grey  .. 100       11 x 11 35 x 35   0.30
    color 0 < s <= 25  3 x 3   21 x 21   0.55
    color .. 55        5 x 5   35 x 35   0.40
    color .. 100       7 x 7   35 x 35   0.35
    ===== ============ ======= ========= ==========

    IPOL's weight is exp(-max(d^2 - 2 sigma^2, 0) / h^2), where d^2 is the mean over the N samples of a patch in all
    channels. gpureg uses the sum, so that `h` here is IPOL's h times sqrt(N). In IPOL's method the centre pixel has the
    largest weight of its neighbours, and all estimates of a pixel by patches that cover it are averaged.

    Examples
    --------
    >>> nl_means_parameters(20)
    NlMeansParameters(patch_radius=2, radius=10, h=40.0, sigma=20.0)
    >>> nl_means_parameters(20 / 255, color=True, data_range=1).radius
    10
    """
    number("sigma", sigma, above=0)
    number("data_range", data_range, above=0)
    color = flag("color", color)
    level = 255 * float(sigma) / float(data_range)
    for most, patch_radius, radius, factor in _COLOUR if color else _GREY:
        if level <= most * (1 + 1e-9):
            samples = (3 if color else 1) * (2 * patch_radius + 1) ** 2
            return NlMeansParameters(patch_radius, radius, factor * float(sigma) * math.sqrt(samples), float(sigma))
    raise ValueError(
        f"sigma = {sigma:g} is {level:.4g} of 255, but the table ends at 100: see data_range = {data_range:g}, or use "
        "gpureg.denoise_image, which has no limit"
    )
