"""Tools that a machine may lack: a test that needs one is skipped with the reason, or fails where it is required."""

from __future__ import annotations

import os

import pytest


def need(tool: str, lacking: str | None) -> None:
    """Skip or fail the test if something is lacking; `lacking` says what.

    GPUREG_REQUIRE_TOOLS lists the tools whose tests must run, so that a build machine that lost one does not report
    success.
    """
    if lacking is None:
        return
    required = [name.strip() for name in os.environ.get("GPUREG_REQUIRE_TOOLS", "").split(",")]
    if tool in required:
        pytest.fail(f"{tool} is required here: {lacking}")
    pytest.skip(f"{tool}: {lacking}")
