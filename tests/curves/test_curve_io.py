"""Curves in and out of files: CSV, SVG and GeoJSON, with all else that these hold."""

from __future__ import annotations

import json

import numpy as np
import pytest

import gpureg as gr
from gpureg.curves.contents import CURVE_FORMATS, CurveInFile
from gpureg.curves.files import encode_curves
from gpureg.curves.svg import _subpaths

RNG = np.random.default_rng(6)


def curve(n: int, closed: bool, q: int = 0) -> CurveInFile:
    return CurveInFile(RNG.normal(size=(n, 2)), closed, RNG.normal(size=(n, q)))


def same(found, expected, more: bool = True) -> bool:
    return len(found) == len(expected) and all(
        np.array_equal(a.points, b.points) and a.closed == b.closed and (not more or np.array_equal(a.more, b.more))
        for a, b in zip(found, expected, strict=True)
    )


@pytest.mark.parametrize("kind", CURVE_FORMATS)
@pytest.mark.parametrize("closed", [[True], [False], [True, True, True], [True, False, True]])
def test_there_and_back(tmp_path, kind, closed):
    """To the bit in every format, new and put back into what was read."""
    path = tmp_path / f"a{kind}"
    curves = [curve(5 + k, shut) for k, shut in enumerate(closed)]
    gr.write_curves(path, curves)
    known = {"closed": closed[0]} if kind.startswith(".csv") and closed == [False] else {}
    found = gr.read_curves(path, **known)
    assert same(found.curves, curves)
    assert found.degrees == (kind in (".geojson", ".json", ".gpx"))
    other = [CurveInFile(3 * c.points[1:] + 1, c.closed, c.more[1:]) for c in found.curves]
    gr.write_curves(path, other, like=found)
    assert same(gr.read_curves(path, **known).curves, other)


@pytest.mark.parametrize("kind", CURVE_FORMATS)
def test_one_format_becomes_another(tmp_path, kind):
    curves = [curve(6, True), curve(4, False)]
    gr.write_curves(tmp_path / "a.svg", curves)
    found = gr.read_curves(tmp_path / "a.svg")
    gr.write_curves(tmp_path / f"b{kind}", found.curves, like=found)
    assert same(gr.read_curves(tmp_path / f"b{kind}").curves, curves)


SVG = """<?xml version="1.0"?>
<!-- drawn by hand -->
<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" width="10" viewBox="0 0 10 10">
  <style>.a { fill: red }</style>
  <defs><polygon points="0,0 1,0 1,1" transform="scale(2)"/></defs>
  <g class="a"><polygon id="one" points="0,0 4,0 4,4 0,0"/><circle r="3"/></g>
  <polyline points="1 2 3 4,5,6"/>
  <path d="M1,1 h2v2 H1z m5 5 1 0 0 1 -1 0 Z M 9 9 L 8.5,9.25"/>
  <use xlink:href="#one"/>
</svg>
"""


def test_svg_of_others(tmp_path):
    path = tmp_path / "a.svg"
    path.write_text(SVG, "utf-8")
    found = gr.read_curves(path)
    assert [(c.points.tolist(), c.closed) for c in found.curves] == [
        ([[0, 0], [4, 0], [4, 4]], True),
        ([[1, 2], [3, 4], [5, 6]], False),
        ([[1, 1], [3, 1], [3, 3], [1, 3]], True),
        ([[6, 6], [7, 6], [7, 7], [6, 7]], True),
        ([[9, 9], [8.5, 9.25]], False),
    ]
    moved = [CurveInFile(c.points + 1, c.closed, c.more) for c in found.curves]
    gr.write_curves(path, moved, like=found)
    assert same(gr.read_curves(path).curves, moved)
    text = path.read_text("utf-8")
    kept = ('class="a"', "fill: red", 'r="3"', 'id="one"', "xlink:href", 'viewBox="0 0 10 10"', "<svg xmlns=")
    assert [words for words in kept if words not in text] == []
    assert "ns0:" not in text


