"""Meshes, curves, points: quality and seconds beside trimesh, Open3D, PyMeshLab and scikit-learn, as Markdown.

``python -m bench.geometry [--quick] [--only NAME]``. The data come from GPUREG_DATA; a peer that is not installed has
no row. Seconds are of one run after another that builds the kernels, from arrays to arrays.
"""

from __future__ import annotations

import argparse
import gzip
import platform
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from importlib import import_module, metadata
from typing import Any

import numpy as np

import gpureg as gr
from gpureg import backends
from gpureg.figures.fig7 import douglas_peucker, measured

from .model import data

# Pairs of clean and noisy meshes, and the angles that are asked for: by normals, and by positions.
PAIRS = {
    "bunny34834": ("noisy02", 6.2, 7.4),
    "nicolo": ("noisy02", 6.8, None),
    "fandisk": ("noisy03", 4.3, None),
    "block": ("noisy04", 5.8, None),
    "twelve": ("impulsive05", 4.8, None),
}


def found(name: str) -> Any:
    """A peer, or None where it does not import."""
    try:
        return import_module(name)
    except ImportError:
        return None


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """What comes out, and seconds."""
    begin = time.perf_counter()
    result = work()
    return result, time.perf_counter() - begin


def row(*cells: object) -> str:
    """A line of a table."""
    return "| " + " | ".join("-" if cell is None else str(cell) for cell in cells) + " |"


def table(*heads: str) -> str:
    """The head of one."""
    return row(*heads) + "\n|" + "---|" * len(heads)


