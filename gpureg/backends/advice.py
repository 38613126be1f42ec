"""What would make gpureg faster here: the extras whose wheels exist for this machine; a warning where it is slow."""

from __future__ import annotations

import platform
import warnings

from ..doors import outside

# Vertices above which numpy alone takes seconds.
SLOW = 1 << 18

# The oldest glibc that the wheels of Warp 1.19 on PyPI run with, by processor.
_WARP_LINUX = {"x86_64": (2, 28), "aarch64": (2, 34)}
_DRIVER = (
    "an OpenCL driver of the system, such as the package pocl-opencl-icd (Debian, Ubuntu) or pocl (Fedora, Homebrew)"
)

_state = {"fallen back": False, "told": False}


def _linux() -> tuple[str, tuple[int, ...]]:
    """Return the processor, and the version of glibc: empty for another C library."""
    name, version = platform.libc_ver()
    glibc = tuple(int(part) for part in version.split(".") if part.isdigit()) if name == "glibc" else ()
    return platform.machine(), glibc


def has_pocl() -> bool:
    """Return whether PyPI has PoCL for this machine: Linux x86-64 with glibc."""
    return platform.system() == "Linux" and _linux()[0] == "x86_64" and _linux()[1] >= (2, 17)


def has_warp() -> bool:
    """Return whether PyPI has Warp for this machine: Linux x86-64 and ARM64, Windows, macOS on Apple's processors."""
    machine = platform.machine().lower()
    if platform.system() == "Linux":
        return machine in _WARP_LINUX and _linux()[1] >= _WARP_LINUX[machine]
    if platform.system() == "Darwin":
        return machine == "arm64"
    return platform.system() == "Windows" and machine in ("amd64", "arm64")


def has_pyopencl() -> bool:
    """Return whether PyPI has pyopencl as a wheel for this machine: Linux, macOS, Windows x86-64."""
    machine = platform.machine().lower()
    return platform.system() == "Darwin" or machine in {"Linux": ("x86_64", "aarch64"), "Windows": ("amd64",)}.get(
        platform.system(), ()
    )


def install_warp() -> str:
    """Say how to install Warp."""
    if has_warp():
        return "pip install 'gpureg[warp]'"
    return f"PyPI has no Warp for {platform.system()} on {platform.machine()}"


def install_opencl() -> str:
    """Say how to install pyopencl and a driver."""
    library = "pip install 'gpureg[opencl]'"
    if not has_pyopencl():
        library += " (which compiles pyopencl)"
    if has_pocl():
        return f"{library}, or 'gpureg[pocl]' to bring a CPU driver along"
    return f"{library}, and {driver()}"


def driver() -> str:
    """Say where a driver for OpenCL comes from."""
    if has_pocl():
        return "pip install 'gpureg[pocl]' for a CPU driver, or the driver of the graphics card"
    if platform.system() == "Darwin":
        return "macOS has a driver"
    if platform.system() == "Windows":
        return "the driver of the graphics card has OpenCL"
    return _DRIVER


def faster() -> str:
    """Say what would help on a machine where only numpy computes."""
    if has_pocl():
        return "pip install 'gpureg[pocl]' makes it 15 to 40 times faster"
    if has_warp():
        return "pip install 'gpureg[warp]' makes it several times faster"
    return f"OpenCL makes it many times faster: {install_opencl()}"


def fell_back() -> None:
    """Note that "auto" found nothing but numpy."""
    _state["fallen back"] = True


def warn_if_slow(n_vertices: int) -> None:
    """Warn once per process where "auto" found nothing but numpy, and the data are large.

    Warns
    -----
    UserWarning
        What to install.
    """
    if n_vertices <= SLOW or not _state["fallen back"] or _state["told"]:
        return
    _state["told"] = True
    warnings.warn(
        f"only numpy computes here, which is slow for {n_vertices} vertices or pixels: {faster()} "
        "(gpureg backends lists what is missing)",
        UserWarning,
        stacklevel=outside(),
    )
