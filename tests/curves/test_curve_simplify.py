"""Simplifying curves by heights: corners, density, numbers of vertices, and curves that must not cross."""

from __future__ import annotations

import numpy as np
import pytest

import gpureg as gr
from gpureg.curves.crossings import is_inside
from gpureg.curves.simplify import simplified
from gpureg.metrics import curve_area, curve_hausdorff

ANGLE = np.linspace(0, 2 * np.pi, 10, endpoint=False)
SHAPES = {
    "square": [[0, 0], [1, 0], [1, 1], [0, 1]],
    "triangle": [[0, 0], [4, 0], [1, 2]],
    "L": [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]],
    "T": [[0, 0], [3, 0], [3, 1], [2, 1], [2, 3], [1, 3], [1, 1], [0, 1]],
    "strip": [[0, 0], [10, 0], [10, 1], [0, 1]],
    "star": (np.where(np.arange(10) % 2, 0.5, 1.0)[:, None] * np.stack([np.cos(ANGLE), np.sin(ANGLE)], 1)).tolist(),
    "24 sides": [[np.cos(a), np.sin(a)] for a in np.arange(24) * np.pi / 12],
}


def dense(corners, times, closed=True):
    """The same shape with vertices along its sides."""
    ends = np.roll(corners, -1, axis=0)
    sides = list(zip(corners, ends, strict=True))
    parts = [np.linspace(a, b, times, endpoint=False) for a, b in (sides if closed else sides[:-1])]
    return np.concatenate(parts if closed else [*parts, corners[-1:]])


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("valid", [True, False])
def test_corners_stay_at_every_density(name, closed, valid):
    corners = np.array(SHAPES[name], float)
    for times in (1, 2, 7, 20):
        curve = dense(corners, times, closed)
        # turned, large and far from the origin: sides are straight to rounding only
        turned = curve @ [[0.6, 0.8], [-0.8, 0.6]] * 1e3 + [4e5, 5e6]
        for points in (curve, turned, np.repeat(curve, 3, axis=0)):
            found = gr.simplify_curve(points, closed=closed, valid=valid)
            assert len(found) == len(corners)
        assert {tuple(p) for p in gr.simplify_curve(curve, closed=closed).tolist()} == set(map(tuple, corners.tolist()))


@pytest.mark.parametrize("valid", [True, False])
@pytest.mark.parametrize("name", ["iceland_ne10m", "mpeg7_octopus_3"])
def test_simplifying_twice_changes_nothing(data_folder, name, valid):
    curve = np.loadtxt(data_folder / "curves" / f"{name}.csv", delimiter=",", skiprows=1)
    options = {"tolerance": 0.003, "closed": True, "valid": valid}
    [once] = simplified(curve, **options).parts
    [twice] = simplified(once.points, **options).parts
    [between] = simplified(dense(curve, 2), **options).parts
    np.testing.assert_array_equal(twice.points, once.points)
    np.testing.assert_array_equal(between.points, once.points)
    assert len(once.points) < len(curve) / 3
    assert curve_area(once.points) == pytest.approx(curve_area(curve), rel=0.02)
    # a height is not a distance: measured up to 1.9 times
    diagonal = np.linalg.norm(np.ptp(curve, axis=0))
    assert curve_hausdorff(curve, once.points, closed=True) < 2 * 0.003 * diagonal


