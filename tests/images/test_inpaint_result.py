"""What inpaint_image returns of its run: the gap, and an image in every case."""

from __future__ import annotations

import cases
import numpy as np
import pytest

import gpureg as gr

ORACLE = {"backend": "numpy", "dtype": np.float64}


def torn() -> tuple[np.ndarray, np.ndarray]:
    """A picture with a hole and two lost pixels far from it."""
    image = cases.rng(5).random((24, 28))
    missing = np.zeros(image.shape, bool)
    missing[9:14, 8:15] = missing[0, 0] = missing[-1, -1] = True
    return image, missing


@pytest.mark.parametrize("p", [1.0, 2.0, 3.0])
def test_gap_is_of_what_is_filled_in(p: float) -> None:
    """The gap is relative to the energy near missing pixels, not to that of the picture; no fill has a lower energy."""
    image, missing = torn()
    filled, result = gr.inpaint_image(np.where(missing, np.nan, image), missing, p=p, return_result=True, **ORACLE)
    assert np.array_equal(filled, result.value)
    assert result.problem is None
    assert result.gap is not None and 0 <= result.gap <= 1.01e-4 * result.energy[-1]
    lam = np.where(missing, 0, np.inf)
    model = {"p": p, "lam": lam, "max_iter": 0, **ORACLE}
    grid = gr.GridGraph(image.shape, 1, "cityblock")

    def energy(f: np.ndarray) -> float:
        return gr.regularize(np.where(missing, 0.5, image), grid, initial=f, eps=1e-9, **model).energy[-1]

    at_most = energy(filled) - result.gap
    assert result.energy[-1] < 0.7 * energy(filled)
    for seed in range(5):
        other = np.where(missing, filled + 0.01 * cases.rng(seed).standard_normal(image.shape), image)
        assert energy(other) >= at_most - 1e-7  # the smoothing by eps


def test_a_pixel_far_from_another_hole_has_its_own_value() -> None:
    """With p = 3: a tolerance relative to the energy of the whole picture would leave it anywhere."""
    image, missing = torn()
    filled = gr.inpaint_image(image, missing, p=3, **ORACLE)
    corner = gr.inpaint_image(image[:4, :4], missing[:4, :4], p=3, **ORACLE)
    assert filled[0, 0] == pytest.approx(corner[0, 0], abs=2e-2)


def test_integers_and_channels() -> None:
    image = (cases.rng(7).random((3, 9, 11)) * 255).astype(np.uint8)
    missing = np.zeros((9, 11), bool)
    missing[3:6, 4:7] = True
    filled, result = gr.inpaint_image(image, missing, channel_axis=0, return_result=True, backend="numpy")
    assert filled.dtype == result.value.dtype == np.uint8 and filled.shape == image.shape
    assert np.array_equal(filled[:, ~missing], image[:, ~missing])
    same, nothing = gr.inpaint_image(image, missing & False, channel_axis=0, return_result=True)
    assert np.array_equal(same, image) and nothing.gap == 0 and nothing.iterations == 0


@pytest.mark.parametrize("at", [0, 2])
def test_interruption_keeps_the_image(at: int) -> None:
    image, missing = torn()

    def stop(check: gr.Check) -> None:
        if check.iteration >= at:
            raise KeyboardInterrupt

    with pytest.raises(gr.Interrupted) as caught:
        gr.inpaint_image(image, missing, p=1, callback=stop, **ORACLE)
    value = caught.value.result.value
    assert value.shape == image.shape and np.isfinite(value).all()
    assert np.array_equal(value[~missing], image[~missing])


def test_which_solver() -> None:
    """Below p = 1, and with weights that are computed anew, there is no certificate."""
    image, missing = torn()
    settings = {"return_result": True, "max_iter": 5, **ORACLE}
    bilateral = {"weights": gr.weights.bilateral(2.0, 0.5), "radius": 1}
    certified = gr.inpaint_image(image, missing, **bilateral, **settings)[1]
    below = gr.inpaint_image(image, missing, p=0.7, **settings)[1]
    renewed = gr.inpaint_image(image, missing, update_weights=2, **bilateral, **settings)[1]
    assert certified.gap is not None and below.gap is None and renewed.gap is None
    with pytest.raises(ValueError, match="inpaint_image: solver='certified' needs p >= 1"):
        gr.inpaint_image(image, missing, p=0.7, solver="certified")
    with pytest.raises(ValueError, match="inpaint_image: update_weights needs a process"):
        gr.inpaint_image(image, missing, solver="certified", update_weights=2, **bilateral)


def test_a_line_without_neighbours() -> None:
    """Cells of 1 x 3 with a radius of 1 are joined along rows: a row without a known pixel has the nearest values."""
    image = np.add.outer(10 * np.arange(4.0), np.arange(6.0))
    missing = np.zeros(image.shape, bool)
    missing[1, 2:4] = missing[3] = True
    filled = gr.inpaint_image(image, missing, radius=1, metric="euclidean", spacing=(3, 1), **ORACLE)
    assert np.abs(filled[1] - image[1]).max() < 1e-4
    assert np.array_equal(filled[3], image[2])
