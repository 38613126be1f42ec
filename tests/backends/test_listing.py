"""Which devices are listed, in which order, and why others are left out: with devices that are not here."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from gpureg import backends
from gpureg.backends import Device, LeftOut, dispatch

cl = pytest.importorskip("pyopencl", reason="OpenCL is not installed")
from gpureg.backends.opencl import listing  # noqa: E402

GIB = 2**30


class Broken:
    """A device whose driver raises at every query but the name."""

    name = " Broken "

    def __getattr__(self, query: str) -> object:
        raise cl.LogicError(f"clGetDeviceInfo failed: {query}")


def invented(name: str, **other: object) -> SimpleNamespace:
    """A discrete GPU of NVIDIA's driver; `timeout` is what it says of long kernels, None if it is not asked."""
    timeout = other.pop("timeout", None)

    def get_info(number: int) -> int:
        assert number == 0x4005
        if timeout is None:
            raise cl.LogicError("clGetDeviceInfo failed: INVALID_VALUE")
        return timeout

    known = {
        "type": cl.device_type.GPU,
        "platform": SimpleNamespace(name="CUDA", version="OpenCL 3.0 CUDA 12.4"),
        "driver_version": "550.54",
        "available": True,
        "compiler_available": True,
        "host_unified_memory": False,
        "max_compute_units": 20,
        "max_clock_frequency": 1500,
        "global_mem_size": 8 * GIB,
        "double_fp_config": 63,
        "native_vector_width_float": 1,
    }
    return SimpleNamespace(name=name, get_info=get_info, **(known | other))


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch):
    """List the devices of an invented machine."""

    def listed(*devices: object) -> list[Device | LeftOut]:
        platforms = [SimpleNamespace(get_devices=lambda: list(devices))]
        monkeypatch.setattr(listing.cl, "get_platforms", lambda: platforms)
        monkeypatch.setattr(dispatch, "_probes", {})
        return listing.devices()

    return listed


def ranked(found: list[Device | LeftOut]) -> list[str]:
    return [one.name for one in sorted((x for x in found if isinstance(x, Device)), key=lambda one: one.rank)]


def test_gpus_by_their_memory_and_their_speed(machine) -> None:
    """A GPU that shares 25 GiB of the host comes after one with 8 GiB of its own, whatever its speed."""
    pocl = SimpleNamespace(name="PoCL", version="OpenCL 3.0 PoCL 5.0 Linux")
    intel = SimpleNamespace(name="Intel", version="OpenCL 3.0 LINUX")
    cpu = {"type": cl.device_type.CPU, "host_unified_memory": True}
    found = machine(
        invented("a CPU by Intel's runtime", **cpu, platform=intel, driver_version="2024.17"),
        invented("a CPU by PoCL", **cpu, platform=pocl, driver_version="5.0"),
        invented("integrated", host_unified_memory=True, global_mem_size=25 * GIB, max_compute_units=96),
        invented("slow clock", max_compute_units=40, max_clock_frequency=700),
        invented("fast", max_compute_units=40, max_clock_frequency=1400),
    )
    assert ranked(found) == ["fast", "slow clock", "integrated", "a CPU by PoCL", "a CPU by Intel's runtime"]
    assert [one.id for one in found] == [f"opencl:{i}" for i in range(5)]
    assert [one.kind for one in found] == ["cpu", "cpu", "gpu", "gpu", "gpu"]


def test_one_broken_device_takes_no_other_away(machine) -> None:
    emulator = invented("Intel(R) FPGA Emulation Device", type=cl.device_type.ACCELERATOR)
    older = invented("Intel(R) FPGA Emulation Platform", type=cl.device_type.CPU)
    silent = invented("no compiler", compiler_available=False)
    found = machine(Broken(), invented("works"), emulator, older, silent)
    assert ranked(found) == ["works"]
    assert next(one for one in found if isinstance(one, Device)).id == "opencl:1"
    reasons = {one.name: one.reason for one in found if isinstance(one, LeftOut)}
    assert list(reasons) == ["Broken", emulator.name, older.name, "no compiler"]
    assert "LogicError" in reasons["Broken"]
    assert reasons[emulator.name] == reasons[older.name] == "it is neither a GPU nor a CPU"
    assert "compiler is not available" in reasons["no compiler"]
    assert [str(one) for one in backends.left_out() if one.id == "opencl:0"] == [
        f"opencl:0 (Broken): {reasons['Broken']}"
    ]
    assert "opencl" not in backends.absent()
    with pytest.raises(backends.BackendUnavailable, match=r"opencl:2 \(Intel.*neither a GPU nor a CPU"):
        backends.get("opencl:2")


def test_a_machine_with_broken_devices_alone_says_why(machine) -> None:
    machine(Broken())
    assert "Broken" in backends.absent()["opencl"]
    assert backends.auto().backend in ("warp", "numpy")


