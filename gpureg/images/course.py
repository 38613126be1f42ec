"""The kind of denoising: :class:`Course`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy.typing as npt

from ..solvers import Certified, resolve
from ..tuning.fidelity import LamMethod
from ..weights import Constant, Weights
from .options import Choice


@dataclass(frozen=True)
class Course:
    """The kind of denoising, which determines the parameters that have to be chosen.

    Attributes
    ----------
    local : bool
        Whether the weights do not depend on the data. A wide window would only blur: the graph is the paper's G_0.
    filters : bool
        Whether it is a filter: sweeps at p = 2 with weights that depend on the data.
    chooses : bool
        Whether the weights are chosen by a rule.
    needs_noise : bool
        Whether a parameter depends on the noise. If not, the noise is not estimated: that takes longer than a filter.
    search : {"discrepancy", "sure", "j-invariance"} or None
        Method of the search for lam.
    most : int or None
        Maximum number of iterations of a solver with a default tolerance; None for other solvers.
    """

    local: bool
    filters: bool
    chooses: bool
    needs_noise: bool
    search: LamMethod | None
    most: int | None

    @classmethod
    def of(cls, asked: Choice, weights: Weights | npt.ArrayLike | None) -> Course:
        """Return the course for given weights, None if they have to be chosen.

        Raises
        ------
        TypeError, ValueError
            An unknown solver, or a search for lam with an option that it does not support.
        """
        method = resolve(asked["solver"])
        search = cast("LamMethod", asked["lam"]) if isinstance(asked["lam"], str) else None
        if search is not None and (asked["guide"] is not None or asked["norm"] != "vertex"):
            raise ValueError(
                f"the search lam={search!r} needs norm='vertex' and weights without a guide: give lam a number"
            )
        plain = asked["p"] in (None, 2)
        by_rule = asked["lam"] is None or search is not None
        local = isinstance(weights, Constant) or (weights is None and not plain and asked["k"] is None)
        filters = not local and plain
        chooses = weights is None and (by_rule or not local)
        passes = asked["passes"] is not None and asked["passes"] > 1
        needs_noise = chooses or (by_rule and not filters) or search is not None or passes
        return cls(local, filters, chooses, needs_noise, search, method.most if isinstance(method, Certified) else None)
