"""Polygonal curves: closed forms, the choice of the fidelity, batches, simplification and corners."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.measure import approximate_polygon, find_contours

import gpureg as gr
from gpureg.curves.curves import curves_of
from gpureg.curves.denoise import denoised
from gpureg.curves.simplify import simplified
from gpureg.metrics import curve_area, curve_hausdorff


def ring(n, radius=1.0):
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def star(n):
    """n vertices evenly along a star of five points."""
    radius = np.where(np.arange(11) % 2, 0.5, 1.0)
    corners = radius[:, None] * ring(10)[np.arange(11) % 10]
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0, length[-1], n, endpoint=False)
    return np.stack([np.interp(at, length, corners[:, k]) for k in range(2)], axis=1)


def noisy(curve, sigma, seed=0):
    return curve + np.random.default_rng(seed).normal(0, sigma, curve.shape)


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


@pytest.mark.parametrize("p", [2, 1])
def test_a_regular_polygon_shrinks_by_the_closed_form(device, p):
    # numerics: p = 2 has the radius lam / (lam + 2 mu), mu = 4 sin^2(pi/n); p = 1 loses sqrt(2 mu) / lam
    mu, lam = 4 * np.sin(np.pi / 12) ** 2, 1.7
    expected = 3 * lam / (lam + 2 * mu) if p == 2 else 3 - np.sqrt(2 * mu) / lam
    value = gr.denoise_curve(ring(12, 3.0), p=p, lam=lam, backend=device, dtype="float64", tol=1e-9)
    # a gap of 1e-9 of the energy bounds the distance by sqrt(2 gap / lam)
    assert np.abs(np.linalg.norm(value, axis=1) - expected).max() < 3e-4


def test_laplacian_smoothing_shrinks_and_the_fit_term_holds():
    # figure 5: 30 iterations with lam = 0, 100 with lam > 0
    curve = noisy(ring(100, 3.0), 0.02)
    area = curve_area(ring(100, 3.0))
    free = gr.denoise_curve(curve, lam=0, max_iter=30, solver=gr.Jacobi(damping=1))
    held = gr.denoise_curve(curve, lam=0.1, max_iter=100, solver="jacobi")
    # a step takes the radius r to r cos(2 pi / n), or to the mean of that, by 4, and of the first, by lam
    assert curve_area(free) / area == pytest.approx(np.cos(2 * np.pi / 100) ** 60, abs=0.003)
    radius = 1.0
    for _ in range(100):
        radius = (0.1 + 4 * np.cos(2 * np.pi / 100) * radius) / 4.1
    assert curve_area(held) / area == pytest.approx(radius**2, abs=0.003)


@pytest.mark.parametrize("name", ["ring 200", "ring 2000", "star 400"])
@pytest.mark.parametrize("sigma", [0.005, 0.02, 0.05])
def test_the_noise_chooses_nearly_the_best_fidelity(name, sigma):
    kind, n = name.split()
    truth = {"ring": ring, "star": star}[kind](int(n))
    curve = noisy(truth, sigma)
    error = rms(gr.denoise_curve(curve) - truth)
    best = min(rms(gr.denoise_curve(curve, lam=lam) - truth) for lam in np.logspace(-3, 1, 9))
    assert error < 1.1 * best  # measured: 1.08 at most
    assert error < 0.65 * sigma  # measured: 0.62 for the star, whose corners cost, to 0.13


@pytest.mark.parametrize("p", [1.0, 1.5, 3.0])
def test_other_degrees_take_a_fidelity_that_smooths_alike(p):
    truth = ring(500)
    curve = noisy(truth, 0.02)
    assert rms(gr.denoise_curve(curve, p=p) - truth) < 0.5 * 0.02  # measured: 0.37 at p = 1


def test_curves_without_noise_come_back():
    square = np.array([[0.0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [1, 2], [0, 2], [0, 1]])
    with pytest.warns(UserWarning, match="noise of the curve cannot be told"):
        np.testing.assert_array_equal(gr.denoise_curve(np.tile([3.0, 4.0], (9, 1))), np.tile([3.0, 4.0], (9, 1)))
    assert rms(gr.denoise_curve(ring(400)) - ring(400)) < 1e-5
    assert gr.denoise_curve(square.astype(np.float32), sigma=0.0).dtype == np.float32


def test_batches_are_the_curves_one_by_one():
    cells = [noisy(ring(n, 5.0) + np.array([0, k * 20]), 0.05 * (k + 1), k) for k, n in enumerate((40, 77, 200))]
    cells[1] = np.concatenate([cells[1], cells[1][:1]])
    together = gr.denoise_curve(cells)
    assert [value.shape for value in together] == [cell.shape for cell in cells]
    apart = [np.abs(value - gr.denoise_curve(cell)).max() for cell, value in zip(cells, together, strict=True)]
    # each run within 1e-6 of its energy, most of which is the largest curve's; the noise is 0.05 and more
    assert [distance for distance in apart if not distance < 1e-3] == []
    np.testing.assert_array_equal(together[1][0], together[1][-1])
    simple = gr.simplify_curve(cells)
    assert [value.tolist() for value in simple] == [gr.simplify_curve(cell).tolist() for cell in cells]


def test_outlines_of_a_picture():
    y, x = np.mgrid[:64, :64]
    cells = ((x - 15) ** 2 + (y - 20) ** 2 < 100) | ((x - 45) ** 2 + (y - 40) ** 2 < 150)
    outlines = find_contours(cells.astype(float), 0.5)
    smooth = gr.denoise_curve(outlines)
    assert len(smooth) == 2
    # the staircase of half pixels goes: the disks' areas stay within 2 percent
    before, after = ([abs(curve_area(curve[:-1])) for curve in curves] for curves in (outlines, smooth))
    assert after == pytest.approx(before, rel=0.02)


def test_open_curves_keep_their_ends_and_fixed_vertices_stay():
    truth = np.stack([np.linspace(0, 3, 150), np.sin(np.linspace(0, 3, 150))], axis=1)
    curve = noisy(truth, 0.03)
    fixed = np.zeros(150, bool)
    fixed[40:60] = True
    value = gr.denoise_curve(curve, closed=False, fixed=fixed)
    np.testing.assert_array_equal(value[[0, -1]], curve[[0, -1]])
    np.testing.assert_array_equal(value[fixed], curve[fixed])
    assert rms((value - truth)[~fixed]) < 0.5 * 0.03
    moved = gr.denoise_curve(curve, closed=False, keep_ends=False)
    assert (moved[[0, -1]] != curve[[0, -1]]).all()


@pytest.mark.filterwarnings("ignore:.*crosses itself")
@pytest.mark.parametrize("options", [{}, {"p": 0.5, "lam": 1.0, "max_iter": 50}], ids=str)
def test_repeated_points_do_no_harm(options):
    curve = np.repeat(noisy(star(100), 0.01), 2, axis=0)
    assert np.isfinite(gr.denoise_curve(curve, **options)).all()


def test_repeated_points_do_not_change_what_is_kept():
    once = gr.simplify_curve(star(100))
    np.testing.assert_array_equal(gr.simplify_curve(np.repeat(star(100), 3, axis=0)), once)


def test_it_goes_with_motions_of_the_plane():
    curve = noisy(star(300), 0.02)
    turn, away = np.array([[0.6, -0.8], [0.8, 0.6]]), np.array([4e5, 5e6])
    here = gr.denoise_curve(curve)
    back = {
        "turned": gr.denoise_curve(curve @ turn.T) @ turn,
        "larger": gr.denoise_curve(curve * 1e3) / 1e3,
        "elsewhere": gr.denoise_curve(curve + away) - away,
    }
    # the estimate of the noise is of coordinates: turned by an angle the fidelity may be the next of ten a decade
    assert [motion for motion, value in back.items() if not np.abs(value - here).max() < 6e-3] == []
    kept = {len(gr.simplify_curve(x)) for x in (star(300), star(300) @ turn.T, star(300) * 1e3)}
    assert kept == {10}


@pytest.mark.parametrize("filter", ["directions", "positions"])
def test_corners_are_kept(filter):
    curve = star(400)
    kept = gr.simplify_curve(curve, filter=filter, n_vertices=40)
    assert len(kept) == 40
    corners = np.where(np.arange(10) % 2, 0.5, 1.0)[:, None] * ring(10)
    gap = np.linalg.norm(corners[:, None] - kept[None], axis=2).min(axis=1)
    step = 2 * 5 * np.linalg.norm(corners[0] - corners[1]) / 400
    # the curve itself has no vertex nearer than half a step to some corners
    assert gap.max() <= (1 if filter == "directions" else 2) * step
    if filter == "directions":
        assert len(gr.simplify_curve(curve)) == 10


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("count", [3, 10, 57])
def test_a_number_of_vertices_is_that_number(closed, count):
    curve = noisy(star(200), 0.005)
    [found] = simplified(curve, closed=closed, n_vertices=count, max_iter=300).parts
    assert len(found.points) == len(np.unique(found.kept)) == count
    np.testing.assert_array_equal(found.points, curve[found.kept])
    assert (np.diff(found.kept) > 0).all()
    if not closed:
        assert found.kept[0] == 0
        assert found.kept[-1] == 199


@pytest.mark.filterwarnings("ignore:.*crosses itself")
@pytest.mark.parametrize(("filter", "far"), [("directions", 4), ("positions", 8), (None, 3)])
def test_the_coast_of_great_britain(data_folder, filter, far):
    coast = np.loadtxt(data_folder / "curves" / "great_britain_ne10m.csv", delimiter=",", skiprows=1)
    coast[:, 0] *= np.cos(np.radians(coast[:, 1].mean()))
    kept = gr.simplify_curve(coast, filter=filter)
    assert len(kept) < len(coast) / 2
    assert curve_area(kept) == pytest.approx(curve_area(coast), rel=0.01)
    # Douglas and Peucker's, which bounds the distance itself, at the same number: measured 2.7, 5.1 and 2 times
    low, high = 1e-5, 1.0
    for _ in range(14):
        middle = np.sqrt(low * high)
        peer = approximate_polygon(np.concatenate([coast, coast[:1]]), middle)[:-1]
        low, high = (middle, high) if len(peer) > len(kept) else (low, middle)
    assert curve_hausdorff(coast, kept) < far * curve_hausdorff(coast, peer)


def test_what_was_chosen_is_told():
    found = denoised(curves_of([noisy(ring(300), 0.02), ring(50)], True))
    assert found.sigma[0] == pytest.approx(0.02, rel=0.1)
    assert found.lam[0] < found.lam[1]
    assert len(found.results) == 1
    assert denoised(np.ones((5, 2)), closed=True).results == ()


LINE = np.stack([np.arange(9.0), np.sin(np.arange(9.0))], axis=1)
GAP = ring(40)[:37]  # four segments are missing

ENDS = {
    "an outline": (ring(40), True, "near"),
    "one that repeats its first vertex": (np.concatenate([ring(40), ring(40)[:1]]), True, "repeated"),
    "nearly": (np.concatenate([ring(40), ring(40)[:1] + 1e-8]), True, "repeated"),
    "not nearly enough": (np.concatenate([ring(40), ring(40)[:1] + 1e-6]), True, "near"),
    "a track": (LINE, False, "apart"),
    "an outline with a gap": (GAP, False, "apart"),
    "two segments of three": (ring(40)[:39], True, "near"),
    "a triangle": (ring(3), True, "near"),
    "two vertices": (LINE[:2], False, "few"),
    "there and back": (LINE[[0, 1, 0]], False, "few"),
    "on one point": (np.ones((5, 2)), True, "repeated"),
    "every vertex thirty times": (np.repeat(ring(40), 30, axis=0), True, "near"),
}


@pytest.mark.parametrize("name", ENDS)
def test_closed_or_open(name):
    points, closed, why = ENDS[name]
    [ends] = curves_of(points).ends
    assert (ends.closed, ends.why) == (closed, why)
    assert ends.gap == pytest.approx(np.linalg.norm(points[-1] - points[0]), abs=1e-15)
    assert ends.describe().startswith("closed" if closed else "open")
    asked = [False] if why == "few" else [True, False]
    given = [curves_of(points, shut).ends for shut in asked]
    assert [[(ends.closed, ends.why) for ends in found] for found in given] == [[(shut, "given")] for shut in asked]


def test_the_rule_is_that_of_each_curve_and_decides_the_result():
    island, track = noisy(ring(60), 0.02), noisy(LINE, 0.02)
    both = gr.denoise_curve([island, track], lam=1.0, solver="jacobi", max_iter=20, dtype="float64")
    for value, curve, closed in zip(both, (island, track), (True, False), strict=True):
        alone = gr.denoise_curve(curve, closed=closed, lam=1.0, solver="jacobi", max_iter=20, dtype="float64")
        np.testing.assert_allclose(value, alone, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(both[1][[0, -1]], track[[0, -1]])
    simple = gr.simplify_curve([island, track], lam=1.0, max_iter=100)
    np.testing.assert_array_equal(simple[1][[0, -1]], track[[0, -1]])


def test_a_first_vertex_repeated_to_rounding_is_put_back():
    curve = noisy(ring(60), 0.02)
    again = np.concatenate([curve, curve[:1] + 1e-10])
    value = gr.denoise_curve(again)
    np.testing.assert_array_equal(value, np.concatenate([value[:-1], value[:1]]))
    np.testing.assert_array_equal(value[:-1], gr.denoise_curve(curve))
    assert gr.metrics.curve_length(again) == pytest.approx(gr.metrics.curve_length(curve, closed=True))
    assert gr.metrics.curve_length(LINE) == gr.metrics.curve_length(LINE, closed=False)
    # of two curves the one of more vertices says it
    corners = GAP[[0, 18, 36]]
    assert curve_hausdorff(corners, GAP) == curve_hausdorff(GAP, corners) == curve_hausdorff(GAP, corners, closed=False)


CURVE = ring(20)

WRONG = [
    (lambda: gr.denoise_curve(CURVE, sigma=True), TypeError, "denoise_curve: sigma must be a number, got True"),
    (lambda: gr.denoise_curve(CURVE, max_iter="3"), TypeError, "max_iter must be an integer, got '3'"),
    (lambda: gr.denoise_curve(CURVE, lam=np.inf, tol=-1), ValueError, "tol must be finite and >= 0"),
    (lambda: gr.denoise_curve(CURVE, keep_ends=1), TypeError, "keep_ends must be True or False"),
    (lambda: gr.denoise_curve(CURVE, lam="much"), TypeError, "lam must be a number, got 'much'"),
    (lambda: gr.metrics.curve_length(CURVE, closed=1), TypeError, "curve_length: closed must be True or False"),
    (lambda: gr.skeleton(CURVE, detail=-1), ValueError, "skeleton: detail must be >= 0, got -1"),
    (lambda: gr.denoise_curve([]), ValueError, "list is empty"),
    (lambda: gr.denoise_curve(CURVE[:2], closed=True), ValueError, "a closed one needs 3"),
    (lambda: gr.denoise_curve(CURVE[:1]), ValueError, "an open one needs 2"),
    (lambda: gr.denoise_curve([CURVE, CURVE[:1]], closed=False), ValueError, "curve 1 has 1 vertices"),
    (lambda: gr.denoise_curve([CURVE, np.ones((5, 3))]), ValueError, "same dimension"),
    (lambda: gr.denoise_curve(CURVE * np.nan), ValueError, "finite"),
    (lambda: gr.denoise_curve(CURVE, closed=1), TypeError, "True or False"),
    (lambda: gr.denoise_curve(CURVE, p=0), ValueError, "p must"),
    (lambda: gr.denoise_curve(CURVE, sigma=-1), ValueError, "sigma must"),
    (lambda: gr.denoise_curve(CURVE, lam=np.ones(3)), ValueError, "one per vertex"),
    (lambda: gr.denoise_curve(CURVE, fixed=[1, 2]), ValueError, "fixed must be boolean"),
    (lambda: gr.simplify_curve(CURVE, filter="angles"), ValueError, '"directions" or "positions"'),
    (lambda: gr.simplify_curve(CURVE, function="positions"), TypeError, "'function' is called filter now"),
    (lambda: gr.simplify_curve(CURVE, lam=1, n_vertices=5), ValueError, "not both"),
    (lambda: gr.simplify_curve(CURVE, lam=0), ValueError, "lam must be > 0"),
    (lambda: gr.simplify_curve(CURVE, n_vertices=2), ValueError, "at least 3"),
    (lambda: gr.simplify_curve(CURVE, n_vertices=7.5), TypeError, "integer"),
]


@pytest.mark.parametrize(("call", "error", "message"), WRONG)
def test_a_wrong_call_says_what_is_allowed(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_few_vertices_are_shape_not_noise():
    """A square stays one, unless the noise is told."""
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    with pytest.warns(UserWarning, match="cannot be told from fewer than 12 different vertices"):
        assert np.array_equal(gr.denoise_curve(square), square)
    assert not np.array_equal(gr.denoise_curve(square, sigma=0.1), square)