def test_optional_queries_may_fail(machine) -> None:
    """HOST_UNIFIED_MEMORY left OpenCL with 3.0, and not every driver has all others."""
    device = invented("plain")
    for query in ("host_unified_memory", "max_clock_frequency", "available", "compiler_available"):
        delattr(device, query)
    assert ranked(machine(device)) == ["plain"]


@pytest.mark.parametrize(
    ("shared", "timeout", "watched"), [(False, 1, True), (True, 0, False), (True, None, True), (False, None, False)]
)
def test_devices_with_a_limit_on_launches(machine, shared: bool, timeout: int | None, watched: bool) -> None:
    """NVIDIA's driver tells; of others, a GPU that shares the host's memory is taken to draw the screen."""
    [found] = machine(invented("a GPU", host_unified_memory=shared, timeout=timeout))
    assert isinstance(found, Device)
    assert found.watched is watched


@pytest.mark.parametrize(("told", "free"), [([3 * 2**20, 2**20], 3 * GIB), (None, 8 * GIB), ([2**40], 8 * GIB)])
def test_the_memory_that_is_free(machine, told: list[int] | None, free: int) -> None:
    """AMD's drivers tell KiB: of all free memory, and of its largest block."""
    device = invented("a GPU")
    if told is not None:
        device.global_free_memory_amd = told
    [found] = machine(device)
    assert isinstance(found, Device)
    assert listing.free_memory(found) == free


@pytest.fixture
def warp_machine(monkeypatch: pytest.MonkeyPatch):
    """List what Warp would on a machine with these CUDA devices; a device is named by its attributes."""
    pytest.importorskip("warp", reason="Warp is not installed")
    from gpureg.backends.warp import listing as room

    def listed(*devices: dict) -> list[Device | LeftOut]:
        cards = [SimpleNamespace(is_cuda=True, ordinal=i, alias=f"cuda:{i}", **x) for i, x in enumerate(devices)]
        cpu = SimpleNamespace(is_cuda=False, alias="cpu")
        monkeypatch.setattr(room.wp, "get_devices", lambda: [cpu, *cards])
        monkeypatch.setattr(room.wp, "get_cuda_supported_archs", lambda: [75, 80, 90])
        monkeypatch.setattr(room.wp, "get_cuda_driver_version", lambda: (12, 9))
        asked = {13: "clock", 17: "timeout", 18: "integrated"}
        monkeypatch.setattr(room, "_attribute", lambda ordinal, number: devices[ordinal].get(asked[number], 0))
        return room.devices()

    return listed


def test_cuda_devices_are_ranked_and_old_ones_left_out(warp_machine) -> None:
    memory = {"total_memory": 8 * GIB}
    found = warp_machine(
        {"name": "old", "arch": 61, "sm_count": 30, "clock": 1_700_000, **memory},
        {"name": "integrated", "arch": 90, "sm_count": 48, "clock": 2_000_000, "integrated": 1, **memory},
        {"name": "small", "arch": 80, "sm_count": 20, "clock": 1_700_000, "timeout": 1, **memory},
        {"name": "large", "arch": 90, "sm_count": 132, "clock": 1_700_000, **memory},
        {"name": "no memory", "arch": 90, "sm_count": 132},
    )
    assert ranked(found)[:-1] == ["large", "small", "integrated"]
    assert [one.name for one in found if isinstance(one, Device) and one.watched] == ["small"]
    reasons = {one.id: one.reason for one in found if isinstance(one, LeftOut)}
    assert list(reasons) == ["warp:cuda:0", "warp:cuda:4"]
    assert "sm_75" in reasons["warp:cuda:0"] and "sm_61" in reasons["warp:cuda:0"]
    assert "OpenCL" in reasons["warp:cuda:0"]
    assert "AttributeError" in reasons["warp:cuda:4"]


class Driver:
    """CUDA's driver with one device: functions return 0, or the number of an error."""

    @staticmethod
    def cuDeviceGet(device, ordinal: int) -> int:
        return 0 if ordinal == 0 else 101

    @staticmethod
    def cuDeviceGetAttribute(value, attribute: int, device) -> int:
        value._obj.value = {13: 1_980_000, 17: 1}.get(attribute, 0)
        return 0


@pytest.mark.parametrize(
    ("there", "ordinal", "clock", "timeout"), [(True, 0, 1_980_000, 1), (True, 1, 0, 0), (False, 0, 0, 0)]
)
def test_attributes_that_warp_does_not_tell(monkeypatch, there: bool, ordinal: int, clock: int, timeout: int) -> None:
    """A device that the driver does not know, and a machine without a driver, have 0."""
    pytest.importorskip("warp", reason="Warp is not installed")
    from gpureg.backends.warp import listing as room

    def load(name: str) -> Driver:
        if not there or name != "nvcuda.dll":
            raise OSError(name)
        return Driver()

    monkeypatch.setattr(room.ctypes, "CDLL", load)
    assert room._attribute(ordinal, room._CLOCK_RATE) == clock
    assert room._attribute(ordinal, room._KERNEL_EXEC_TIMEOUT) == timeout
    assert room._attribute(ordinal, room._INTEGRATED) == 0
