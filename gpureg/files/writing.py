"""Write files as a whole or not at all: with a temporary name in the same folder, renamed at the end."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from .picture import PictureError


def check_place(path: str | os.PathLike[str]) -> None:
    """Check, before the work begins, that a file can be written there.

    Raises
    ------
    PictureError
        The folder does not exist or cannot be written, the file cannot be written, or it is a folder.
    """
    target = Path(os.path.realpath(path))
    try:
        if not target.parent.is_dir():
            raise PictureError(f"{path}: the folder {Path(path).parent} does not exist")
        if target.is_dir():
            raise PictureError(f"{path} is a folder")
        if not os.access(target.parent, os.W_OK) or (target.exists() and not os.access(target, os.W_OK)):
            raise PictureError(f"{path}: no permission to write there")
    except PictureError:
        raise
    except OSError as error:  # for example a name that is too long
        raise PictureError(f"{path} cannot be written: {error.strerror}") from None


def write_atomically(path: str | os.PathLike[str], write: Callable[[Path], Any]) -> None:
    """Call `write` with a temporary name in the folder of `path`, then rename; after an error no file is left."""
    write_files({Path(path): write})


def write_files(writes: Mapping[Path, Callable[[Path], Any]]) -> None:
    """Write files as :func:`write_atomically`, all or none: all are written before the first is renamed."""
    with contextlib.ExitStack() as temporaries:
        written: list[tuple[Path, Path, Path]] = []
        for path, write in writes.items():
            # Replace the target of a link, not the link.
            target = Path(os.path.realpath(path))
            temporary = target.with_name(f".{secrets.token_hex(8)}{target.suffix}")
            temporaries.callback(_remove, temporary)
            with _told(path):
                write(temporary)
                if target.exists():
                    shutil.copymode(target, temporary)
            written.append((path, temporary, target))
        for path, temporary, target in written:
            with _told(path):
                os.replace(temporary, target)


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """Turn errors of the system into PictureError."""
    try:
        yield
    except OSError as error:
        raise PictureError(f"{path} cannot be written: {error.strerror or error}") from None


def _remove(temporary: Path) -> None:
    with contextlib.suppress(OSError):
        temporary.unlink(missing_ok=True)
