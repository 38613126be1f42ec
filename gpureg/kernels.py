"""Find the hand-written kernel sources, in a checkout or in an installed wheel.

The sources live in ``kernels/`` beside the package, for compilers; a wheel carries them as ``gpureg/_kernels``.
This module takes the first of the two that exists and makes itself a package over it, so that
``gpureg.kernels.warp.jacobi_step`` is an ordinary import and :func:`opencl_source` reads the OpenCL C files.
"""

from __future__ import annotations

import functools
import re
from pathlib import Path

_HERE = Path(__file__).resolve().parent
_CANDIDATES = (_HERE / "_kernels", _HERE.parent / "kernels")


def _find() -> Path:
    for folder in _CANDIDATES:
        if (folder / "opencl").is_dir():
            return folder
    looked = " and ".join(str(folder) for folder in _CANDIDATES)
    raise FileNotFoundError(f"gpureg's kernel sources are missing: looked in {looked}. Reinstall gpureg.")


folder = _find()
__path__ = [str(folder)]

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')


@functools.cache
def opencl_source(stem: str) -> str:
    """Text of ``opencl/<stem>.cl`` with its quoted includes put in place.

    The includes are resolved here because drivers disagree about search paths with spaces in them; each file guards
    itself against being read twice.
    ``#line`` directives keep the compiler's messages pointing at the real file and line.
    """

    def expand(name: str) -> list[str]:
        lines = [f'#line 1 "{name}"']
        for number, line in enumerate((folder / "opencl" / name).read_text("utf-8").splitlines(), 1):
            match = _INCLUDE.match(line)
            if match is None:
                lines.append(line)
                continue
            lines += expand(match[1])
            lines.append(f'#line {number + 1} "{name}"')
        return lines

    return "\n".join(expand(stem + ".cl")) + "\n"
