"""Fixtures: the devices to test on, the folder of test data, an environment without settings of this machine."""

from __future__ import annotations

import os
from pathlib import Path

if "PYTEST_XDIST_WORKER" in os.environ:
    # before numpy is loaded: the workers share the cores, and threads of BLAS that wait for each other take them away
    for setting in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(setting, "1")

import pretended
import pytest

from gpureg import backends

# small noisy pictures in files, for the tests of the command line
pytest_plugins = ["commands"]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--as-gpu",
        choices=pretended.KINDS,
        help="let all devices say that they are GPUs, with float64 or without it and without subnormal numbers",
    )


def pytest_configure(config: pytest.Config) -> None:
    kind = config.getoption("as_gpu")
    if kind is not None:
        pretended.pretend(kind)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out the tests of what a GPU gets, which take minutes, unless they are asked for by --as-gpu."""
    asked = config.getoption("as_gpu") is not None
    return True if collection_path == Path(__file__).parent / "gpu" and not asked else None


def _listed(variable: str) -> list[str]:
    return [name.strip() for name in os.environ.get(variable, "").split(",") if name.strip()]


def device_params(found: list[str], absent: dict[str, str], wanted: list[str], required: list[str]) -> list:
    """Parameters of the `device` fixture: every device found, and one for each backend that has none.

    `wanted` (GPUREG_TEST_DEVICES) narrows the choice to devices or whole backends. A backend without a device skips
    and says why, unless it is in `required` (GPUREG_REQUIRE): then it fails, so that a build machine that lost its
    driver does not report success.
    """

    def chosen(name: str) -> bool:
        return not wanted or name in wanted or name.partition(":")[0] in wanted

    params = [pytest.param(name, id=name) for name in found if chosen(name)]
    # A name asked for that nothing answers to must not vanish in silence either.
    known = [*found, *(name.partition(":")[0] for name in found), *absent]
    lost = {name: "GPUREG_TEST_DEVICES names it, but there is no such device" for name in wanted if name not in known}
    for name in required:
        if name not in known:
            lost[name] = "GPUREG_REQUIRE names it, but there is no such backend or device"
    for name, reason in absent.items():
        if name in required or chosen(name):
            lost[name] = reason
    for name, reason in lost.items():
        fails = name in required or name not in absent
        params.append(pytest.param(("fail" if fails else "skip", name, reason), id=f"{name} (absent)"))
    return params


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "device" in metafunc.fixturenames:
        found = [device.id for device in backends.devices()]
        params = device_params(found, backends.absent(), _listed("GPUREG_TEST_DEVICES"), _listed("GPUREG_REQUIRE"))
        metafunc.parametrize("device", params, indirect=True)


def _on_every_driver(test: pytest.Function) -> bool:
    """Whether a test runs on every driver of a backend, not on its first device alone: kernels take long to build.

    Primitives are held on all of them, in tests/backends and where the mark says so.
    """
    room = test.path.is_relative_to(Path(__file__).parent / "backends")
    marked = test.get_closest_marker("one_driver" if room else "every_driver") is not None
    return room != marked


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the first device of each backend where one driver is enough."""
    wanted = _listed("GPUREG_TEST_DEVICES")
    listed = [device.id for device in backends.devices() if not wanted or device.id in wanted]
    first = {name.partition(":")[0]: name for name in reversed(listed)}

    def stays(item: pytest.Item) -> bool:
        name = item.callspec.params.get("device") if hasattr(item, "callspec") else None
        others = isinstance(name, str) and first.get(name.partition(":")[0], name) != name
        return not others or _on_every_driver(item)

    items[:] = [item for item in items if stays(item)]


@pytest.fixture
def device(request: pytest.FixtureRequest) -> str:
    """The id of a device, such as "opencl:0"; one test per device there is."""
    if isinstance(request.param, str):
        return request.param
    verdict, name, reason = request.param
    if verdict == "fail":
        pytest.fail(f"{name} is required here: {reason}")
    pytest.skip(f"{name}: {reason}")


@pytest.fixture(scope="session")
def oracle() -> backends.Backend:
    """numpy in float64, which tests/paper.py holds to the equations."""
    return backends.get("numpy", "float64")


@pytest.fixture(autouse=True)
def _no_settings_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GPUREG_BACKEND", raising=False)


@pytest.fixture
def data_folder() -> Path:
    """The folder of test data that is not part of the project (images, meshes)."""
    named = os.environ.get("GPUREG_DATA")
    if not named:
        pytest.skip("GPUREG_DATA names no folder of test data")
    folder = Path(named)
    if not folder.is_dir():
        pytest.fail(f"GPUREG_DATA={named} is not a folder")
    return folder
