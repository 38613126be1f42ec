"""Point clouds: denoised by the normals of their neighbourhoods or by themselves; values at points; kinds of clouds."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

import gpureg as gr
from gpureg.points.denoise import denoised
from gpureg.points.normals import directions, fitted_points, nearest, planes, projectors, spacing_of

RNG = np.random.default_rng(11)
CLEAN = np.array(trimesh.creation.icosphere(4).vertices)
SPACING = spacing_of(CLEAN)
NOISY = CLEAN + RNG.normal(0, 0.25 * SPACING, CLEAN.shape)
LINE = np.stack([np.linspace(0, 1, 30)] * 3, axis=1)


def rms(x) -> float:
    return float(np.sqrt(np.mean(x**2)))


def radial(points) -> float:
    return rms(np.linalg.norm(points, axis=1) - 1)


def test_a_sphere(device):
    """Less than half the noise is left, and every device gives what numpy gives in float64."""
    oracle = gr.denoise_points(NOISY, backend="numpy", dtype=np.float64)
    assert radial(oracle) < 0.5 * radial(NOISY)  # measured: 0.36
    found = gr.denoise_points(NOISY, backend=device)
    # float32 in three rounds of 30 sweeps: measured 2e-6 spacings
    assert_allclose(found, oracle, rtol=0, atol=1e-4 * SPACING)
    assert np.array_equal(found, gr.denoise_points(NOISY, backend=device))


def test_a_cube_keeps_its_edges():
    cube = trimesh.creation.box((1, 1, 1))
    for _ in range(4):
        cube = cube.subdivide()
    clean = np.array(cube.vertices)
    noisy = clean + RNG.normal(0, 0.25 * spacing_of(clean), clean.shape)
    by = {filter: gr.denoise_points(noisy, filter=filter) for filter in ("normals", "positions")}
    left = {name: rms(gr.metrics.distance_to_surface(x, cube)) for name, x in (by | {"noisy": noisy}).items()}
    assert left["normals"] < 0.5 * left["noisy"]  # measured: 0.38
    assert left["normals"] < left["positions"] < left["noisy"]  # measured: 0.68 of the noise
    # along the 12 edges, where means of neighbours round
    edges = (np.abs(clean) > 0.49).sum(axis=1) >= 2
    outside = {name: rms(gr.metrics.distance_to_surface(x[edges], cube)) for name, x in by.items()}
    assert outside["normals"] < outside["positions"]


@pytest.mark.parametrize("filter", ["surface", "normals", "positions"])
def test_it_moves_with_the_points(filter):
    """Turned, shifted, scaled and in another order, the same comes out."""
    turn = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    some = NOISY[:600]
    settings = {"filter": filter, "backend": "numpy", "dtype": np.float64}
    found = gr.denoise_points(some, **settings)
    order = RNG.permutation(len(some))
    moved = gr.denoise_points(7 * some[order] @ turn + [3, -4, 5], **settings)
    # rounding, at worst in weights that decide: measured 2e-13
    assert_allclose(moved, 7 * found[order] @ turn + [3, -4, 5], atol=1e-9)


def test_clean_points_stay():
    found = denoised(CLEAN)
    assert found.displacement.max() < 0.1 * SPACING  # measured: 0.03; the sphere's own curvature
    grid = np.stack(np.meshgrid(*[np.arange(15.0)] * 2), axis=-1).reshape(-1, 2) @ [[1, 0, 0.5], [0, 1, -0.2]]
    flat = denoised(grid)
    assert_allclose(flat.points, grid, atol=1e-12)


def test_curves_in_the_plane():
    t = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    circle = np.stack([np.cos(t), np.sin(t)], axis=1)
    noisy = circle + RNG.normal(0, 0.01, circle.shape)
    assert radial(gr.denoise_points(noisy)) < 0.5 * radial(noisy)  # measured: 0.3
    assert gr.estimate_point_noise(noisy) == pytest.approx(0.01, rel=0.25)


@pytest.mark.parametrize("share", [0.1, 0.25, 0.5])
def test_noise_is_estimated(share):
    """Within what points spread by chance allow: the median of 2562 residuals of 17 points, see its Notes."""
    noisy = CLEAN + np.random.default_rng(5).normal(0, share * SPACING, CLEAN.shape)
    assert gr.estimate_point_noise(noisy) / SPACING == pytest.approx(share, rel=0.25)


def test_no_noise_is_estimated_where_none_is():
    assert gr.estimate_point_noise(CLEAN) < 0.05 * SPACING


FIXED = np.arange(len(NOISY)) % 7 == 0
BY_LAM = np.where(FIXED, np.inf, 20.0)


@pytest.mark.parametrize(
    "options",
    [{"fixed": FIXED}, {"lam": BY_LAM, "filter": "normals"}, {"lam": BY_LAM, "filter": "positions"}],
    ids=["fixed", "lam, normals", "lam, positions"],
)
def test_what_is_held_stays(options):
    found = gr.denoise_points(NOISY, **options)
    assert np.array_equal(found[FIXED], NOISY[FIXED])
    assert (found[~FIXED] != NOISY[~FIXED]).any(axis=1).mean() > 0.99


def test_what_has_no_noise_stays_and_a_cap_holds():
    assert np.array_equal(gr.denoise_points(NOISY, lam=np.inf), NOISY)
    assert np.array_equal(gr.denoise_points(NOISY, sigma=0), NOISY)
    capped = gr.denoise_points(NOISY, max_displacement=0.1 * SPACING)
    distance = np.linalg.norm(capped - NOISY, axis=1)
    assert distance.max() <= 0.1 * SPACING * (1 + 1e-12)
    assert (distance > 0.0999 * SPACING).sum() > 100


def test_neighbours_again():
    """Graphs found again differ from the first; one number of steps or all steps are the same."""
    once = gr.denoise_points(NOISY, filter="positions", max_iter=20)
    again = gr.denoise_points(NOISY, filter="positions", max_iter=20, update_neighbours=5)
    assert not np.array_equal(once, again)
    assert radial(again) < radial(NOISY)
    assert_allclose(gr.denoise_points(NOISY, filter="positions", max_iter=20, update_neighbours=20), once)
    found = denoised(NOISY, filter="positions", max_iter=20, update_neighbours=6)
    assert [result.iterations for result in found.results] == [6, 6, 6, 2]
    fitted = gr.denoise_points(NOISY, update_neighbours=2)
    assert 0 < np.abs(fitted - gr.denoise_points(NOISY)).max() < SPACING


def test_values_at_points(device):
    truth = (CLEAN @ [1, 2, 3] > 0).astype(float)
    seen = truth + RNG.normal(0, 0.3, len(truth))
    found = gr.denoise_points(CLEAN, seen, backend=device)
    assert found.shape == seen.shape
    assert rms(found - truth) < 0.5 * rms(seen - truth)  # measured: 0.26
    both = gr.denoise_points(CLEAN, np.stack([seen, 1 - seen], 1).astype(np.float32), backend=device)
    assert both.shape == (len(seen), 2) and both.dtype == np.float32
    assert_allclose(both.sum(axis=1), 1, atol=1e-4)
    colours = gr.denoise_points(CLEAN, (100 * truth).astype(np.uint8), sigma=10, backend=device)
    assert colours.dtype == np.float64 and rms(colours - 100 * truth) < 10
    assert np.array_equal(gr.denoise_points(CLEAN, truth, lam=np.inf), truth)


def test_any_number_of_coordinates():
    """Features in ten dimensions have no normals: they are regularized themselves, towards their clusters."""
    centres = 10 * RNG.normal(size=(3, 10))
    which = np.arange(300) % 3
    points = centres[which] + RNG.normal(size=(300, 10))
    found = denoised(points, sigma=1.0)
    assert found.filter == "positions"
    assert rms(found.points - centres[which]) < 0.8 * rms(points - centres[which])  # measured: 0.62
    assert gr.denoise_points(points[:, :1]).shape == (300, 1)


def test_kinds_of_clouds():
    expected = gr.denoise_points(NOISY)
    assert expected.dtype == np.float64
    single = gr.denoise_points(NOISY.astype(np.float32))
    assert single.dtype == np.float32
    assert gr.denoise_points((1000 * NOISY).astype(np.int64)).dtype == np.float64
    colours = RNG.integers(0, 256, (len(NOISY), 4), np.uint8)
    cloud = gr.denoise_points(trimesh.PointCloud(NOISY, colors=colours))
    assert type(cloud) is trimesh.PointCloud
    assert_allclose(cloud.vertices, expected)
    assert np.array_equal(cloud.colors, colours)
    with pytest.raises(TypeError, match=r"use gpureg\.denoise_mesh"):
        gr.denoise_points(trimesh.creation.box())
    with pytest.raises(TypeError, match="points must be an array"):
        gr.denoise_points("cloud.ply")


def test_clouds_of_pyvista():
    pv = pytest.importorskip("pyvista", reason="pyvista is not installed")
    given = pv.PolyData(NOISY)
    given.point_data["number"] = np.arange(len(NOISY))
    found = gr.denoise_points(given)
    assert isinstance(found, pv.PolyData) and np.array_equal(found.point_data["number"], np.arange(len(NOISY)))
    assert_allclose(found.points, gr.denoise_points(given.points), atol=1e-6)


def test_clouds_of_open3d():
    o3d = pytest.importorskip("open3d", reason="open3d is not installed")
    given = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(NOISY))
    given.paint_uniform_color([1, 0, 0])
    found = gr.denoise_points(given)
    assert isinstance(found, o3d.geometry.PointCloud) and found.has_colors()
    assert_allclose(np.asarray(found.points), gr.denoise_points(NOISY))
    assert np.array_equal(np.asarray(given.points), NOISY)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((1, 3)),
        np.zeros((2, 3)),
        np.zeros((40, 3)),
        LINE,
        np.concatenate([LINE, LINE, LINE[:1] + 50]),
        RNG.normal(size=(4, 3)),
        np.concatenate([NOISY[:100], NOISY[:100]]),
        np.concatenate([NOISY[:100], [[1e6, 0, 0]]]),
        1e-30 * NOISY[:100],
        1e30 * NOISY[:100],
    ],
    ids=["one", "two", "all the same", "a line", "copies", "four", "twice", "far away", "tiny", "huge"],
)
@pytest.mark.filterwarnings("ignore:.* points (are outliers|cannot be told)")
@pytest.mark.parametrize("filter", ["surface", "normals", "positions"])
def test_degenerate_clouds(points, filter):
    """Never NaN; points of a line stay on it."""
    # squares of 1e30 are beyond float32
    found = gr.denoise_points(points, filter=filter, dtype=np.float64)
    assert found.shape == points.shape and np.isfinite(found).all()
    if points is LINE:
        assert np.ptp(found, axis=1).max() < 1e-6
    assert np.isfinite(gr.denoise_points(points, np.arange(len(points)))).all()


@pytest.mark.parametrize(
    ("points", "settings", "error", "words"),
    [
        (NOISY, {"filter": "vertices"}, ValueError, 'filter must be "surface", "normals" or "positions"'),
        (NOISY, {"filter": "surface", "p": 1.0}, ValueError, 'filter="surface" has no p'),
        (NOISY[:, :2], {"filter": "surface"}, ValueError, "is for 3 coordinates, got 2"),
        (RNG.normal(size=(9, 4)), {"filter": "normals"}, ValueError, "is for 2 or 3 coordinates, got 4"),
        (NOISY, {"k": 0}, ValueError, "k must be >= 1"),
        (NOISY, {"k": 2.5}, TypeError, "k must be an integer"),
        (NOISY, {"sigma": -1}, ValueError, "sigma must be finite and >= 0"),
        (NOISY, {"max_displacement": np.nan}, ValueError, "max_displacement must be finite"),
        (NOISY, {"lam": np.ones(3)}, ValueError, "one per point"),
        (NOISY, {"lam": -1.0}, ValueError, "lam"),
        (NOISY, {"p": 0}, ValueError, "p must"),
        (NOISY, {"fixed": [0, 1]}, ValueError, "fixed must be boolean"),
        (NOISY, {"update_neighbours": "a"}, TypeError, "update_neighbours must be an integer"),
        (NOISY, {"tol": -1, "max_iter": 0}, ValueError, "tol must be finite and >= 0"),
        (NOISY, {"max_iter": "3"}, TypeError, "max_iter must be an integer"),
        (NOISY, {"update_neighbours": 0}, ValueError, "update_neighbours must be >= 1"),
        (NOISY, {"values": np.ones(4)}, ValueError, "values must have shape"),
        (NOISY, {"values": np.full(len(NOISY), np.nan)}, ValueError, "values must be finite"),
        (NOISY, {"values": np.ones(len(NOISY)), "filter": "normals"}, ValueError, "leave it out"),
        (NOISY, {"values": np.ones(len(NOISY)), "max_displacement": 1}, ValueError, "values stay where they are"),
        (NOISY, {"backend": "abacus"}, ValueError, "abacus"),
        (np.where(NOISY > 0.9, np.nan, NOISY), {}, ValueError, "finite"),
        (np.zeros((0, 3)), {}, ValueError, "shape"),
        (np.zeros(3), {}, ValueError, "shape"),
    ],
)
def test_wrong_input(points, settings, error, words):
    with pytest.raises(error, match=words):
        gr.denoise_points(points, **settings)


def test_noise_of_curves_and_surfaces_only():
    with pytest.raises(ValueError, match="got 5 coordinates"):
        gr.estimate_point_noise(RNG.normal(size=(50, 5)))


def test_projectors():
    """Distances of rows are those of matrices, and the way back finds the vector, either way round."""
    n = RNG.normal(size=(50, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    rows = projectors(n)
    matrices = n[:, :, None] * n[:, None, :]
    apart = np.linalg.norm(matrices[1:] - matrices[:-1], axis=(1, 2))
    assert_allclose(np.linalg.norm(rows[1:] - rows[:-1], axis=1), apart)
    assert_allclose(np.abs((directions(rows, 3) * n).sum(axis=1)), 1)
    assert_allclose(rows, projectors(-n))


def test_points_are_fitted_down_the_energy():
    """Each step of the fit lessens the squares that it is about; the sum in loops is the oracle."""
    x = NOISY[:300]
    graph = gr.knn_graph(x, 6)
    n = planes(x, nearest(x, 12)).normals

    def energy(points):
        total = 0.0
        for u in range(len(points)):
            for v in graph.indices[graph.indptr[u] : graph.indptr[u + 1]]:
                w = np.exp(-((np.outer(n[u], n[u]) - np.outer(n[v], n[v])) ** 2).sum() / 0.35**2)
                total += w * (n[u] @ (points[v] - points[u])) ** 2
        return total

    course = [energy(fitted_points(x, graph, n, 0.35, np.ones(len(x)), steps)) for steps in range(5)]
    assert (np.diff(course) < 0).all()


@pytest.mark.parametrize(
    ("name", "noise", "share"),
    # measured: 0.45, 0.38, 0.42 (the mean of 9 points leaves 0.51, 0.49, 0.52)
    [
        ("nicolo", "noisy02", 0.48),
        ("fandisk", "noisy03", 0.41),
        ("block", "noisy04", 0.44),
    ],
)
def test_vertices_of_scans(data_folder, name, noise, share):
    """Without their faces: distance to the clean surface over that of the noise."""
    clean, noisy = (gr.read_mesh(data_folder / "meshes" / f"{name}_{which}.ply") for which in ("original", noise))
    surface = (clean.vertices, clean.faces)
    before, after = (
        rms(gr.metrics.distance_to_surface(x, surface)) for x in (noisy.vertices, gr.denoise_points(noisy.vertices))
    )
    assert after < share * before
