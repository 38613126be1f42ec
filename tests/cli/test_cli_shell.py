"""`gpureg backends`, `demo`, help, and the command in a shell: pipes, interruptions, full disks."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from commands import call, done, environment, failed, process
from PIL import Image
from refusing import WITHOUT_DEVICES

import gpureg
from gpureg import backends
from gpureg.cli import main
from gpureg.files.pictures import Picture, write_picture


def test_backends():
    lines = done(call("backends")).splitlines()
    headings = ("name", "device", "driver", "memory", "vector", "float64")
    assert [heading for heading in headings if heading not in lines[0]] == []
    assert any(line.split()[0] == "numpy" or line.split()[:2] == ["*", "numpy"] for line in lines if line.split())
    assert sum(line.startswith("*") for line in lines[1:]) == 2, "the device auto takes, and the sentence that says why"


def test_backends_say_why_a_device_is_left_out(monkeypatch):
    unfit = backends.LeftOut("numpy:1", "an old one", "its driver does not answer (Error: -30)")
    monkeypatch.setattr(backends, "left_out", lambda: [unfit])
    assert "  numpy:1 (an old one): its driver does not answer (Error: -30)" in done(call("backends")).splitlines()
    assert json.loads(done(call("backends", "--json")))["left_out"] == [
        {"id": "numpy:1", "device": "an old one", "reason": "its driver does not answer (Error: -30)"}
    ]


def test_backends_json():
    got = json.loads(done(call("backends", "--json")))
    assert set(got) == {"devices", "absent", "left_out", "auto"}
    keys = {"id", "device", "driver", "kind", "memory_bytes", "vector_width", "float64", "auto"}
    assert [device for device in got["devices"] if not set(device) >= keys] == []
    assert sum(device["auto"] for device in got["devices"]) == 1
    assert "numpy" in {device["id"] for device in got["devices"]}
    absent = got["absent"].items()
    assert [name for name, why in absent if f"gpureg[{name}]" not in why and "does not start" not in why] == []


def test_backends_says_what_the_environment_forces():
    out = done(call("backends", env={"GPUREG_BACKEND": "numpy"}))
    assert "GPUREG_BACKEND=numpy overrides auto" in out
    got = json.loads(done(call("backends", "--json", env={"GPUREG_BACKEND": "numpy"})))
    assert [device["id"] for device in got["devices"] if device["auto"]] == ["numpy"]


def _needs_plot() -> None:
    pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")
    pytest.importorskip("skimage", reason="scikit-image, of the extra 'plot', is not installed")


def test_demo(tmp_path, monkeypatch):
    _needs_plot()
    from skimage import data

    part = data.camera()[128:256, 160:288]
    monkeypatch.setattr(data, "camera", lambda: part)  # numpy is slow
    out = done(call("demo", tmp_path / "demo.png", "--backend", "numpy"))
    assert [line.split()[0] for line in out.splitlines()] == ["noise", "filter", "done", "picture"]
    psnr = re.search(r"PSNR ([\d.]+) -> ([\d.]+) dB", out)
    assert psnr is not None and float(psnr[2]) > float(psnr[1]) + 5
    assert str(tmp_path / "demo.png") in out
    with Image.open(tmp_path / "demo.png") as opened:
        opened.load()
        width, height = opened.size
        pixels = np.asarray(opened.convert("L"), float)
    assert width > 1000 and 300 < height < width
    # Three panels with something in each of them.
    assert min(third.std() for third in np.array_split(pixels, 3, axis=1)) > 5
    assert os.listdir(tmp_path) == ["demo.png"]


def test_demo_refuses(tmp_path):
    _needs_plot()
    for code, words, arguments in (
        (2, ("sigma", "-1"), (tmp_path / "a.png", "--sigma", "-1")),
        (2, ("sigma", "nan"), (tmp_path / "a.png", "--sigma", "nan")),
        (2, ("unknown backend 'cuda'",), (tmp_path / "a.png", "--backend", "cuda")),
        (1, ("extension",), (tmp_path / "a.bmp",)),
        (1, ("nowhere", "does not exist"), (tmp_path / "nowhere" / "a.png",)),
    ):
        failed(call("demo", *arguments), code, *words)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("missing", ["matplotlib", "skimage"])
def test_demo_without_its_libraries(tmp_path, missing):
    """A sentence with the extra to install, and no picture."""
    code = WITHOUT_DEVICES.replace("'warp'", f"'{missing}'")
    got = process("demo", tmp_path / "demo.png", "--backend", "numpy", code=code)
    assert got.returncode == 1, got.stderr
    assert "gpureg[plot]" in got.stderr and missing in got.stderr and "Traceback" not in got.stderr
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("command", sorted(main.commands))
@pytest.mark.parametrize("flag", ["--help", "-h"])
def test_help_has_an_example(command, flag):
    out = done(call(command, flag))
    assert out.startswith(f"Usage: gpureg {command}")
    # each on a line of its own
    assert re.search(
        rf"^  Examples?:\n(    .*\n)*    .*gpureg {'denoise' if command == 'backends' else command}", out, re.M
    )


def test_help_lists_every_option_with_words():
    out = done(call("denoise", "--help"))
    options = [option for option in main.commands["denoise"].params if option.param_type_name == "option"]
    assert [option.opts[0] for option in options if option.opts[0] not in out or not option.help] == []


def test_overview_and_version():
    out = done(call("--help"))
    # what each does fits the line
    assert [command for command in main.commands if not re.search(rf"^  {command} +[A-Z].*\.$", out, re.M)] == []
    assert done(call("--version")).strip() == f"gpureg, version {gpureg.__version__}"
    got = process("--version")
    assert (got.returncode, got.stdout.strip()) == (0, f"gpureg, version {gpureg.__version__}")


def test_from_a_shell(noisy):
    got = process("denoise", "noisy.png", "clean.png", "--backend", "numpy", cwd=noisy.parent)
    assert got.returncode == 0, got.stderr
    assert len(got.stdout.splitlines()) == 3 and got.stderr == ""
    assert sorted(os.listdir(noisy.parent)) == ["clean.png", "noisy.png"]


@pytest.mark.parametrize(("code", "arguments"), [(1, ("missing.png", "a.png")), (2, ("noisy.png", "a.png", "--p", 0))])
def test_refusals_in_a_shell(noisy, code, arguments):
    got = process("denoise", *arguments, cwd=noisy.parent)
    assert got.returncode == code
    assert got.stdout == "" and got.stderr and "Traceback" not in got.stderr
    assert os.listdir(noisy.parent) == ["noisy.png"]


@pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")
@pytest.mark.parametrize(
    "options",
    [
        ("--p", "1", "--max-iter", "1000000", "--tol", "0"),
        ("--radius", "40", "--weights", "patch"),
        ("--p", "1", "--lam", "sure"),
    ],
    ids=["iterations", "weights", "search"],
)
def test_interrupt_while_working(tmp_path, options):
    """Ctrl-C in the loop, in the making of weights, in a search: code 130, a word, the old output, no half."""
    rng = np.random.default_rng(0)
    pixels = np.clip(rng.normal(128, 20, (1500, 1500)), 0, 255).astype(np.uint8)
    write_picture(tmp_path / "in.png", Picture(pixels))
    (tmp_path / "out.png").write_bytes(b"what was there before")
    # The process says when it has started, so that the signal falls into the work, and takes SIGINT even where the
    # tests run in the background of a shell, which has its children ignore it.
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from gpureg.cli import main; print('ready', flush=True); main(sys.argv[1:], prog_name='gpureg')"
    )
    command = [sys.executable, "-c", code, "denoise", str(tmp_path / "in.png"), str(tmp_path / "out.png")]
    with subprocess.Popen(
        [*command, "--backend", "numpy", *options],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment(),
    ) as running:  # fmt: skip
        try:
            assert running.stdout.readline() == "ready\n"
            time.sleep(1.5)
            assert running.poll() is None, "it ended before it could be interrupted"
            running.send_signal(signal.SIGINT)
            out, error = running.communicate(timeout=120)
        finally:
            running.kill()
    assert running.returncode == 130, error
    assert "interrupted" in error and "nothing was written" in error
    assert "Traceback" not in error and out == ""
    assert (tmp_path / "out.png").read_bytes() == b"what was there before"
    assert sorted(os.listdir(tmp_path)) == ["in.png", "out.png"]


@pytest.mark.skipif(os.name != "posix", reason="needs a POSIX shell")
@pytest.mark.parametrize("command", ["backends", "backends --json", "denoise --help"])
def test_reader_that_goes_away(command):
    """`gpureg backends | head -c 1`: no traceback, and none of the interpreter's complaints at its end."""
    got = subprocess.run(
        ["sh", "-c", f'"$PYTHON" -m gpureg {command} | true'],
        capture_output=True, text=True, timeout=300, env=environment({"PYTHON": sys.executable}),
    )  # fmt: skip
    assert "Traceback" not in got.stderr and "BrokenPipe" not in got.stderr
    assert got.stderr == ""


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
def test_report_onto_a_full_disk(noisy):
    with open("/dev/full", "w") as full:
        got = subprocess.run(
            [sys.executable, "-m", "gpureg", "denoise", str(noisy), str(noisy.parent / "o.png"), "--backend", "numpy"],
            stdout=full, stderr=subprocess.PIPE, text=True, timeout=300, env=environment(),
        )  # fmt: skip
    assert got.returncode == 1
    assert "Traceback" not in got.stderr and "No space left" in got.stderr
