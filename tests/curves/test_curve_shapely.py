"""Lines and polygons of shapely in and out."""

from __future__ import annotations

import numpy as np
import pytest

import gpureg as gr

shapely = pytest.importorskip("shapely", reason="shapely, an extra, is not installed")

DISC = shapely.Point(0, 0).buffer(1, quad_segs=32)
RING = shapely.Polygon(DISC.exterior.coords, [shapely.Point(0, 0).buffer(0.9, quad_segs=16).exterior.coords])
LINE = shapely.LineString([(0, 0, 5), (1, 0, 6), (2, 1e-5, 7), (3, 0, 8), (3, 1, 9)])


# the line has too few vertices to tell its noise
@pytest.mark.filterwarnings("ignore:the noise of 1 of")
@pytest.mark.parametrize("kind", ["LineString", "LinearRing", "Polygon", "MultiPolygon", "GeometryCollection"])
def test_the_same_kind_comes_out(kind):
    point = shapely.Point(9, 9)
    shape = {
        "LineString": LINE,
        "LinearRing": DISC.exterior,
        "Polygon": RING,
        "MultiPolygon": shapely.MultiPolygon([RING, shapely.affinity.translate(RING, 5)]),
        "GeometryCollection": shapely.GeometryCollection(
            [RING, point, shapely.affinity.translate(LINE, 5), shapely.LineString()]
        ),
    }[kind]
    for value in (gr.denoise_curve(shape, backend="numpy"), gr.simplify_curve(shape, valid=True, tolerance=0.02)):
        assert value.geom_type == kind and value.is_valid
        assert not hasattr(shape, "geoms") or [g.geom_type for g in value.geoms] == [g.geom_type for g in shape.geoms]
    count = shapely.get_num_coordinates(gr.simplify_curve(shape, valid=True, tolerance=0.02))
    assert count < shapely.get_num_coordinates(shape)


def test_it_is_that_of_the_arrays_and_heights_stay_with_their_vertices():
    rows = shapely.get_coordinates(DISC.exterior)[:-1]
    rows += np.random.default_rng(0).normal(0, 0.002, rows.shape)
    value = gr.denoise_curve(shapely.LinearRing(rows), backend="numpy")
    expected = gr.denoise_curve(rows, closed=True, backend="numpy")
    np.testing.assert_array_equal(shapely.get_coordinates(value)[:-1], expected)
    assert list(gr.simplify_curve(LINE).coords) == [(0, 0, 5), (3, 0, 8), (3, 1, 9)]


def test_what_cannot_be_treated_stays():
    spot = shapely.LineString([(1, 1), (1, 1)])
    with pytest.warns(UserWarning, match="object 1: its vertices coincide"):
        one, two = gr.simplify_curve([LINE, spot])
    assert two.equals(spot) and len(one.coords) == 3
    with pytest.raises(ValueError, match="no line or ring that can be treated"):
        gr.denoise_curve(shapely.Point(0, 0))
    with pytest.raises(TypeError, match="arrays, or objects of shapely, not both"):
        gr.denoise_curve([LINE, np.ones((4, 2))])
    with pytest.raises(ValueError, match="says by itself which curves are closed"):
        gr.denoise_curve(LINE, closed=True)
    with pytest.raises(ValueError, match="one polygon without holes, got 2 curves"):
        gr.skeleton(RING)
