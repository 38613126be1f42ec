"""Pictures of meshes: what hides what, light, colours, the camera, and wrong input."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")

from matplotlib.figure import Figure
from PIL import Image

import gpureg as gr

SPHERE = trimesh.creation.icosphere(3)
BOX = trimesh.creation.box((3, 2, 1))  # x, y, z


def drawn(tmp_path, *args, **kwargs) -> np.ndarray:
    """The picture as (H, W, 3), 0 to 255."""
    figure = gr.plot.meshes(*args, path=tmp_path / "a.png", **kwargs)
    assert isinstance(figure, Figure)
    with Image.open(tmp_path / "a.png") as opened:
        return np.asarray(opened.convert("RGB"), float)


def covered(picture: np.ndarray) -> np.ndarray:
    return (picture < 250).any(axis=-1)


@pytest.mark.parametrize("shading", ["flat", "smooth"])
def test_a_sphere_is_a_disc_without_seams(tmp_path, shading):
    picture = drawn(tmp_path, [SPHERE], shading=shading)
    there = covered(picture)
    rows, columns = np.flatnonzero(there.any(axis=1)), np.flatnonzero(there.any(axis=0))
    height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
    assert abs(height - width) <= 2
    # the outline is a polygon in the disc, with half a pixel of a rim (measured 0.998)
    assert there.sum() == pytest.approx(np.pi / 4 * height * width, rel=0.015)
    # the background shines through nowhere: a seam would be lighter than what is on both its sides
    y, x = np.ogrid[: picture.shape[0], : picture.shape[1]]
    inner = (y - rows.mean()) ** 2 + (x - columns.mean()) ** 2 < (0.45 * height) ** 2
    grey = picture.mean(axis=-1)
    across = grey[:, 1:-1] - np.maximum(grey[:, :-2], grey[:, 2:])
    # of 255, measured 10 where facets meet flat, 1 smooth; without lines along the edges 48
    assert across[inner[:, 1:-1]].max() < 20
    # the light comes from above on the left
    assert (
        grey[inner & (y < rows.mean()) & (x < columns.mean())].mean()
        > 1.15 * grey[inner & (y > rows.mean()) & (x > columns.mean())].mean()
    )


@pytest.mark.parametrize(
    ("view", "up", "size"),
    [
        # looking along an axis shows the two others: width, height of the box 3 x 2 x 1
        ((0, 0), "z", (2, 1)),  # from x
        ((90, 0), "z", (3, 1)),  # from y
        ((0, 0), "y", (3, 2)),  # from z
        ((90, 0), "y", (1, 2)),  # from x
        ((0, 0), "x", (1, 3)),  # from y
        ((0, 90), "z", (2, 3)),  # from above
        ((0, 0), None, (3, 2)),  # y is up
    ],
)
def test_the_camera(tmp_path, view, up, size):
    there = covered(drawn(tmp_path, [BOX], view=view, up=up))
    height, width = (np.ptp(np.flatnonzero(there.any(axis=axis))) + 1 for axis in (1, 0))
    assert width / height == pytest.approx(size[0] / size[1], rel=0.02)  # two pixels of a hundred


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize(("azimuth", "shown", "other"), [(0, 0, 1), (180, 1, 0)])
def test_what_is_near_hides_what_is_far(tmp_path, azimuth, shown, other, order):
    """Two open squares, a red one in front of a green one; seen from the other side it is the other."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    vertices = np.concatenate([square + np.array([0, 0, 1]), 0.999 * square])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    red, green = [0.9, 0, 0], [0, 0.9, 0]
    values = np.array([red, red, green, green])
    picture = drawn(tmp_path, [(vertices, faces[::order])], view=(azimuth, 0), up="y", values=[values[::order]])
    middle = picture[picture.shape[0] // 2, picture.shape[1] // 2]
    assert middle[shown] > 100 > 20 > middle[other]


def test_closed_meshes_hide_their_inside_whichever_way_they_are_turned(tmp_path):
    outward = drawn(tmp_path, [SPHERE])
    inward = drawn(tmp_path, [(SPHERE.vertices, SPHERE.faces[:, ::-1])])
    assert np.abs(outward - inward).max() <= 5  # measured 3: where depths are equal another face comes first
    # of an open one the inside is seen, and lit
    bowl = SPHERE.faces[np.asarray(SPHERE.triangles_center)[:, 2] < 0]
    picture = drawn(tmp_path, [(SPHERE.vertices, bowl)], view=(0, 0))
    middle = picture[picture.shape[0] // 2, picture.shape[1] // 2]
    assert 100 < middle.mean() < 250


def test_panels_share_camera_and_scale(tmp_path):
    small = trimesh.Trimesh(SPHERE.vertices * 0.5, SPHERE.faces, process=False)
    figure = gr.plot.meshes(
        {"large": SPHERE, "small": small, "third": SPHERE}, caption="below", path=tmp_path / "a.pdf"
    )
    assert [axes.get_title() for axes in figure.axes] == ["large", "small", "third"]
    assert len({axes.get_xlim() + axes.get_ylim() for axes in figure.axes}) == 1
    assert figure.texts[0].get_text() == "below"
    assert (tmp_path / "a.pdf").stat().st_size < 500_000  # faces go in as pictures
    picture = covered(drawn(tmp_path, [SPHERE, small]))
    left, right = np.array_split(picture, 2, axis=1)
    assert right.sum() / left.sum() == pytest.approx(0.25, rel=0.03)  # rims of half a pixel
    five = gr.plot.meshes([SPHERE] * 5)
    tops = {round(axes.get_position().y1, 6) for axes in five.axes}
    assert len(five.axes) == 5 and len(tops) == 2


@pytest.mark.parametrize("shading", ["flat", "smooth"])
@pytest.mark.parametrize("n", [len(SPHERE.vertices), len(SPHERE.faces)], ids=["by vertex", "by face"])
def test_numbers_are_drawn_with_a_bar(n, shading):
    figure = gr.plot.meshes([SPHERE], values=[np.arange(n)], shading=shading)
    assert len(figure.axes) == 2
    assert figure.axes[1].get_ylim() == (0, n - 1)


def test_one_number_or_colour_everywhere_is_drawn(tmp_path):
    n = len(SPHERE.vertices)
    assert covered(drawn(tmp_path, [SPHERE], values=[np.zeros(n)])).any()
    coloured = drawn(tmp_path, [SPHERE], values=[np.full((n, 3), [0.80, 0.79, 0.76])])
    assert covered(coloured).any()
    # the colour that is taken without values, rounded once more
    assert np.abs(coloured - drawn(tmp_path, [SPHERE])).max() <= 1


@pytest.mark.parametrize("shading", ["flat", "smooth"])
def test_edges_are_darker(tmp_path, shading):
    plain, lined = (drawn(tmp_path, [BOX], shading=shading, edges=edges) for edges in (False, True))
    assert (plain - lined).max() > 40  # of about 190; measured 54, a thin line


@pytest.mark.parametrize(
    ("args", "options", "error", "words"),
    [
        (([],), {}, ValueError, "no mesh to draw"),
        ((SPHERE,), {}, TypeError, "a sequence of meshes"),
        (((SPHERE.vertices, SPHERE.faces),), {}, TypeError, "give a single mesh in a list"),
        (([SPHERE],), {"shading": "gouraud"}, ValueError, "flat"),
        (([SPHERE],), {"view": (0, 100)}, ValueError, "in -90..90"),
        (([SPHERE],), {"view": "front"}, ValueError, "azimuth"),
        (([SPHERE],), {"up": "w"}, ValueError, '"x", "y" or "z"'),
        (([SPHERE],), {"values": []}, ValueError, "each of the 1 meshes"),
        (([SPHERE],), {"values": [np.zeros(7)]}, ValueError, "642 vertices or 1280 faces"),
        (([SPHERE],), {"values": [np.full(642, np.nan)]}, ValueError, "finite"),
        (([SPHERE],), {"path": "a.txt"}, ValueError, "extension"),
        (([SPHERE],), {"path": "nowhere/a.png"}, OSError, "nowhere"),
    ],
)
def test_wrong_input(args, options, error, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=words):
        gr.plot.meshes(*args, **options)
    assert list(tmp_path.iterdir()) == []


def test_meshes_without_extent_are_drawn(tmp_path):
    flat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    for vertices, faces in ((flat, [[0, 1, 2]]), (flat * 0, [[0, 1, 2]]), (flat, [[0, 1, 1]])):
        gr.plot.meshes([(vertices, faces)], path=tmp_path / "a.png", shading="smooth")
        gr.plot.meshes([(vertices, faces)], path=tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 0
