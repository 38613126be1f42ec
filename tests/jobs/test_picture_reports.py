"""The reports of `gpureg denoise` and `gpureg simplify` as values: JSON, lines, and that nothing changes them."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from commands import noisy_picture

from gpureg.files.pictures import write_picture
from gpureg.jobs.denoise import denoise_file
from gpureg.jobs.denoise_report import DenoiseReport
from gpureg.jobs.denoise_settings import Settings
from gpureg.jobs.simplify import simplify_file
from gpureg.jobs.simplify_report import SimplifyReport
from gpureg.jobs.simplify_settings import Simplification


@pytest.fixture
def noisy(tmp_path):
    path = tmp_path / "noisy.png"
    write_picture(path, noisy_picture()[0])
    return path


def test_a_report_of_denoising(noisy, tmp_path):
    settings = Settings(backend="numpy", norm="edge", p=1, max_iter=3, explain=True)
    report = denoise_file(noisy, tmp_path / "out.png", settings)
    assert isinstance(report, DenoiseReport)
    found = json.loads(json.dumps(report.as_json()))
    (plan, result), *more = report.runs
    assert not more and not result.value.size
    assert (found["sigma"], found["lam"], found["filter"]) == (plan.sigma, plan.lam, plan.describe())
    assert (found["norm"], found["iterations"], found["explain"]) == ("edge", 3, plan.explain().splitlines())
    assert (found["seconds"], found["backend"]) == (report.seconds, report.backend)
    assert [line.split()[0] for line in report.lines()] == ["noise", "filter", "done"]
    assert report.lines()[1].endswith("; edge norm")
    with pytest.raises(dataclasses.FrozenInstanceError):
        report.norm = "vertex"


def test_a_report_of_simplifying(noisy, tmp_path):
    settings = Simplification(backend="numpy", merge_tol=9.0, labels=tmp_path / "labels.tif")
    report = simplify_file(noisy, tmp_path / "out.png", settings)
    assert isinstance(report, SimplifyReport)
    found = json.loads(json.dumps(report.as_json()))
    assert (found["regions"], found["merged"], found["merge_tol"]) == (report.regions, report.merged, 9.0)
    assert found["percent"] == report.percent(report.regions) == pytest.approx(100 * report.regions / 64**2)
    assert found["labels"] == str(tmp_path / "labels.tif")
    words = ["sources", "regions", "filter", "merged", "quality", "seconds", "also", "done"]
    assert [line.split()[0] for line in report.lines()] == words
    assert not report.runs[0].result.value.size
    with pytest.raises(dataclasses.FrozenInstanceError):
        report.nan = 1


def test_errors_of_slices_add_up():
    from gpureg.jobs.simplify_report import Errors

    first, second = np.zeros((2, 3)), np.full((2, 3), 4.0)
    none = Errors()
    both = none.and_those_of(first, first + 1, first + 2, None).and_those_of(second, second, second + 1, None)
    assert (both.fine, both.output, both.count, both.low, both.high) == (6.0, 30.0, 12, 0.0, 4.0)
    assert none == Errors()
    inside = np.array([[True, False, False], [False, False, False]])
    assert none.and_those_of(first, first + 1, first, inside).fine == 1.0
