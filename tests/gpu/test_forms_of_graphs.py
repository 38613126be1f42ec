"""The forms of stored graphs on a GPU that no door of these tests comes to: rows of hubs, for other GPUs."""

from __future__ import annotations

import gpu_compilers
import pytest
from tools import need

FORMS = {
    "slices": ["-DSLICED"],
    "pieces": ["-DTEAM=8", "-DGROUP=64", "-DSPLIT"],
    "hubs": ["-DTEAM=32", "-DGROUP=64", "-DHUBS"],
}
# As many numbers per vertex as a picture's colours need, which the compiler has to hold in registers.
PROGRAMS = {
    "jacobi_step": ["-DM=3", "-DG=3", "-DCONDUCTANCES", "-DLAM_ARRAY"],
    "dual_step": ["-DM=3", "-DG=3", "-DPROX=0"],
    "gradient_norm": ["-DM=3", "-DG=3", "-DEDGE_NORM"],
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("primitive", PROGRAMS)
def test_no_stack(primitive: str, form: str) -> None:
    """No stack, and nothing spilled."""
    need("clang", next(filter(None, map(gpu_compilers.missing, gpu_compilers.TARGETS)), None))
    options = ["-DSUM_DOUBLE", "-DN=1", "-DGAMMA", *FORMS[form], *PROGRAMS[primitive]]
    for one in gpu_compilers.compiled_primitive(primitive, options):
        assert (one.stack, one.spilled) == (0, 0), one