def mesh_peers(vertices: Any, faces: Any, steps: int = 10) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Filters of other packages, as calls that give vertices."""
    trimesh = found("trimesh")
    if trimesh is not None:
        for name in ("filter_taubin", "filter_humphrey"):

            def smooth(name: str = name) -> Any:
                mesh = trimesh.Trimesh(vertices, faces, process=False)
                return getattr(trimesh.smoothing, name)(mesh, iterations=steps).vertices

            yield f"trimesh {name}, {steps}", smooth
    open3d = found("open3d")
    if open3d is not None:

        def taubin() -> Any:
            mesh = open3d.geometry.TriangleMesh(
                open3d.utility.Vector3dVector(vertices), open3d.utility.Vector3iVector(faces)
            )
            return np.asarray(mesh.filter_smooth_taubin(steps).vertices)

        yield f"Open3D filter_smooth_taubin, {steps}", taubin
    pymeshlab = found("pymeshlab")
    if pymeshlab is not None:

        def two_steps() -> Any:
            meshes = pymeshlab.MeshSet()
            meshes.add_mesh(pymeshlab.Mesh(vertices, faces))
            meshes.apply_coord_two_steps_smoothing()
            return meshes.current_mesh().vertex_matrix()

        yield "PyMeshLab two_steps_smoothing", two_steps


def quality(quick: bool) -> Iterator[str]:
    """Angles of normals, volume and seconds on the pairs with default parameters."""
    yield table("mesh", "filter", "normals, degrees", "asked for", "vertices, edges", "volume, %", "seconds")
    for name, (noise, normals, positions) in list(PAIRS.items())[: 1 if quick else None]:
        paths = data("meshes", f"{name}_original.ply"), data("meshes", f"{name}_{noise}.ply")
        if None in paths:
            yield row(name, "no test data", None, None, None, None, None)
            continue
        clean, noisy = (gr.read_mesh(path) for path in paths if path is not None)
        truth, faces = (clean.vertices, clean.faces), noisy.faces
        ours: list[tuple[str, Callable[[], Any], float | None]] = [
            (
                filter,
                lambda filter=filter, mesh=noisy: gr.denoise_mesh((mesh.vertices, mesh.faces), filter=filter)[0],
                bar,
            )
            for filter, bar in (("normals", normals), ("positions", positions))
        ]
        works = [("noisy", lambda mesh=noisy: mesh.vertices, None), *ours]
        works += [(peer, work, None) for peer, work in mesh_peers(noisy.vertices, faces)]
        for title, work, bar in works:
            if title in ("normals", "positions"):
                work()
            vertices, seconds = timed(work)
            mesh = (vertices, faces)
            yield row(
                name,
                f"gpureg {title}" if title in ("normals", "positions") else title,
                f"{gr.metrics.normal_angle_error(mesh, truth):.2f}",
                bar,
                f"{gr.metrics.vertex_error(mesh, truth):.3f}",
                f"{100 * gr.metrics.volume(mesh) / gr.metrics.volume(truth):.2f}",
                f"{seconds:.2f}",
            )


def growth(quick: bool) -> Iterator[str]:
    """A bunny subdivided to a million vertices, and a scan of 172,802 points, whole and in parts."""
    trimesh = found("trimesh")
    path = data("meshes", "bunny34834_original.ply")
    yield table("vertices", "what", "seconds", "microseconds a vertex")
    if path is None or trimesh is None:
        yield row(None, "no test data", None, None)
    else:
        mesh = gr.read_mesh(path)
        vertices, faces = mesh.vertices, mesh.faces
        for times in range(1 if quick else 3):
            if times:
                vertices, faces = trimesh.remesh.subdivide(vertices, faces)
            if times == 2:
                # with one more a quarter of the faces, which makes a million and some vertices
                vertices, faces = trimesh.remesh.subdivide(vertices, faces, face_index=np.arange(len(faces) * 2 // 3))
            edge = np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1).mean()
            noisy = vertices + np.random.default_rng(0).normal(0, 0.2 * edge, vertices.shape)
            works: list[tuple[str, Callable[[], Any]]] = [
                (f"gpureg {filter}", lambda filter=filter, x=noisy, f=faces: gr.denoise_mesh((x, f), filter=filter))
                for filter in ("positions", "normals")
            ]
            for title, work in [*works, *mesh_peers(noisy, faces)]:
                _, seconds = timed(work)
                yield row(len(vertices), title, f"{seconds:.2f}", f"{1e6 * seconds / len(vertices):.1f}")
    path = data("points", "pcl_mosd_test33.ply")
    if path is None:
        return
    scan = gr.read_points(path).points
    open3d = found("open3d")
    for part in (4, 2, 1):
        points = scan[: len(scan) // part]
        works = [("gpureg denoise_points", lambda x=points: gr.denoise_points(x))]
        if open3d is not None:

            def peers(x: Any = points) -> Any:
                cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(x))
                cloud.estimate_normals()
                return cloud.remove_statistical_outlier(16, 2.0)

            works.append(("Open3D estimate_normals, remove_statistical_outlier (no denoising in it)", peers))
        for title, work in works:
            _, seconds = timed(work)
            yield row(len(points), title, f"{seconds:.2f}", f"{1e6 * seconds / len(points):.1f}")


def clouds(quick: bool) -> Iterator[str]:
    """Distance of points to the clean surface, as a share of that of the noise, without any face."""
    from scipy.spatial import cKDTree

    yield table("points", "gpureg surface", "gpureg positions", "mean of 9", "seconds")
    for name, (noise, *_) in list(PAIRS.items())[: 1 if quick else 4]:
        paths = data("meshes", f"{name}_original.ply"), data("meshes", f"{name}_{noise}.ply")
        if None in paths:
            yield row(name, "no test data", None, None, None)
            continue
        clean, noisy = (gr.read_mesh(path) for path in paths if path is not None)
        x, truth = noisy.vertices, (clean.vertices, clean.faces)

        def left(points: Any, truth: Any = truth, x: Any = x) -> float:
            after, before = (gr.metrics.distance_to_surface(p, truth) for p in (points, x))
            return float(np.sqrt((after**2).mean() / (before**2).mean()))

        by_surface, seconds = timed(lambda x=x: gr.denoise_points(x))
        near = x[cKDTree(x).query(x, 9, workers=-1)[1]].mean(axis=1)
        by_positions = gr.denoise_points(x, filter="positions")
        yield row(name, *(f"{left(points):.2f}" for points in (by_surface, by_positions, near)), f"{seconds:.2f}")


def clusters(quick: bool) -> Iterator[str]:
    """Adjusted Rand index with the number of clusters given, and found, beside scikit-learn."""
    learn = found("sklearn.cluster")
    score = found("sklearn.metrics")
    yield table(
        "points", "clusters", "gpureg, given", "gpureg, found", "SpectralClustering, given", "HDBSCAN of 15", "seconds"
    )
    if score is None:
        yield row("scikit-learn is not installed: no index", None, None, None, None, None, None)
        return
    for name in ("labirynth", "circles", "mk4", "two_moons")[: 1 if quick else None]:
        path = data("points", "two_moons_100d.npz" if name == "two_moons" else f"wut_{name}.csv.gz")
        if path is None:
            yield row(name, "no test data", None, None, None, None, None)
            continue
        if name == "two_moons":
            with np.load(path) as file:
                points, truth = file["features"].astype(float), file["labels"].astype(int)
        else:
            with gzip.open(path, "rt") as lines:
                read = np.loadtxt(lines, delimiter=",", skiprows=1)
            points, truth = read[:, :-1], read[:, -1].astype(int)
        count = len(np.unique(truth))
        given, seconds = timed(lambda x=points, n=count: gr.cluster_points(x, n))
        counted = gr.cluster_points(points)
        spectral = learn.SpectralClustering(count, affinity="nearest_neighbors", n_neighbors=10, random_state=0)
        other, slow = timed(lambda model=spectral, x=points: model.fit_predict(x))
        dense = learn.HDBSCAN(min_cluster_size=15, copy=True).fit_predict(points)
        index = score.adjusted_rand_score
        yield row(
            name,
            count,
            f"{index(truth, given):.3f}",
            f"{index(truth, counted):.3f} ({counted.max() + 1})",
            f"{index(truth, other):.3f}",
            f"{index(truth, dense):.3f}",
            f"{seconds:.2f}; spectral {slow:.2f}",
        )


def curves(quick: bool) -> Iterator[str]:
    """Great Britain's coast with fewer vertices beside Douglas and Peucker; outlines at once and one by one; growth."""
    yield table("curve", "how", "vertices", "area, %", "Hausdorff distance", "seconds")
    path = data("curves", "great_britain_ne10m.csv")
    if path is not None:
        points = gr.read_curves(path).curves[0].points
        points = points * [np.cos(np.radians(points[:, 1].mean())), 1]
        ways: dict[str, dict[str, object]] = {
            "heights": {},
            "heights, valid": {"valid": True},
            "directions": {"filter": "directions"},
            "positions": {"filter": "positions"},
        }
        for way, options in ways.items():
            with warnings.catch_warnings():
                # only valid=True promises that the coast does not cross itself
                warnings.filterwarnings("ignore", ".*crosses itself")
                gr.simplify_curve(points, **options)
                simple, seconds = timed(lambda told=options: gr.simplify_curve(points, **told))
            count = len(simple)
            other, slow = timed(lambda n=count: douglas_peucker(points, n))
            for title, kept, spent in ((f"gpureg {way}", simple, seconds), ("Douglas and Peucker", other, slow)):
                told = measured(kept, points)
                area, far = 100 * told["share of the area"], told["Hausdorff distance"]
                yield row("Great Britain", title, told["vertices"], f"{area:.2f}", far, f"{spent:.2f}")
    angle = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    random = np.random.default_rng(0)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    many = [circle + random.normal(0, 0.02, circle.shape) for _ in range(100 if quick else 2000)]
    gr.denoise_curve(many[:3])
    _, at_once = timed(lambda: gr.denoise_curve(many))
    _, in_turn = timed(lambda: [gr.denoise_curve(one) for one in many])
    yield row(f"{len(many)} outlines of 100", "as one graph", 100 * len(many), None, None, f"{at_once:.2f}")
    yield row(f"{len(many)} outlines of 100", "one by one", 100 * len(many), None, None, f"{in_turn:.2f}")
    for n in (10**4,) if quick else (10**4, 10**5, 10**6):
        angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
        noisy = np.stack([np.cos(angle), np.sin(angle)], 1) + random.normal(0, 1 / n, (n, 2))
        _, seconds = timed(lambda x=noisy: gr.denoise_curve(x))
        yield row("a circle", "denoise_curve", n, None, None, f"{seconds:.2f}")


TABLES: dict[str, Callable[[bool], Iterator[str]]] = {
    "quality": quality,
    "clouds": clouds,
    "clusters": clusters,
    "curves": curves,
    "growth": growth,
}


def main(arguments: list[str] | None = None) -> int:
    """Print the tables; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m bench.geometry", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the first rows of each")
    parser.add_argument("--only", action="append", choices=TABLES, help="this table; repeatable")
    options = parser.parse_args(arguments)
    peers = {name: _version(name) for name in ("trimesh", "open3d", "pymeshlab", "scikit-learn", "scikit-image")}
    known = ", ".join(f"{name} {version}" for name, version in peers.items() if version)
    print(f"{platform.machine()}, Python {platform.python_version()}, {backends.get('auto', np.float32)}; {known}")
    for name in options.only or TABLES:
        print(f"\n**{name}**: {(TABLES[name].__doc__ or '').strip()}\n", flush=True)
        for line in TABLES[name](options.quick):
            print(line, flush=True)
    return 0


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


if __name__ == "__main__":
    sys.exit(main())
