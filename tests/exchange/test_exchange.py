"""Arrays of other libraries in every public function: same bits as with numpy, same kind back, nothing copied."""

from __future__ import annotations

import numpy as np
import pytest
from foreign import Tensor, expect_same, foreign, holds_arrays
from test_arguments import CALLS, CLOUD, F0, GRAPH, IMAGE, LABELS, ON, OUTLINE, SHEET

import gpureg as gr
from gpureg import exchange
from gpureg.doors import door

GRID = gr.GridGraph(IMAGE.shape)
# Calls of the table whose results are or hold arrays, besides histories and graphs.
WITH_ARRAYS = {
    "regularize", "regularization_path", "interpolate", "propagate_labels", "denoise_image", "denoise_nl_means",
    "denoise_bilateral",
    "denoise_tv", "inpaint_image", "simplify_image", "energy_partition", "region_values", "sources.extrema",
    "denoise_mesh", "simplify_mesh", "segment_mesh", "denoise_points", "cluster_points", "point_patches",
    "denoise_curve", "simplify_curve", "gradient_norm", "p_laplacian", "curvature", "laplacian", "spectral_filter",
    "diffuse", "tuning.discrepancy", "run_plan", "skimage.denoise_tv_chambolle", "skimage.denoise_nl_means",
    "skimage.denoise_bilateral", "presets.opencv_nl_means", "presets.opencv_bilateral", "presets.gputools_nl_means",
    "presets.gputools_bilateral", "presets.skimage_nl_means",
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [name for name, (_, *given) in CALLS.items() if holds_arrays(given) and not name.startswith("plot.")]
)
def test_every_function_takes_them_and_returns_their_kind(name):
    function, args, given = CALLS[name]
    found, expected = function(*foreign(args), **foreign(given)), function(*args, **given)
    seen: list = []
    expect_same(found, expected, seen)
    assert all(isinstance(x, Tensor) for x in seen)
    assert bool(seen) == (name in WITH_ARRAYS)


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        ({"image": Tensor(IMAGE), "mask": IMAGE > 80}, Tensor),
        ({"mask": Tensor(IMAGE > 80), "image": Tensor(IMAGE)}, Tensor),
        # the kind is that of the data, which are the first parameter
        ({"image": IMAGE, "mask": Tensor(IMAGE > 80)}, np.ndarray),
        ({"image": IMAGE.tolist(), "mask": Tensor(IMAGE > 80)}, np.ndarray),
        ({"lam": Tensor(np.full(IMAGE.shape, 0.3)), "image": Tensor(IMAGE)}, Tensor),
        ({"image": Tensor(IMAGE), "lam": Tensor(0.3), "max_iter": Tensor(2)}, Tensor),
        ({"image": Tensor(IMAGE[::2, ::-1]), "spacing": Tensor(np.array([1.0, 2.0]))}, Tensor),
        ({"image": Tensor(IMAGE.T)}, Tensor),
    ],
)
def test_arguments_of_several_kinds(given, kind):
    host = {name: x.array if isinstance(x, Tensor) else x for name, x in given.items()}
    host = {name: x[()] if np.ndim(x) == 0 else x for name, x in host.items()}
    usual = {"lam": 0.3, "max_iter": 2, **ON}
    found, expected = gr.denoise_tv(**usual | given), gr.denoise_tv(**usual | host)
    assert type(found) is kind
    np.testing.assert_array_equal(getattr(found, "array", found), expected)


def test_a_guide_and_weights():
    guided = gr.weights.guided(gr.weights.bilateral(2.0, 30.0), Tensor(IMAGE.ravel()))
    found = gr.regularize(Tensor(IMAGE), GRID, weights=guided, max_iter=1, **ON).value
    same = {"guide": Tensor(IMAGE), "radius": 1, "sigma_value": 30.0, "sigma_space": 2.0, "lam": 1}
    expected = gr.denoise_bilateral(IMAGE, **same, **ON)
    assert type(found) is Tensor and type(expected) is np.ndarray
    np.testing.assert_allclose(found.array, expected, rtol=1e-6)


def test_lists_of_curves_and_graphs():
    both = gr.denoise_curve([Tensor(OUTLINE), OUTLINE + 3], **ON)
    assert [type(x) for x in both] == [Tensor, Tensor]
    np.testing.assert_array_equal(both[0].array, gr.denoise_curve([OUTLINE, OUTLINE + 3], **ON)[0])
    graph = gr.Graph(Tensor(GRAPH.indptr), Tensor(GRAPH.indices), None, Tensor(CLOUD[:40]))
    assert type(graph.indptr) is type(graph.positions) is np.ndarray
    assert gr.Graph.from_edges(Tensor(np.array([[0, 1], [1, 2]]))).n_edges == 4


def test_regions_stay_arrays_of_the_library():
    found, host = gr.simplify_image(Tensor(IMAGE), **ON), gr.simplify_image(IMAGE, **ON)
    assert repr(found) == repr(host) and found.percent == host.percent
    for name in ("image", "labels", "models", "values", "value", "fine"):
        assert type(getattr(found, name)) is Tensor
        np.testing.assert_array_equal(getattr(found, name).array, getattr(host, name))
    merged, coarse = found.merged(10.0), found.hierarchy(lam=[0.1, 0.05], merge_tol=5.0, **ON)
    assert type(merged.labels) is type(coarse[-1].value) is type(found.random_colours()) is Tensor
    assert merged.image is found.image
    assert type(host.regularized(lam=Tensor(0.1), **ON).value) is np.ndarray


