"""Plans of one sweep at p = 2 with patch weights, which need not be stored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np

from ..regularization.one_sweep import OneStep
from ..solvers import Jacobi, Solver, resolve
from ..weights import patch_weights
from .plan import DenoisePlan


def process_of(plan: DenoisePlan, solver: str | Solver) -> str | Solver:
    """Return the solver, without damping if the pixel itself has weight 0: a single sweep cannot oscillate."""
    method = resolve(solver)
    bare = plan.centre == "none" and isinstance(method, Jacobi) and method.damping is None
    return replace(cast("Jacobi", method), damping=1) if bare else solver


def step_of(plan: DenoisePlan) -> OneStep:
    """Return the options of the plan's single sweep."""
    found = patch_weights(plan.weights)
    assert found is not None
    averaged = found[0].reach if plan.average_radius is None else plan.average_radius
    by_weight = plan.average_patches == "weighted"
    return OneStep(plan.centre == "largest", averaged if plan.average_patches else None, by_weight)


def fits_one_sweep(plan: DenoisePlan, options: Mapping[str, Any]) -> bool:
    """Return whether :func:`one_sweep` can run the plan with these options (`coupled` has no effect at p = 2)."""
    gamma = options.get("gamma", "sqrt")
    by_name = isinstance(gamma, str) and gamma == "sqrt"
    plain = by_name and options.get("norm", "vertex") == "vertex" and options.get("update_weights") is None
    once = is_one_sweep(plan, options.get("solver", "jacobi"))
    return options.get("callback") is None and plain and plan.k is None and once


def is_one_sweep(plan: DenoisePlan, solver: str | Solver) -> bool:
    """Return whether :func:`one_sweep` can run the plan: one undamped sweep at p = 2 with patch weights."""
    method = resolve(solver)
    whole = isinstance(method, Jacobi) and method.damping in (None, 1)
    # the default solver may be damped where lam = 0
    filters = bool(plan.average_patches) or plan.centre == "largest"
    data = isinstance(method, Jacobi) and (method.damping == 1 or filters or bool(np.min(plan.lam) > 0))
    once = plan.p == 2 and plan.max_iter == 1 and plan.tol is None
    return once and whole and data and patch_weights(plan.weights) is not None