def test_the_order_is_that_of_the_heights_of_the_moment():
    """Against a loop that measures all heights again each time."""
    rng = np.random.default_rng(0)
    curve = np.cumsum(rng.normal(size=(60, 3)), axis=0)
    kept = list(range(60))
    while len(kept) > 20:
        x = curve[kept]
        along, up = x[2:] - x[:-2], x[1:-1] - x[:-2]
        share = np.clip((along * up).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
        del kept[1 + int(np.argmin(np.linalg.norm(up - share[:, None] * along, axis=1)))]
    [found] = simplified(curve, closed=False, n_vertices=20).parts
    assert found.kept.tolist() == kept


def test_a_number_of_vertices_of_each_of_many():
    rng = np.random.default_rng(0)
    curves = [np.cumsum(rng.normal(size=(n, 2)), axis=0) for n in (50, 80, 12, 300)]
    found = simplified(curves, closed=False, n_vertices=20)
    assert [len(part.points) for part in found.parts] == [20, 20, 12, 20]
    alone = [simplified(curve, closed=False, n_vertices=20).parts[0].kept.tolist() for curve in curves]
    assert [part.kept.tolist() for part in found.parts] == alone


def test_valid_curves_do_not_cross(data_folder):
    coast = np.loadtxt(data_folder / "curves" / "great_britain_ne10m.csv", delimiter=",", skiprows=1)
    free, held = (simplified(coast, closed=True, tolerance=0.004, valid=valid) for valid in (False, True))
    assert free.crossings[0] == 0 < free.crossings[1]
    assert held.crossings == (0, 0, 0, True) and held.refused > 0
    with pytest.warns(UserWarning, match="crosses itself at .* places, the input at 0: valid=True prevents"):
        gr.simplify_curve(coast, closed=True, tolerance=0.004)
    assert len(held.parts[0].points) < 1.05 * len(free.parts[0].points)


def test_holes_stay_inside_and_common_borders_common():
    rng = np.random.default_rng(0)
    # a hole in a peak that is lower than the tolerance
    shell = np.array([[-1, -1], [1, -1], [1, 0], [0.2, 0], [0, 0.5], [-0.2, 0], [-1, 0]])
    hole = np.array([[-0.02, 0.3], [0.02, 0.3], [0, 0.36]])
    free, held = (simplified([shell, hole], closed=True, tolerance=0.25, valid=valid).parts for valid in (False, True))
    assert [is_inside(hole, part[0].points).all() for part in (free, held)] == [False, True]
    # three areas that meet in a point
    t = np.linspace(0, 1, 60)
    away = rng.normal(0, 0.01, (3, 60))
    away[:, 0] = 0
    ways = [
        np.stack([t * np.cos(angle) + w, t * np.sin(angle) + w], axis=1)
        for angle, w in zip((0.1, 2.2, 4.3), away, strict=True)
    ]
    areas = [np.concatenate([a, b[:0:-1]]) for a, b in zip(ways, ways[1:] + ways[:1], strict=True)]
    parts = simplified(areas, closed=True, tolerance=0.03, valid=True).parts
    kept = [{tuple(p) for p in part.points.tolist()} for part in parts]
    for k, way in enumerate(ways):
        border = {tuple(p) for p in way.tolist()}
        assert kept[k] & border == kept[k - 1] & border
        assert len(kept[k] & border) < 30 and tuple(way[0]) in kept[k] and tuple(way[-1]) in kept[k]
    # a line over another one
    lines = [np.array([[0, 0], [1, 1], [2, 0]]), np.array([[0.9, 0.5], [1, 0.6], [1.1, 0.5]])]
    with pytest.warns(UserWarning, match="a curve keeps 3 vertices instead of 2"):
        over, under = gr.simplify_curve(lines, closed=False, n_vertices=2, valid=True)
    assert (len(over), len(under)) == (3, 2)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda c: gr.simplify_curve(np.ones((5, 2))), "the curve has no shape to simplify: its vertices coincide"),
        (lambda c: gr.simplify_curve([c, np.ones((5, 2))]), "curve 1 has no shape to simplify"),
        (lambda c: gr.simplify_curve(c, tolerance=-1), "tolerance must be finite and >= 0"),
        (lambda c: gr.simplify_curve(c, tolerance=0.1, n_vertices=5), "give tolerance or n_vertices"),
        (lambda c: gr.simplify_curve(c, tolerance=0.1, p=0.5), "p is for method='process'"),
        (lambda c: gr.simplify_curve(c, method="heights", lam=1.0), "lam is for method='process'"),
        (lambda c: gr.simplify_curve(c, method="process", tolerance=0.1), "tolerance is for method='heights'"),
        (lambda c: gr.simplify_curve(c, method="process", valid=True), "valid=True is for method='heights'"),
        (lambda c: gr.simplify_curve(c, method="corners"), '"heights" or "process"'),
        (lambda c: gr.simplify_curve(np.c_[c, c], valid=True), "valid=True is for curves in the plane"),
        (lambda c: gr.simplify_curve(c, backend="abacus"), "abacus"),
    ],
)
def test_a_wrong_call_says_what_is_allowed(call, words):
    with pytest.raises(ValueError, match=words):
        call(np.array(SHAPES["star"]))


def test_the_process_of_the_paper_is_asked_for_by_its_parameters():
    curve = dense(np.array(SHAPES["star"]), 20)
    by_name = gr.simplify_curve(curve, method="process", backend="numpy")
    for options in ({"p": 0.5}, {"lam": 3.0}, {"filter": "directions"}, {"norm": "edge"}, {"max_iter": 2000}):
        found = simplified(curve, backend="numpy", **options)
        assert found.method == "process" and found.parts[0].result is not None
        np.testing.assert_array_equal(found.parts[0].points, by_name)
    assert simplified(curve).method == "heights" and simplified(curve).parts[0].result is None
