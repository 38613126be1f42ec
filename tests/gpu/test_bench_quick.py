"""``python -m bench.gpu --quick`` on a pretended GPU: everything runs, and every primitive is right."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench.gpu import run
from bench.gpu.counts import COUNTS
from gpureg import backends

pytestmark = pytest.mark.skipif("opencl" in backends.absent(), reason="OpenCL is absent")


@pytest.mark.usefixtures("quickly_built")
def test_everything_runs(request: pytest.FixtureRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if request.config.getoption("as_gpu") == "single":
        pytest.skip("once is enough")
    pytest.importorskip("matplotlib")
    found = tmp_path / "gpu.json"
    assert run.main(["--quick", "--device", "opencl:0", "--json", str(found), "--plot", str(tmp_path / "gpu.png")]) == 0
    report = json.loads(found.read_text())
    check = report["checks"]["opencl:0"]
    assert not check["not compared"] and not check["unable"] and not check["left out"]
    assert check["arrays"] == ["pyopencl"]
    assert {row["name"] for row in report["rows"]} >= set(COUNTS)
    assert [row for row in report["rows"] if "min" not in row] == []
    assert all(row["share"] > 0 for row in report["rows"] if row["kind"] == "iterated")
    assert "H200, predicted" in capsys.readouterr().out