def test_nothing_is_copied_on_the_way_in_and_out():
    given: list = []

    @door
    def passes(image, other):
        given.append((image, other))
        return image, other + 1, np.flip(image), np.arange(3.0)

    a, b = Tensor(np.arange(6.0).reshape(2, 3)), Tensor(np.arange(12.0)[::3])
    same, more, flipped, new = passes(a, b)
    assert np.shares_memory(given[0][0], a.array) and np.shares_memory(given[0][1], b.array)
    # a result never shares memory with the input, whatever the function returns
    assert not np.shares_memory(same.array, a.array) and not np.shares_memory(flipped.array, a.array)
    np.testing.assert_array_equal(flipped.array, a.array[::-1, ::-1])
    np.testing.assert_array_equal(more.array, b.array + 1)
    made = np.arange(3.0)
    (out,) = door(lambda f: (made,))(a)
    assert np.shares_memory(out.array, made) and new.array.tolist() == [0, 1, 2]


def test_an_image_that_needs_nothing_is_a_copy():
    flat = Tensor(np.full((24, 24), 7, np.uint8))
    found = gr.denoise_image(flat, sigma=0, **ON)
    np.testing.assert_array_equal(found.array, flat.array)
    assert not np.shares_memory(found.array, flat.array)


@pytest.mark.parametrize(
    ("x", "said"),
    [
        (Tensor(IMAGE, requires_grad=True), r"^denoise_tv: image requires gradients, .* pass image\.detach\(\)$"),
        (Tensor(IMAGE, device=(8, 0)), r"^denoise_tv: image is an array of foreign \(Tensor\) on a device that .* 8 "),
        (Tensor(np.zeros((0, 4))), r"^denoise_tv: image is empty, shape \(0, 4\)$"),
        (Tensor(5.0), r"^denoise_tv: image must have two or more axes"),
        (Tensor(IMAGE + 1j), r"^denoise_tv: image must hold integers or real numbers, got complex128"),
    ],
)
def test_what_cannot_be_taken_gets_a_sentence(x, said):
    with pytest.raises((TypeError, ValueError), match=said):
        gr.denoise_tv(x, lam=0.3, **ON)


def test_a_type_that_numpy_has_not_gets_a_sentence():
    class Narrow(Tensor):
        def __dlpack__(self, **asked):
            raise BufferError("bfloat16 is not supported")

    with pytest.raises(TypeError, match=r"numpy cannot read \(bfloat16 is not supported\): convert it"):
        gr.denoise_tv(Narrow(IMAGE), lam=0.3, **ON)


def test_functions_of_the_caller_get_the_kind_that_they_gave():
    seen = []
    settings = {"max_iter": 2, "callback": lambda check: seen.append(check.value()), **ON}
    gr.regularize(Tensor(IMAGE), GRID, **settings)
    gr.regularize(Tensor(np.stack([F0, F0], 1)), GRAPH, coupled=False, **settings)
    gr.denoise_image(Tensor(IMAGE), p=1, **settings)
    assert {type(x) for x in seen} == {Tensor}
    kinds = []

    def denoise(image):
        kinds.append(type(image))
        return gr.denoise_tv(image, lam=0.3, max_iter=2, **ON)

    assert gr.tuning.sure(denoise, Tensor(IMAGE), 20.0) == gr.tuning.sure(denoise, IMAGE, 20.0)
    assert kinds == [Tensor, Tensor, np.ndarray, np.ndarray]
    # a search inside gpureg has arrays of numpy
    assert type(gr.denoise_tv(Tensor(IMAGE), lam="sure", sigma=20.0, max_iter=2, **ON)) is Tensor
    seen.clear()
    # a call within a callback has data of its own
    settings["callback"] = lambda _: seen.append(gr.denoise_tv(IMAGE, lam=1, **ON))
    gr.regularize(Tensor(F0), GRAPH, **settings)
    assert {type(x) for x in seen} == {np.ndarray}


def test_the_result_of_an_interrupted_run():
    def stop(_):
        raise KeyboardInterrupt

    with pytest.raises(gr.Interrupted) as caught:
        gr.regularize(Tensor(F0), GRAPH, callback=stop, **ON)
    assert type(caught.value.result.value) is Tensor


def test_results_can_be_drawn_and_used_again():
    result = gr.regularize(Tensor(F0), GRAPH, max_iter=3, **ON)
    assert gr.plot.energy({"one": result}) is not None
    again = gr.regularize(result.value, GRAPH, initial=result.value, max_iter=1, **ON)
    assert type(again.value) is Tensor
    labels, scores = gr.propagate_labels(Tensor(LABELS), GRAPH, return_scores=True, **ON)
    assert type(labels) is type(scores) is Tensor and labels.array.dtype == LABELS.dtype


def test_only_the_interface_of_an_instance():
    """Some libraries set the attribute on the object; on the host it is none of ours."""

    class Plain:
        pass

    plain = Plain()
    assert exchange.on_host(plain, "x") is plain
    numbers = [1.0, np.float64(2), 3]
    assert exchange.on_host(numbers, "x") is numbers
    vertices, faces = gr.denoise_mesh((Tensor(SHEET[0].astype(np.float32)), SHEET[1]), max_iter=1, **ON)
    assert vertices.array.dtype == np.float32 and type(faces) is Tensor
