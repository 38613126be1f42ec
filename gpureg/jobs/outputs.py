"""Write the files of ``gpureg mesh``, ``points`` and ``curve``, all or none: :class:`Outputs`."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..files.pictures import PictureError, check_place, write_files


class Outputs:
    """Files to write, checked before the work begins.

    Parameters
    ----------
    source : Path
        The input file. OUT may be the same file.
    reference : Path, optional
        Another input file.
    """

    def __init__(self, source: Path, reference: Path | None) -> None:
        self._source = source
        self._reference = [] if reference is None else [reference]
        self._expected: list[tuple[str, Path]] = []
        self._writes: dict[Path, Callable[[Path], Any]] = {}

    def expect(self, option: str, path: Path) -> None:
        """Check a file that will be written.

        Parameters
        ----------
        option : str
            Where the user gave the file: "OUT", or an option.
        path : Path

        Raises
        ------
        PictureError
            The folder does not exist or cannot be written.
        ValueError
            The file is an input, or the output of another option.
        """
        check_place(path)
        for other in self._reference if option == "OUT" else [self._source, *self._reference]:
            if os.path.exists(path) and os.path.exists(other) and os.path.samefile(path, other):
                raise ValueError(f"{option} {path} would overwrite {other}, which is read; give another file")
        for earlier, taken in self._expected:
            if os.path.realpath(path) == os.path.realpath(taken):
                raise ValueError(f"{earlier} and {option} would both be written to {taken}; give each its own file")
        self._expected.append((option, path))

    def expect_picture(self, path: Path | None, error: type[PictureError]) -> None:
        """Check the picture, if one is asked for; raise `error` if matplotlib is not installed."""
        if path is None:
            return
        from ..plot.canvas import check_path

        try:
            check_path(path)
        except ImportError as missing:
            raise error(f"--picture: {missing}") from None
        self.expect("--picture", path)

    def put(self, path: Path, content: bytes) -> None:
        """Set the content of a file."""
        self._writes[path] = lambda temporary: temporary.write_bytes(content)

    def draw(self, path: Path, figure: Any) -> None:
        """Set the matplotlib figure that is written to a file."""
        self._writes[path] = lambda temporary: figure.savefig(temporary)

    def write(self) -> None:
        """Write all files, or none.

        Raises
        ------
        PictureError
            A file cannot be written.
        """
        write_files(self._writes)
