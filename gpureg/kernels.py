"""Find the kernel sources, in a checkout or in an installed wheel.

A checkout has them in ``kernels/`` next to the package, a wheel in ``gpureg/_kernels``. This module becomes a package
over that folder, so that ``gpureg.kernels.warp.jacobi_step`` can be imported.
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
    """Return the text of ``opencl/<stem>.cl`` with its quoted includes resolved.

    OpenCL drivers treat search paths with spaces differently, so they get one text. Each file has an include guard.
    ``#line`` directives let the compiler's messages name the real file and line.
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
