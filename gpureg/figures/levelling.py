"""The runs of figures 1 and 2: a picture smoothed without a fidelity, for p from 2 to 0.01 on three graphs.

The paper gives the graphs, the weights, lam = 0 and the 800 iterations. It does not give the parameters of the weights
and eps (eq. 15): they are chosen here, the same for all runs.

As p falls, the number of flat zones falls on every graph, and so does the number of levels that cover 95 percent of
the picture (within a few levels below p = 0.3). The number of all levels falls clearly only in pictures of 128 x 128
or less: at 256 x 256 about a thousand or more zones are left, enough for all 256 levels. On G_8 most levels belong to
zones of fewer than 16 pixels: details that p = 2 averages away, with the extreme levels.
"""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..graphs.grid import GridGraph
from ..model.result import Result
from ..regularization.regularize import regularize
from ..weights import Weights, bilateral, patch
from .inputs import Inputs

DEGREES = (2.0, 1.0, 0.7, 0.3, 0.1, 0.01)
ITERATIONS = 800
# Gradients below eps count as zero: 0.01 of the range of 8 bits. With 0.001, 800 iterations are too few on G_0: at
# 128 x 128 p = 0.01 leaves more flat zones than p = 0.1 (399, 374).
EPS = 2.55
# The name of each graph in the figures, and its weights.
GRAPHS: dict[str, Weights | None] = {
    "G_0": None,
    "G_8, w_1": bilateral(4, 20),
    "G_8, w_2^5": patch(5, 20, patch_sigma=2),
}
WEIGHTS = "w_1: distances of 4 pixels and 20 grey levels; w_2^5: 11 x 11 patches, h = 20, a = 2"
# Longer side of the picture, without and with `quick`.
SIDES = {False: 256, True: 72}


@dataclass(frozen=True)
class Counts:
    """The numbers of grey levels and flat zones of a picture that is rounded to 8 bits.

    Attributes
    ----------
    levels : int
        Number of different levels.
    main_levels : int
        Smallest number of levels that cover 95 percent of the pixels.
    flat_zones : int
        Number of connected sets of pixels of one level, by 4-adjacency.
    """

    levels: int
    main_levels: int
    flat_zones: int


@dataclass(frozen=True, eq=False)
class Run:
    """A run of the model, shown in one panel; `value` is (H, W)."""

    graph: str
    p: float
    value: npt.NDArray[Any]
    counts: Counts
    result: Result

    def numbers(self) -> dict[str, Any]:
        """Return the numbers of the run for JSON."""
        about = {"graph": self.graph, "p": self.p, **asdict(self.counts), "iterations": self.result.iterations}
        return about | {"eps": self.result.eps, "seconds": round(self.result.seconds, 3), "method": self.result.method}


def grid_of(graph: str, shape: tuple[int, ...]) -> GridGraph:
    """Return the grid of a graph of `GRAPHS`."""
    return GridGraph(shape, 1, "cityblock") if graph == "G_0" else GridGraph(shape, 8)


def count(value: npt.NDArray[Any]) -> Counts:
    """Count the grey levels and flat zones of a picture (H, W)."""
    from skimage.measure import label

    levels = np.rint(value).astype(np.int64)
    shares = np.sort(np.unique(levels, return_counts=True)[1])[::-1] / levels.size
    main = int(np.searchsorted(np.cumsum(shares), 0.95) + 1)
    zones = label(levels, background=levels.min() - 1, connectivity=1, return_num=True)[1]
    return Counts(len(shares), main, int(zones))


def smoothed(
    picture: FloatArray, backend: str, iterations: int = ITERATIONS, degrees: tuple[float, ...] = DEGREES
) -> list[Run]:
    """Smooth a picture (H, W) on each graph with each p."""
    done = []
    for graph, weights in GRAPHS.items():
        for p in degrees:
            result = regularize(
                picture, grid_of(graph, picture.shape), p=p, lam=0, weights=weights, eps=EPS, max_iter=iterations,
                backend=backend,
            )  # fmt: skip
            done.append(Run(graph, p, result.value, count(result.value), result))
    return done


@functools.lru_cache(maxsize=1)
def runs(inputs: Inputs) -> list[Run]:
    """Smooth the picture on each graph with each p; the result is cached for the next figure."""
    return smoothed(inputs.grey(SIDES[inputs.quick]).pixels, inputs.backend)


def numbers(inputs: Inputs, shown: list[Run]) -> dict[str, Any]:
    """Return the numbers of a figure and its runs for JSON."""
    picture = inputs.grey(SIDES[inputs.quick])
    return {
        "picture": picture.name,
        "of the picture": asdict(count(picture.pixels)),
        "lam": 0,
        "backend": shown[0].result.backend,
        "runs": [run.numbers() for run in shown],
    }
