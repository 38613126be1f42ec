"""Plans whose passes on groups of patches have small windows, so that halos are small beside a test's pictures."""

from __future__ import annotations

from dataclasses import replace

from gpureg.images.passes import PatchPass
from gpureg.images.plan import DenoisePlan


def with_small_passes(plan: DenoisePlan) -> DenoisePlan:
    """Return the plan with other passes, if it has any."""
    groups = tuple((channels, with_small_passes(own)) for channels, own in plan.groups)
    axes = len(plan.window)
    small = PatchPass((1,) * axes, (3 if axes == 2 else 1,) * axes, (3,) * axes, nearest=8, most=16)
    return replace(plan, passes=(small,) * len(plan.passes), groups=groups)