@pytest.mark.parametrize(
    ("d", "expected"),
    [
        ("M0 0L1 0 1 1Z", [([[0, 0], [1, 0], [1, 1]], True)]),
        ("m1 1 2 0 0 2", [([[1, 1], [3, 1], [3, 3]], False)]),
        ("M.5.5-1-1e1", [([[0.5, 0.5], [-1, -10]], False)]),
        ("M0,0 1,0 1,1 0,0z", [([[0, 0], [1, 0], [1, 1]], True)]),
        ("M0 0 H2 V2 h-1 v-1", [([[0, 0], [2, 0], [2, 2], [1, 2], [1, 1]], False)]),
        ("M1 1 L2 1 2 2 Z l0 5", [([[1, 1], [2, 1], [2, 2]], True), ([[1, 1], [1, 6]], False)]),
        ("", []),
    ],
)
def test_paths(d, expected):
    assert [(points.tolist(), closed) for points, closed in _subpaths(d)] == expected


GEO = {
    "type": "FeatureCollection",
    "name": "land",
    "bbox": [0, 0, 9, 9],
    "features": [
        {
            "type": "Feature",
            "properties": {"name": "É", "bbox": 3},
            "geometry": {
                "type": "Polygon",
                "coordinates": [[[0, 0], [9, 0], [9, 9], [0, 0]], [[1, 1], [2, 2], [2, 1], [1, 1]]],
            },
        },
        {"type": "Feature", "properties": None, "geometry": None},
        {
            "type": "Feature",
            "id": 7,
            "geometry": {
                "type": "GeometryCollection",
                "geometries": [
                    {"type": "Point", "coordinates": [1, 2]},
                    {"type": "LineString", "coordinates": [[0, 0, 100], [1, 1, 200]]},
                    {"type": "MultiPolygon", "coordinates": [[[[5, 5], [6, 5], [6, 6], [5, 5]]]]},
                    {"type": "MultiLineString", "coordinates": [[[0, 0], [1, 0]], [[2, 0], [3, 0]]]},
                ],
            },
        },
    ],
}


def test_geojson_of_others(tmp_path):
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps(GEO), "utf-8")
    found = gr.read_curves(path)
    assert [len(c.points) for c in found.curves] == [3, 3, 2, 3, 2, 2]
    assert [c.closed for c in found.curves] == [True, True, False, True, False, False]
    assert found.curves[2].more.tolist() == [[100], [200]]
    assert found.degrees
    moved = [CurveInFile(c.points + 1, c.closed, c.more) for c in found.curves]
    gr.write_curves(path, moved, like=found)
    written = json.loads(path.read_text("utf-8"))
    polygon = written["features"][0]["geometry"]["coordinates"]
    assert polygon == [[[1, 1], [10, 1], [10, 10], [1, 1]], [[2, 2], [3, 3], [3, 2], [2, 2]]]
    # a box of the old places would be wrong; what properties are called is not our affair
    assert "bbox" not in written and written["features"][0]["properties"] == {"name": "É", "bbox": 3}
    assert written["features"][1] == GEO["features"][1] and written["features"][2]["id"] == 7
    assert written["features"][2]["geometry"]["geometries"][1]["coordinates"] == [[1, 1, 100], [2, 2, 200]]
    projected = GEO | {"crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::27700"}}}
    path.write_text(json.dumps(projected), "utf-8")
    assert not gr.read_curves(path).degrees


