"""Fewer rights for a while: what a test of permissions needs when it runs as root."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


@contextmanager
def no_root() -> Iterator[Path]:
    """A folder, and a time in which this process has no more rights than anybody: root may read and write all."""
    folder = Path(tempfile.mkdtemp()).resolve()
    nobody = 65534
    is_root = os.geteuid() == 0
    try:
        if is_root:
            os.chown(folder, nobody, nobody)
            # The real user too, whom os.access asks about; the saved one is the way back.
            os.setresuid(nobody, nobody, 0)
        try:
            if not os.access(folder, os.W_OK):
                pytest.skip("the folder of temporary files is closed to other users")
            yield folder
        finally:
            if is_root:
                os.setresuid(0, 0, 0)
    finally:
        folder.chmod(0o700)
        shutil.rmtree(folder)


needs_users = pytest.mark.skipif(not hasattr(os, "setresuid"), reason="needs POSIX users")
