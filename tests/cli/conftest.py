"""Fixtures of these tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import noisy_picture

from gpureg.files.pictures import Picture, write_picture


@pytest.fixture(autouse=True)
def _no_backend_from_outside(monkeypatch):
    monkeypatch.delenv("GPUREG_BACKEND", raising=False)


@pytest.fixture
def noisy(tmp_path) -> Path:
    path = tmp_path / "noisy.png"
    write_picture(path, noisy_picture()[0])
    return path


@pytest.fixture
def flat(tmp_path) -> Path:
    """A picture without any noise."""
    path = tmp_path / "flat.png"
    write_picture(path, Picture(np.full((20, 30), 77, np.uint8)))
    return path


@pytest.fixture(params=["new", "old"])
def target(request, tmp_path) -> Path:
    """A place for the output: a free one, or one where a file lies that a failure must not harm."""
    path = tmp_path / "out.png"
    if request.param == "old":
        path.write_bytes(b"what was there before")
    return path
