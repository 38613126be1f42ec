"""A wrong number is refused in a sentence that names the parameter and the function that was called, in every door."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from cases import rng

import gpureg as gr
from gpureg import doors

ON = {"backend": "numpy"}
IMAGE = 100 + 20 * rng(3).standard_normal((24, 26))
PHOTONS = rng(4).poisson(np.add.outer(np.linspace(5, 150, 160), np.linspace(5, 50, 160))).astype(float)
GRAPH = gr.knn_graph(rng(5).random((40, 3)), 4)
F0 = rng(7).random(40)
LABELS = np.where(np.arange(40) % 9 == 0, np.arange(40) % 2, -1)
CLOUD = rng(9).random((60, 3))
ANGLES = np.linspace(0, 2 * np.pi, 40, endpoint=False)
OUTLINE = np.stack([np.cos(ANGLES), 0.6 * np.sin(ANGLES)], axis=1)
SQUARE = (np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.2]], float), np.array([[0, 1, 2], [2, 1, 3]]))
CELLS = np.arange(49).reshape(7, 7)[:-1, :-1].ravel()
SHEET = (
    np.column_stack([*(axis.ravel() for axis in np.mgrid[:7, :7]), 0.1 * rng(11).standard_normal(49)]),
    np.concatenate([np.stack([CELLS, CELLS + 7, CELLS + 1], 1), np.stack([CELLS + 1, CELLS + 7, CELLS + 8], 1)]),
)
GRID = gr.GridGraph(IMAGE.shape)
REGIONS = (np.indices(IMAGE.shape).sum(axis=0) // 8).astype(int)


COLOURS = np.stack([REGIONS % 7, REGIONS % 5, REGIONS % 3], axis=-1) * 30


def halved(image: np.ndarray, factor: float = 0.5) -> np.ndarray:
    """A denoiser to be calibrated."""
    return image * factor


# A call of each public function that works, in little time.
CALLS: dict[str, tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]] = {
    "regularize": (gr.regularize, (F0, GRAPH), ON | {"max_iter": 2}),
    "regularization_path": (gr.regularization_path, (F0, GRAPH), ON | {"lam": [1.0, 0.5], "max_iter": 2}),
    "derivatives": (
        gr.derivatives,
        (gr.regularize(F0, GRAPH, max_iter=2, backend="numpy"), lambda value: value),
        {"unrolled": 2},
    ),
    "interpolate": (gr.interpolate, (F0, GRAPH), ON | {"known": LABELS >= 0}),
    "propagate_labels": (gr.propagate_labels, (LABELS, GRAPH), ON | {"max_iter": 2}),
    "memory_needed": (gr.memory_needed, (GRID,), ON),
    "denoise_image": (gr.denoise_image, (IMAGE,), ON),
    "plan_denoising": (gr.plan_denoising, (IMAGE,), ON),
    "denoise_nl_means": (gr.denoise_nl_means, (IMAGE,), ON | {"h": 30.0, "radius": 2, "patch_radius": 1}),
    "denoise_bilateral": (gr.denoise_bilateral, (IMAGE,), ON | {"sigma_value": 30.0, "radius": 2}),
    "denoise_tv": (gr.denoise_tv, (IMAGE,), ON | {"lam": 0.1, "max_iter": 2}),
    "inpaint_image": (gr.inpaint_image, (IMAGE, IMAGE > 130), ON),
    "simplify_image": (gr.simplify_image, (IMAGE,), ON | {"lam": 0.05, "max_iter": 2}),
    "patch_graph": (gr.patch_graph, (IMAGE, 4), ON),
    "patch_groups": (gr.patch_groups, (IMAGE,), ON | {"radius": 3, "patch_radius": 1}),
    "describe_noise": (gr.describe_noise, (IMAGE,), {}),
    "estimate_noise": (gr.estimate_noise, (IMAGE,), {}),
    "estimate_photon_noise": (gr.estimate_photon_noise, (PHOTONS,), {}),
    "energy_partition": (gr.energy_partition, (IMAGE, GRID, gr.sources.seeds(GRID, 6)), ON),
    "region_graph": (gr.region_graph, (REGIONS,), {}),
    "region_values": (gr.region_values, (IMAGE, REGIONS), {}),
    "sources.extrema": (gr.sources.extrema, (IMAGE, GRID), ON),
    "sources.seeds": (gr.sources.seeds, (GRID, 6), {}),
    "denoise_mesh": (gr.denoise_mesh, SHEET, ON | {"max_iter": 2}),
    "simplify_mesh": (gr.simplify_mesh, SQUARE, ON | {"max_iter": 2}),
    "segment_mesh": (gr.segment_mesh, SQUARE, ON | {"max_iter": 2}),
    "estimate_mesh_noise": (gr.estimate_mesh_noise, SHEET, {}),
    "denoise_points": (gr.denoise_points, (CLOUD,), ON | {"max_iter": 2}),
    "estimate_point_noise": (gr.estimate_point_noise, (CLOUD,), {}),
    "cluster_points": (gr.cluster_points, (CLOUD,), ON | {"max_iter": 2}),
    "point_patches": (gr.point_patches, (CLOUD,), {}),
    "patch_knn_graph": (gr.patch_knn_graph, (CLOUD,), {"k": 4, "among": 12}),
    "denoise_curve": (gr.denoise_curve, (OUTLINE,), ON | {"max_iter": 2}),
    "simplify_curve": (gr.simplify_curve, (OUTLINE,), ON | {"max_iter": 2}),
    "skeleton": (gr.skeleton, (OUTLINE,), {}),
    "simplify_skeleton": (gr.simplify_skeleton, (OUTLINE,), ON),
    "knn_graph": (gr.knn_graph, (CLOUD, 4), {}),
    "radius_graph": (gr.radius_graph, (CLOUD, 0.3), {}),
    "mesh_graph": (gr.mesh_graph, SQUARE, {}),
    "face_graph": (gr.face_graph, SQUARE, {}),
    "ring_graph": (gr.ring_graph, (GRAPH, 2), {}),
    "curve_graph": (gr.curve_graph, (OUTLINE,), {}),
    "reordered": (gr.reordered, (GRAPH,), {}),
    "GridGraph": (gr.GridGraph, ((5, 6),), {}),
    "Graph.from_edges": (gr.Graph.from_edges, ([[0, 1], [1, 2]],), {}),
    "Jacobi": (gr.Jacobi, (), {}),
    "Euler": (gr.Euler, (), {}),
    "Certified": (gr.Certified, (), {}),
    "gradient_norm": (gr.operators.gradient_norm, (F0, GRAPH), ON),
    "p_laplacian": (gr.operators.p_laplacian, (F0, GRAPH, 2.0), ON),
    "dirichlet_energy": (gr.operators.dirichlet_energy, (F0, GRAPH, 2.0), ON),
    "energy": (gr.operators.energy, (F0, F0, GRAPH, 2.0, 1.0), ON),
    "curvature": (gr.operators.curvature, (F0, GRAPH), ON | {"eps": 0.1}),
    "laplacian": (gr.operators.laplacian, (F0, GRAPH), ON),
    "markov_matrix": (gr.operators.markov_matrix, (GRAPH,), {}),
    "eigenpairs": (gr.spectral.eigenpairs, (GRAPH, 3), {}),
    "spectral_filter": (gr.spectral.spectral_filter, (F0, GRAPH, 3), {}),
    "diffuse": (gr.spectral.diffuse, (F0, GRAPH, 2), {}),
    "averaging_filter": (gr.spectral.averaging_filter, (GRAPH,), {}),
    "weights.bilateral": (gr.weights.bilateral, (2.0, 0.1), {}),
    "weights.patch": (gr.weights.patch, (2, 0.1), {}),
    "weights.inverse_distance": (gr.weights.inverse_distance, (), {}),
    "weights.gaussian": (gr.weights.gaussian, (CLOUD, 0.1), {}),
    "weights.smoothed": (gr.weights.smoothed, (gr.weights.patch(1, 0.1), 0.5), {}),
    "tuning.sure": (gr.tuning.sure, (halved, IMAGE, 20.0), {}),
    "tuning.j_invariance": (gr.tuning.j_invariance, (halved, IMAGE), {}),
    "tuning.calibrate": (gr.tuning.calibrate, (halved, IMAGE, {"factor": [0.4, 0.6]}), {}),
    "tuning.discrepancy": (gr.tuning.discrepancy, (F0, GRAPH), ON | {"sigma": 0.1, "max_iter": 5}),
    "tuning.nl_means_parameters": (gr.tuning.nl_means_parameters, (20.0,), {}),
    "metrics.hausdorff": (gr.metrics.hausdorff, (SQUARE, SQUARE), {}),
    "presets.opencv_nl_means": (gr.presets.opencv_nl_means, (IMAGE.astype(np.uint8), 10.0), {}),
    "presets.opencv_bilateral": (gr.presets.opencv_bilateral, (IMAGE.astype(np.float32), 5, 20.0, 2.0), {}),
    "presets.gputools_bilateral": (gr.presets.gputools_bilateral, (IMAGE, 3, 20.0), {}),
    "presets.gputools_nl_means": (gr.presets.gputools_nl_means, (IMAGE, 20.0), {}),
    "presets.skimage_nl_means": (gr.presets.skimage_nl_means, (IMAGE,), {"patch_distance": 2, "h": 20.0}),
    "plot.compare": (gr.plot.compare, (IMAGE, IMAGE), {}),
    "plot.energy": (gr.plot.energy, (gr.regularize(F0, GRAPH, max_iter=3, backend="numpy"),), {}),
    "plot.meshes": (gr.plot.meshes, ({"square": SQUARE},), {}),
    "plot.neighbours": (gr.plot.neighbours, (IMAGE, (12, 12)), {"radius": 2}),
    "plot.points": (gr.plot.points, ({"cloud": CLOUD},), {}),
    "plot.quality": (gr.plot.quality, (IMAGE, IMAGE + 1), {}),
    "plot.simplification": (gr.plot.simplification, (IMAGE, COLOURS, IMAGE, IMAGE), {}),
    "run_plan": (gr.run_plan, (gr.plan_denoising(IMAGE, backend="numpy"), IMAGE), ON),
    "skimage.denoise_tv_chambolle": (gr.skimage.denoise_tv_chambolle, (IMAGE,), {}),
    "skimage.denoise_nl_means": (gr.skimage.denoise_nl_means, (IMAGE,), {"patch_distance": 2, "h": 20.0}),
    "skimage.denoise_bilateral": (gr.skimage.denoise_bilateral, (IMAGE,), {"sigma_color": 20.0}),
}

# What is a number though its annotation does not stand in the signature: options that are handed on.
OPTIONS = {"eps", "tol", "memory", "max_iter", "p", "lam", "sigma", "update_weights", "k", "radius"}
# Numbers that may have any finite value, or seeds of a generator.
ANY = {"offset", "seed"}


def numbers(function: Callable[..., Any]) -> list[str]:
    """The parameters of a function that are numbers, or may be."""
    found = []
    for name, parameter in inspect.signature(function).parameters.items():
        kinds = re.findall(r"\w+", str(parameter.annotation)) if parameter.annotation is not parameter.empty else []
        if "Callable" in kinds or "Sequence" in kinds or ("bool" in kinds and "float" not in kinds):
            continue
        if {"float", "int"} & set(kinds) or (not kinds and name in OPTIONS):
            found.append(name)
    return found


def wrong(function: Callable[..., Any], args: tuple[Any, ...], given: dict[str, Any], name: str, value: Any) -> str:
    """The sentence that a call with one wrong argument gets."""
    bound = inspect.signature(function).bind_partial(*args, **given)
    bound.arguments[name] = value
    with pytest.raises((TypeError, ValueError)) as caught:
        function(*bound.args, **bound.kwargs)
    return str(caught.value)


CASES = [(call, name) for call in CALLS for name in numbers(CALLS[call][0])]


@pytest.mark.parametrize("call", CALLS)
def test_the_call_works(call):
    function, args, given = CALLS[call]
    function(*args, **given)


@pytest.mark.parametrize(("call", "name"), CASES, ids=[f"{call}-{name}" for call, name in CASES])
@pytest.mark.parametrize("value", ["wrong", True, float("nan")], ids=["text", "truth", "not a number"])
def test_a_wrong_number_gets_a_sentence(call, name, value):
    function, args, given = CALLS[call]
    said = wrong(function, args, given, name, value)
    called = call.rpartition(".")[2] if call != "Graph.from_edges" else call
    assert said.startswith(called), said
    assert re.search(rf"\b{name}\b", said), said


def test_every_public_function_is_tried():
    """A function that is new stands here too, if it takes a number."""
    rooms = (gr.metrics, gr.operators, gr.plot, gr.presets, gr.skimage, gr.sources, gr.spectral, gr.tuning, gr.weights)
    public = {name: getattr(gr, name) for name in gr.__all__}
    for room in rooms:
        short = room.__name__.removeprefix("gpureg.")
        names = getattr(room, "__all__", [name for name in vars(room) if not name.startswith("_")])
        public |= {f"{short}.{name}": getattr(room, name) for name in names}
    tried = {function for function, _, _ in CALLS.values()}
    missing = {
        name
        for name, function in public.items()
        if inspect.isfunction(function)
        and hasattr(function, "__wrapped__")
        and function not in tried
        and numbers(function)
    }
    assert missing == set()


@pytest.mark.parametrize(
    ("function", "old", "new"),
    [(function, old, new) for function, names in doors.RENAMED.items() for old, new in names.items()],
    ids=lambda x: str(x)[:30],
)
def test_an_old_name_gets_the_new_one(function, old, new):
    owner, _, method = function.partition(".")
    room = next(
        room for room in (gr, gr.weights, gr.operators, gr.spectral, gr.tuning, gr.plot) if hasattr(room, owner)
    )
    where = getattr(getattr(room, owner), method) if method else getattr(room, owner)
    with pytest.raises(TypeError, match=rf"^{function}: '{old}' is called {re.escape(new)} now"):
        where(**{old: 1})


def test_an_error_of_a_callback_stays_as_it_is():
    def callback(check):
        raise ValueError("no more")

    with pytest.raises(ValueError, match=r"^no more$"):
        gr.regularize(F0, GRAPH, callback=callback, **ON)
    with pytest.raises(ValueError, match=r"^knn_graph: k must be >= 1, got 0$"):
        gr.denoise_image(IMAGE, p=1, callback=lambda check: gr.knn_graph(CLOUD, 0), **ON)
