"""The plan: lam searched for by name, the rule without a search, and every parameter explained."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import rng
from test_image import blocks, noisy, psnr

import gpureg as gr
from gpureg.images import choose as planning
from gpureg.images import guides as pixels
from gpureg.images.noise import Noise
from gpureg.images.raster import Raster

NUMPY = {"backend": "numpy", "dtype": "float64"}
METHODS = ("discrepancy", "sure", "j-invariance")


def lines(plan: gr.DenoisePlan) -> dict[str, str]:
    return {line.split()[0]: line for line in plan.explain().splitlines()}


@pytest.mark.parametrize("method", METHODS)
def test_lam_by_name_is_near_the_best(method: str) -> None:
    clean = blocks((64, 64), 16)
    before = noisy(clean, 20)
    plan = gr.plan_denoising(before, p=1, lam=method, **NUMPY)

    def quality(lam: float) -> float:
        return psnr(gr.run_plan(replace(plan, lam=lam), before, **NUMPY).value, clean)

    best = max(quality(lam) for lam in np.geomspace(0.02, 0.5, 15))
    # Measured: 1.0, 0.0 and 0.1 dB below; the discrepancy principle smooths too much by its nature.
    assert quality(plan.lam) > best - {"discrepancy": 2.0, "sure": 0.1, "j-invariance": 0.5}[method]
    says = {"discrepancy": "of the noise's energy", "sure": "SURE: estimated PSNR", "j-invariance": "J-invariance: est"}
    assert says[method] in lines(plan)["lam"]
    assert "evaluation" in lines(plan)["lam"]
    # the door takes the word too, and does what the plan says; its default type differs
    after = gr.denoise_image(before, p=1, lam=method, backend="numpy")
    assert psnr(after, clean) == pytest.approx(quality(plan.lam), abs=0.05)


def test_sure_says_the_quality_it_reaches() -> None:
    clean = blocks((96, 96), 32)
    before = noisy(clean, 20).astype(np.float32)
    plan = gr.plan_denoising(before, p=1, lam="sure", sigma=20.0, **NUMPY)
    said = lines(plan)["lam"].split("PSNR ")[1].split()
    reached = gr.run_plan(plan, before, **NUMPY).value
    span = float(said[3].rstrip(","))
    assert span == pytest.approx(pixels.contrast(Raster.of(before), Noise((20.0,)))[0], rel=1e-3)  # four digits
    # 9,216 pixels: the estimate scatters by 400 sqrt(2/9216) = 6 of an error of some 40
    truth = 10 * math.log10(span**2 / np.mean((reached - clean) ** 2))
    assert float(said[0]) == pytest.approx(truth, abs=10 * math.log10(1.5))
    assert "of 255, " in lines(gr.plan_denoising(np.clip(before, 0, 255).astype(np.uint8), p=1, lam="sure"))["lam"]


def test_the_discrepancy_principle_is_kept() -> None:
    before = noisy(blocks(), 20)
    mask = np.ones(before.shape, bool)
    mask[10:30, 10:30] = False
    torn = np.where(mask, before, np.nan)
    plan = gr.plan_denoising(torn, p=1.3, lam="discrepancy", sigma=20.0, mask=mask, **NUMPY)
    value = gr.run_plan(plan, torn, mask=mask, **NUMPY).value
    assert np.mean((value - torn)[mask] ** 2) / 400 == pytest.approx(1, abs=0.0101)


@pytest.mark.parametrize("method", METHODS[1:])
def test_filters_may_be_searched_too(method: str) -> None:
    """At p = 2 lam says how much a pixel itself counts; weights follow the image, also in the perturbed one."""
    clean = np.stack([blocks((40, 48)), 255 - blocks((40, 48)), blocks((40, 48)) / 2], -1)
    before = noisy(clean, 20)
    plan = gr.plan_denoising(before, lam=method, channel_axis=-1, backend="numpy")
    after = gr.run_plan(plan, before, channel_axis=-1, backend="numpy").value
    rule = gr.denoise_image(before, channel_axis=-1, backend="numpy", passes=1)
    assert psnr(after, clean) > psnr(rule, clean) - 0.5
    assert plan.max_iter == 1


@pytest.mark.parametrize(
    "settings", [{}, {"p": 1}, {"weights": gr.weights.bilateral(2.0, 60.0), "max_iter": 3}], ids=str
)
def test_solving_a_plan_is_running_it(settings: dict) -> None:
    """What the search looks at is what comes out in the end."""
    before = noisy(blocks(), 20)
    mask = np.ones(before.shape, bool)
    mask[3:9, 30:] = False
    plan = gr.plan_denoising(before, mask=mask, passes=1, **settings)
    run = gr.run_plan(plan, before, mask=mask, **NUMPY).value
    cells = Raster.of(before).pixels("float64")
    solved = planning.solve(plan, cells, mask, solver="jacobi", **NUMPY).value[..., 0]
    assert np.array_equal(run[mask], solved[mask])


def test_settings_of_the_search_are_those_of_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    solve = planning.solve
    monkeypatch.setattr(planning, "solve", lambda *a, **k: seen.append(k) or solve(*a, **k))
    before = noisy(blocks((24, 24), 8), 20)
    settings = {"backend": "numpy", "memory": 10**9, "solver": gr.Jacobi(damping=0.5)}
    gr.plan_denoising(before, p=1, lam="discrepancy", dtype="float64", max_iter=20, **settings)
    assert seen
    assert [call for call in seen if {name: call[name] for name in settings} != settings] == []
    assert [call["dtype"] for call in seen if call["dtype"] != np.float64] == []


@pytest.mark.parametrize("p", [0.5, 1.0, 1.5])
def test_the_rule_grows_with_what_there_is_to_keep(p: float) -> None:
    before = noisy(blocks(), 20)
    rule = gr.plan_denoising(before, p=p, sigma=20.0).lam
    flat = gr.plan_denoising(noisy(np.full((48, 64), 100.0), 20), p=p, sigma=20.0).lam
    assert flat == pytest.approx(2.2 * 0.3 ** (0.4 * p**2) * 20 ** (p - 2), rel=1e-9)
    assert rule > flat
    # three equal channels are one, and its result is given to all
    colour = np.stack([before] * 3, -1)
    plan = gr.plan_denoising(colour, p=p, sigma=20.0, channel_axis=-1)
    assert plan.same == (0, 0, 0)
    assert plan.groups[0][1].lam == pytest.approx(rule)
    same = [
        gr.denoise_image(f, p=p, sigma=20.0, eps=0.3, channel_axis=axis, **NUMPY)
        for f, axis in ((before, None), (colour, -1))
    ]
    assert all(np.array_equal(same[1][..., i], same[0]) for i in range(3))
    # coupled with a given lam: the norm of the gradient is sqrt(3) as large, and so is that of the difference
    by_hand = [
        gr.denoise_image(f, p=p, lam=lam, eps=e, channel_axis=axis, **NUMPY)
        for f, lam, e, axis in (
            (before, rule, 0.3, None),
            (colour, rule * 3 ** (p / 2 - 1), 0.3 * math.sqrt(3), -1),
        )
    ]
    assert np.abs(by_hand[1][..., 0] - by_hand[0]).max() < 1e-9


def test_every_parameter_is_explained() -> None:
    before = noisy(blocks(), 20)
    found = lines(gr.plan_denoising(before))
    rows = {"noise", "weights", "patch", "compared", "h", "window", "averaging", "p", "lam", "iterations", "groups"}
    assert set(found) == rows
    assert "blurred by" in found["compared"] and "3x3 patches" in found["averaging"]
    assert "estimated from the image" in found["noise"]
    assert all("rule" in found[name] for name in ("weights", "patch", "h", "window", "lam", "iterations"))
    assert "default" in found["p"]
    given = {"sigma": 20.0, "p": 1.5, "lam": 0.25, "radius": 2, "max_iter": 7, "tol": 1e-3, "eps": 0.5}
    found = lines(gr.plan_denoising(before, weights=gr.weights.bilateral(2.0, 60.0), **given))
    assert set(found) == {"noise", "weights", "reach", "window", "p", "lam", "iterations", "tol", "eps", "groups"}
    assert "only after one sweep" in found.pop("groups")
    assert all(line.endswith("given") for line in found.values())
    told = {"noise": "20", "reach": "60", "window": "5x5", "p": "1.5", "lam": "0.25"}
    assert {name: found[name] for name, value in told.items() if value not in found[name]} == {}
    found = lines(gr.plan_denoising(before, p=1))
    assert "size of the gradient" in found["lam"]
    assert found["tol"].endswith("rule") and found["eps"].endswith("rule")
    found = lines(gr.plan_denoising(before, weights=gr.weights.patch(1, 60.0), lam=np.ones(before.shape)))
    assert "decides nothing" in found["noise"]
    assert "a map" in found["lam"] and "3x3, flat" in found["patch"]
    assert "no noise was found" in gr.plan_denoising(blocks()).explain()
    columns = {
        line.index(line.split("  ")[-1].strip()) for line in gr.plan_denoising(before, p=1).explain().splitlines()
    }
    assert len(columns) == 1


@pytest.mark.parametrize(
    ("call", "says"),
    [
        ({"lam": "best"}, "one of discrepancy, sure, j-invariance, got 'best'"),
        ({"lam": "sure", "sigma": 0, "weights": gr.weights.bilateral(2.0, 60.0)}, "nothing to choose lam from"),
        ({"lam": "sure", "sigma": 0, "weights": gr.weights.constant()}, "nothing to choose lam from"),
        ({"lam": "sure", "backend": "cuda"}, "unknown backend"),
        ({"lam": "sure", "solver": "luck"}, 'solver must be "jacobi"'),
    ],
)
def test_a_wrong_wish_gets_a_sentence(call: dict, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        gr.plan_denoising(noisy(blocks((12, 12), 4), 20), **{"backend": "numpy", **call})


def test_nothing_is_searched_where_nothing_is_done() -> None:
    plan = gr.plan_denoising(noisy(blocks(), 20), p=1, lam="sure", max_iter=0, backend="nowhere")
    assert plan.max_iter == 0
    assert gr.plan_denoising(blocks(), lam="sure", backend="nowhere").lam == math.inf


@pytest.mark.parametrize("sigma", [10, 40])
@pytest.mark.parametrize("name", ["camera", "kodim08", "bsd68_044"])
def test_photographs(name: str, sigma: int, data_folder) -> None:
    """Total variation: at most 0.3 dB below the best lam by the rule and 0.03 by SURE, measured on nine pictures."""
    io = pytest.importorskip("skimage.io", reason="scikit-image is not installed")
    from skimage import color

    clean = io.imread(data_folder / "images" / f"{name}.png")
    clean = (255 * color.rgb2gray(clean) if clean.ndim == 3 else clean)[100:300, 100:300].astype(np.float32)
    before = clean + rng(0).standard_normal(clean.shape).astype(np.float32) * sigma
    plan = gr.plan_denoising(before, p=1, sigma=sigma)
    searched = gr.plan_denoising(before, p=1, sigma=sigma, lam="sure")

    def quality(lam: float) -> float:
        return psnr(gr.run_plan(replace(plan, lam=lam), before).value, clean)

    best = max(quality(k / sigma) for k in np.geomspace(1, 6, 15))
    assert quality(searched.lam) > best - 0.08
    assert quality(plan.lam) > best - 0.4