def test_csv_of_others(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(
        "name,Y,X,curve\n1,0,0,5\n2,0,1,5\n3,1,1,5\n4,7,7,2\n5,8,8,2\n6,8,7,2\n".replace("name", "n"), "utf-8"
    )
    found = gr.read_curves(path)
    assert [c.points.tolist() for c in found.curves] == [[[0, 0], [1, 0], [1, 1]], [[7, 7], [8, 8], [7, 8]]]
    assert [c.more.tolist() for c in found.curves] == [[[1], [2], [3]], [[4], [5], [6]]]
    fewer = [CurveInFile(c.points[:3], c.closed, c.more[:3]) for c in found.curves]
    gr.write_curves(path, fewer, like=found)
    assert path.read_text("utf-8").splitlines()[:2] == ["X,Y,curve,n", "0,0,5,1"]
    assert same(gr.read_curves(path).curves, fewer)
    # blank lines, a first vertex that is repeated, no header
    path.write_text("0 0\n1 0\n1 1\n0 0\n\n5 5\n6 6\n", "utf-8")
    found = gr.read_curves(path)
    assert [(len(c.points), c.closed) for c in found.curves] == [(3, True), (2, False)]
    gr.write_curves(path, found.curves, like=found)
    assert path.read_text("utf-8") == "0 0\n1 0\n1 1\n0 0\n\n5 5\n6 6\n"
    opened = gr.read_curves(path, closed=False)
    assert [len(c.points) for c in opened.curves] == [4, 2]


def test_a_csv_says_which_curves_are_closed_as_well_as_it_can(tmp_path):
    path = tmp_path / "a.csv"
    t = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = np.stack([np.cos(t), np.sin(t)], axis=1)

    def write(*curves):
        path.write_text(
            "\n\n".join("\n".join(f"{x!r},{y!r}" for x, y in points.tolist()) for points in curves), "utf-8"
        )

    # without a vertex that is repeated, near ends are those of a closed curve
    write(ring, ring[:30])
    assert [(c.closed, c.ends.why) for c in gr.read_curves(path).curves] == [(True, "near"), (False, "apart")]
    # one that repeats its first vertex, to rounding, says that the other does not
    write(np.concatenate([ring, ring[:1] + 1e-9]), ring + 3)
    found = gr.read_curves(path).curves
    assert [(len(c.points), c.closed, c.ends.why) for c in found] == [(40, True, "repeated"), (40, False, "source")]
    assert [c.ends.why for c in gr.read_curves(path, closed=True).curves] == ["given", "given"]
    with pytest.raises(TypeError, match="read_curves: closed must be True or False"):
        gr.read_curves(path, closed=1)
    # a closed curve whose ends are far apart is told by its first vertex, and so are the others of its file
    write(ring, ring + 5)
    given = gr.read_curves(path)
    far = np.array([[0.0, 0], [1, 0], [1, 1], [2, 1], [2, 0], [3, 0], [3, 1], [4, 1], [4, 0], [5, 0], [5, 9]])
    wide = [CurveInFile(far, True, np.empty((11, 0))), CurveInFile(ring[:3], True, np.empty((3, 0)))]
    gr.write_curves(path, wide, like=given)
    assert same(gr.read_curves(path).curves, wide)
    gr.write_curves(path, wide)
    assert same(gr.read_curves(path).curves, wide)


def test_names_of_more():
    [line] = [CurveInFile(np.array([[0.0, 0], [1, 1]]), False, np.array([[0.5, 9], [0.25, 9]]))]
    assert encode_curves("a.csv", [line], names=("radius",)) == b"x,y,radius\n0,0,0.5\n1,1,0.25\n"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", "", "is empty"),
        ("a.csv", "x\n1\n2\n", "two coordinates"),
        ("a.csv", "x,y\n1,2\n", "curve 0 has 1 vertices, it needs 2"),
        ("a.svg", "<svg><polygon points='0,0 1,1'/></svg>", "curve 0 has 2 vertices, it needs 3"),
        ("a.csv", "x,y\n1,2\n3,nan\n5,6\n", "not finite"),
        ("a.csv", "x,y\n1,2\n3\n", "line 3"),
        ("a.svg", "<svg", "damaged, or no XML"),
        ("a.svg", "<html/>", "its root is not <svg>"),
        ("a.svg", "<svg xmlns='http://www.w3.org/2000/svg'><circle r='1'/></svg>", "contains no polygonal curve"),
        ("a.svg", "<svg><path d='M0 0 C1 1 2 2 3 3'/></svg>", "has C, a curved segment"),
        ("a.svg", "<svg><path d='M0 0 L1'/></svg>", "ends within a pair"),
        ("a.svg", "<svg><path d='L1 1'/></svg>", "begins with L"),
        ("a.svg", "<svg><path d='M0 0 & 1'/></svg>".replace("&", "?"), "'\\?' where a command or number"),
        ("a.svg", "<svg><path d='M0 0 1 1 Z 5'/></svg>", "after Z"),
        ("a.svg", "<svg><polygon points='0,0 1'/></svg>", "not pairs of numbers"),
        ("a.svg", "<svg><g transform='scale(2)'><polygon points='0,0 1,0 1,1'/></g></svg>", "under a transform"),
        ("a.geojson", "{", "damaged, or no JSON"),
        ("a.geojson", "[1]", "not an object with a type"),
        ("a.geojson", '{"type": "Topology"}', "a type 'Topology'"),
        ("a.geojson", '{"type": "LineString"}', "no list of coordinates"),
        ("a.geojson", '{"type": "Polygon", "coordinates": [1]}', "not nested"),
        ("a.geojson", '{"type": "LineString", "coordinates": [[1, 2], [3]]}', "not lists of numbers"),
        ("a.geojson", '{"type": "LineString", "coordinates": [[1], [3]]}', "two or three numbers"),
        ("a.geojson", '{"type": "Point", "coordinates": [1, 2]}', "contains no polygonal curve"),
        ("a.dxf", "0", "the extension of curves must be one of"),
    ],
)
def test_broken_files(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_text(content, "utf-8")
    with pytest.raises(gr.CurveError, match=words):
        gr.read_curves(path)


def test_what_files_say_themselves(tmp_path):
    gr.write_curves(tmp_path / "a.svg", [curve(4, True)])
    with pytest.raises(gr.CurveError, match="says by itself"):
        gr.read_curves(tmp_path / "a.svg", closed=True)
    with pytest.raises(gr.CurveError, match="no such file"):
        gr.read_curves(tmp_path / "b.svg")


ODD = {
    "type": "FeatureCollection",
    "features": [
        {"type": "Feature", "properties": {"v": 1}, "geometry": {"type": "LineString", "coordinates": coordinates}}
        for coordinates in (
            [[0, 0, 7], [1, 0, None], [2, 1, 9]],
            [[0, 0, 7], [1, 0], [2, 1]],
            [],
            [[3, 3]],
            [[3, 3], [3, 3], [3, 3]],
            [[0, 0], ["a", 1]],
            [[0, 0], [None, 1]],
        )
    ]
    + [
        {"type": "Feature", "properties": {"name": "bay"}, "geometry": {"type": "Polygon", "coordinates": rings}}
        for rings in (
            [[[0, 0], [4, 0], [4, 4], [1e-12, 0]], [[1, 1], [1, 1], [1, 1], [1, 1]]],
            [],
            [[[0, 0], [1, 1], [0, 0]]],
        )
    ]
    + [{"type": "Feature", "properties": None, "geometry": {"type": "Circle", "coordinates": [1, 2]}}, 7],
}


def test_what_cannot_be_treated_stays_and_is_named(tmp_path):
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps(ODD).replace('"v": 1', '"v": NaN'), "utf-8")
    with pytest.warns(UserWarning, match="a.geojson: 10 curves cannot be treated: feature 2: .*; and 5 more"):
        found = gr.read_curves(path)
    assert [len(c.points) for c in found.curves] == [3, 3, 3], "a ring closed to rounding repeats its vertex"
    named = [name.split(":")[0].split(" has")[0] for name in found.left]
    assert named == [f"feature {k}" for k in (2, 3, 4, 5, 6)] + [
        "feature 7 (bay), part 1", "feature 8 (bay)", "feature 9 (bay)", "feature 10", "feature 11"
    ]  # fmt: skip
    moved = [CurveInFile(c.points + 1, c.closed, c.more) for c in found.curves]
    gr.write_curves(path, moved, like=found)
    written = json.loads(path.read_text("utf-8"), parse_constant=pytest.fail)["features"]
    assert [f["geometry"]["coordinates"] for f in written[:2]] == [
        [[1, 1, 7], [2, 1], [3, 2, 9]], [[1, 1, 7], [2, 1], [3, 2]]
    ]  # fmt: skip
    assert [f["geometry"] for f in written[2:7]] == [f["geometry"] for f in ODD["features"][2:7]]
    assert written[7]["geometry"]["coordinates"] == [
        [[1, 1], [5, 1], [5, 5], [1, 1]], ODD["features"][7]["geometry"]["coordinates"][1]
    ]  # fmt: skip
    assert written[8:] == ODD["features"][8:] and written[0]["properties"] == {"v": None}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.csv", "x,y\n0,0\n1,0\n2,5\n\n7,7\n\n8,8\n8,8\n8,8\n"),
        ("a.svg", "<svg><polyline points='0,0 1,0 2,5'/><polygon points='1,1 1,1 1,1'/><path d='M3 3 L3 3'/></svg>"),
    ],
)
def test_other_files_keep_what_cannot_be_treated(tmp_path, name, content):
    path = tmp_path / name
    path.write_text(content, "utf-8")
    with pytest.warns(UserWarning, match="2 curves cannot be treated: curve 1"):
        found = gr.read_curves(path)
    [curve] = found.curves
    gr.write_curves(path, [CurveInFile(curve.points[[0, 2]], False, curve.more[[0, 2]])], like=found)
    text = path.read_text("utf-8")
    with pytest.warns(UserWarning, match="2 curves cannot be treated"):
        assert gr.read_curves(path).curves[0].points.tolist() == [[0, 0], [2, 5]]
    assert "7,7" in text if name == "a.csv" else 'points="1,1 1,1 1,1"' in text


