"""The command line as tests call it, and small noisy pictures for it.

Most calls run inside this process; those that need signals, pipes or a bare interpreter run in their own. The numpy
backend does the work, since which device runs changes nothing here.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import gpureg
from gpureg.cli import main
from gpureg.files.pictures import Picture, write_picture

SIGMA = 15.0  # of 255
ROOT = Path(gpureg.__file__).resolve().parent.parent


def clean_picture(channels: int, white: float) -> np.ndarray:
    """A chequered floor under a slanting light, 64 x 64, well inside the range so that noise is not clipped."""
    board = np.kron([[0.35, 0.6], [0.65, 0.4]], np.ones((32, 32))) + np.linspace(0, 0.1, 64)
    planes = board if channels == 1 else np.dstack([board, 1 - board, 0.5 * board + 0.2])
    return white * planes


def noisy_picture(layout: str = "grey", dtype: str = "uint8") -> tuple[Picture, np.ndarray]:
    """A noisy picture, and the one without noise."""
    channels = 3 if layout.startswith("rgb") else 1
    white = {"uint8": 255.0, "uint16": 65535.0, "float32": 1.0}[dtype]
    clean = clean_picture(channels, white)
    rng = np.random.default_rng(7)
    pixels = clean + rng.normal(0, SIGMA / 255 * white, clean.shape)
    if dtype != "float32":
        pixels = np.clip(np.rint(pixels), 0, white)
    alpha = None
    if layout in ("rgba", "grey-alpha"):
        alpha = rng.integers(0, int(white), (64, 64), dtype, endpoint=True)
    return Picture(pixels.astype(dtype), alpha), clean


def call(*arguments: object, env: dict[str, str] | None = None):
    return CliRunner().invoke(main, [str(a) for a in arguments], prog_name="gpureg", env=env)


def denoise(source: Path, target: Path, *options: object, env: dict[str, str] | None = None):
    backend = [] if env is not None or "--backend" in options else ["--backend", "numpy"]
    # the filter alone: which passes follow it changes nothing for files, and takes longer
    fast = [] if "--passes" in options or "--quality" in options else ["--quality", "fast"]
    return call("denoise", source, target, *backend, *fast, *options, env=env)


def done(result) -> str:
    """The output of a call that must have worked."""
    assert result.exit_code == 0, result.output
    assert "Traceback" not in result.output and "Warning" not in result.output
    return result.output


def report(source: Path, target: Path, *options: object, env: dict[str, str] | None = None) -> dict:
    def reject(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    result = denoise(source, target, "--json", *options, env=env)
    done(result)
    return json.loads(result.stdout, parse_constant=reject)


def process(
    *arguments: object, env: dict[str, str] | None = None, code: str | None = None, **kwargs
) -> subprocess.CompletedProcess[str]:
    """gpureg as a shell would start it."""
    start = ["-m", "gpureg"] if code is None else ["-c", code]
    return subprocess.run(
        [sys.executable, *start, *map(str, arguments)],
        capture_output=True, text=True, encoding="utf-8", timeout=300, env=environment(env), **kwargs,
    )  # fmt: skip


def on_terminal(
    *arguments: object, columns: int = 80, cwd: Path | None = None, stdout: int | None = None
) -> tuple[int, bytes, bytes]:
    """gpureg on a terminal: its exit code, what the terminal got, and standard output where that is a pipe."""
    pty = pytest.importorskip("pty", reason="needs a POSIX terminal")
    main, terminal = pty.openpty()
    command = [sys.executable, "-m", "gpureg", *map(str, arguments)]
    env = environment({"TERM": "xterm", "COLUMNS": str(columns)})
    with subprocess.Popen(
        command, cwd=cwd, stdout=terminal if stdout is None else stdout, stderr=terminal, env=env
    ) as running:
        os.close(terminal)
        shown = b""
        try:
            while chunk := os.read(main, 65536):
                shown += chunk
        except OSError:  # how Linux says that the other end is closed
            pass
        out = b"" if running.stdout is None else running.stdout.read()
    os.close(main)
    return running.returncode, shown, out


def environment(extra: dict[str, str] | None = None) -> dict[str, str]:
    """The environment for a process of its own, which finds the gpureg that is tested here."""
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "PYTHONIOENCODING": "utf-8", **(extra or {})}


def failed(result, code: int, *words: str) -> None:
    assert result.exit_code == code, result.output
    assert result.exception is None or isinstance(result.exception, SystemExit), repr(result.exception)
    assert "Traceback" not in result.output
    for word in words:
        assert word in result.output, f"{word!r} is not in {result.output!r}"


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
