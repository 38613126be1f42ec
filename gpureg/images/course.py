"""What kind of denoising is asked for: :class:`Course`."""

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
    """What kind of denoising is asked for; that decides what has to be chosen.

    Attributes
    ----------
    local : bool
        Weights that do not look at the data, with which a wide window would only blur: the paper's G_0.
    filters : bool
        Sweeps at p = 2 of weights that look at the data.
    chooses : bool
        Whether weights are chosen by a rule.
    needs_noise : bool
        Whether the noise decides anything. What decides nothing is not looked for: it takes longer than a filter.
    search : {"discrepancy", "sure", "j-invariance"} or None
        How lam is to be searched for.
    most : int or None
        Iterations at most of a solver that ends where a tolerance of its own is met; None for one that has none.
    """

    local: bool
    filters: bool
    chooses: bool
    needs_noise: bool
    search: LamMethod | None
    most: int | None

    @classmethod
    def of(cls, asked: Choice, weights: Weights | npt.ArrayLike | None) -> Course:
        """The course for these weights, None where they are to be chosen.

        Raises
        ------
        TypeError, ValueError
            No solver, a search that does not know what else is asked for.
        """
        method = resolve(asked["solver"])
        search = cast("LamMethod", asked["lam"]) if isinstance(asked["lam"], str) else None
        if search is not None and (asked["guide"] is not None or asked["norm"] != "vertex"):
            raise ValueError(
                f"the search lam={search!r} looks at the vertex norm and weights without a guide: give lam a number"
            )
        plain = asked["p"] in (None, 2)
        by_rule = asked["lam"] is None or search is not None
        local = isinstance(weights, Constant) or (weights is None and not plain and asked["k"] is None)
        filters = not local and plain
        chooses = weights is None and (by_rule or not local)
        needs_noise = chooses or (by_rule and not filters) or search is not None
        return cls(local, filters, chooses, needs_noise, search, method.most if isinstance(method, Certified) else None)