GPX = """<?xml version="1.0"?>
<gpx version="1.1" creator="a" xmlns="http://www.topografix.com/GPX/1/1" xmlns:x="urn:x">
  <metadata><name>walk</name></metadata>
  <wpt lat="1" lon="2"/>
  <trk><name>up</name><trkseg>
    <trkpt lat="50" lon="7"><ele>100</ele><time>2020-01-01T00:00:00Z</time></trkpt>
    <trkpt lat="50.1" lon="7"><time>2020-01-01T00:00:01Z</time><extensions><x:hr>90</x:hr></extensions></trkpt>
    <trkpt lat="50.2" lon="7.1"><ele>120</ele><time>2020-01-01T00:00:02Z</time></trkpt>
  </trkseg><trkseg><trkpt lat="51" lon="7"/></trkseg></trk>
  <rte><rtept lat="0" lon="0"/><rtept lat="0" lon="1"/><rtept lat="1" lon="1"/><rtept lat="0" lon="0"/></rte>
</gpx>
"""


def test_gpx(tmp_path):
    path = tmp_path / "a.gpx"
    path.write_text(GPX, "utf-8")
    with pytest.warns(UserWarning, match=r"track 0 \(up\), segment 1 has 1 vertices, it needs 2"):
        found = gr.read_curves(path)
    track, route = found.curves
    assert track.points.tolist() == [[7, 50], [7, 50.1], [7.1, 50.2]] and not track.closed and found.degrees
    assert route.closed and len(route.points) == 3 and route.more.shape == (3, 0)
    np.testing.assert_array_equal(track.more[:, 0], [100, np.nan, 120])
    kept = [0, 2]
    fewer = CurveInFile(track.points[kept] + [0.5, 0], False, track.more[kept], rows=track.rows[kept])
    gr.write_curves(path, [fewer, CurveInFile(route.points + 1, True, route.more)], like=found)
    text = path.read_text("utf-8")
    assert text.count("<trkpt") == 3 and text.count("<rtept") == 4 and "x:hr" not in text and "ns0" not in text
    assert [t for t in range(3) if f"00:00:0{t}Z" in text] == kept
    assert "<ele>120</ele>" in text and '<wpt lat="1" lon="2" />' in text and "walk" in text
    with pytest.warns(UserWarning):
        again = gr.read_curves(path).curves
    assert (
        again[0].points.tolist() == [[7.5, 50], [7.6, 50.2]] and again[1].points.tolist() == (route.points + 1).tolist()
    )
    # other vertices than those of the file have no times
    gr.write_curves(path, [CurveInFile(track.points[:2], False, np.empty((2, 0))), route], like=found)
    assert "Z</time>" not in path.read_text("utf-8")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("<kml/>", "its root is not <gpx>"),
        ("<gpx", "damaged, or no XML"),
        ("<gpx><wpt lat='1' lon='2'/></gpx>", "contains no polygonal curve"),
        ("<gpx><rte><rtept lat='a' lon='2'/><rtept lat='1' lon='2'/></rte></gpx>", "no lon and lat"),
        ("<!DOCTYPE g [<!ENTITY a 'x'><!ENTITY b '&a;&a;'>]><gpx>&b;</gpx>", "'b', which refers to others"),
        ("<!DOCTYPE g [<!ENTITY a SYSTEM 'file:///etc/passwd'>]><gpx>&a;</gpx>", "'a', which refers to"),
    ],
)
def test_broken_gpx(tmp_path, content, words):
    (tmp_path / "a.gpx").write_text(content, "utf-8")
    with pytest.raises(gr.CurveError, match=words):
        gr.read_curves(tmp_path / "a.gpx")
    with pytest.raises(gr.CurveError, match="a latitude of 91 is outside"):
        gr.write_curves(tmp_path / "b.gpx", [CurveInFile(np.array([[0.0, 0], [0, 91]]), False, np.empty((2, 0)))])
