"""What the tests of the command line have in common."""

from __future__ import annotations

from pathlib import Path

from commands import denoise, failed


def refused(folder: Path, code: int, source: Path, target: Path, *options: object, words: tuple[str, ...] = ()) -> None:
    """A denoising that must fail, and must leave the folder as it was: no output, no temporary, old files unchanged."""

    def content() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}

    before = content()
    failed(denoise(source, target, *options), code, *words)
    assert content() == before


# An interpreter without OpenCL and Warp: what is None in sys.modules cannot be imported.
WITHOUT_DEVICES = (
    "import sys; sys.modules['pyopencl'] = sys.modules['warp'] = None; "
    "from gpureg.cli import main; main(sys.argv[1:], prog_name='gpureg')"
)
