"""The runs that figures 1 and 2 show: a picture smoothed without a fidelity, by p from 2 to 0.01 on three graphs.

The paper gives the graphs, the weights, lam = 0 and the 800 iterations, not the parameters of the weights nor eps
(eq. 15): those are chosen here, once for all runs.

Flat zones become fewer with every step of p on every graph, and fewer levels make up 95 percent of the picture (by a
few levels more or less below p = 0.3). The plain count of levels falls clearly in a small picture, 128 x 128 or less.
At 256 x 256 about a thousand zones and more are left, room for all 256 levels: on G_8 most of these belong to zones of
fewer than 16 pixels, details that p = 2 averages away, and the extremes with them.
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
# Below eps a gradient counts as none: a hundredth of the range of 8 bits. With a tenth of that, 800 sweeps do not do
# on G_0: at 128 x 128 p = 0.01 leaves more flat zones than p = 0.1 (399, 374).
EPS = 2.55
# The name of each graph in the figures, and its weights.
GRAPHS: dict[str, Weights | None] = {
    "G_0": None,
    "G_8, w_1": bilateral(4, 20),
    "G_8, w_2^5": patch(5, 20, patch_sigma=2),
}
WEIGHTS = "w_1: distances of 4 pixels and 20 grey levels; w_2^5: 11 x 11 patches, h = 20, a = 2"
# Longer sides of the picture: in full, and quickly.
SIDES = {False: 256, True: 72}


@dataclass(frozen=True)
class Counts:
    """How many grey levels a picture has, once it is rounded to 8 bits.

    Attributes
    ----------
    levels : int
        Distinct levels.
    main_levels : int
        The fewest levels that make up 95 percent of the pixels.
    flat_zones : int
        Connected sets of pixels of one level, by 4-adjacency.
    """

    levels: int
    main_levels: int
    flat_zones: int


@dataclass(frozen=True, eq=False)
class Run:
    """One panel."""

    graph: str
    p: float
    value: npt.NDArray[Any]
    counts: Counts
    result: Result

    def numbers(self) -> dict[str, Any]:
        """What the JSON says of it."""
        about = {"graph": self.graph, "p": self.p, **asdict(self.counts), "iterations": self.result.iterations}
        return about | {"eps": self.result.eps, "seconds": round(self.result.seconds, 3), "method": self.result.method}


def grid_of(graph: str, shape: tuple[int, ...]) -> GridGraph:
    """The grid of a graph of `GRAPHS`."""
    return GridGraph(shape, 1, "cityblock") if graph == "G_0" else GridGraph(shape, 8)


def count(value: npt.NDArray[Any]) -> Counts:
    """Grey levels of a picture."""
    from skimage.measure import label

    levels = np.rint(value).astype(np.int64)
    shares = np.sort(np.unique(levels, return_counts=True)[1])[::-1] / levels.size
    main = int(np.searchsorted(np.cumsum(shares), 0.95) + 1)
    zones = label(levels, background=levels.min() - 1, connectivity=1, return_num=True)[1]
    return Counts(len(shares), main, int(zones))


def smoothed(
    picture: FloatArray, backend: str, iterations: int = ITERATIONS, degrees: tuple[float, ...] = DEGREES
) -> list[Run]:
    """A picture smoothed on each graph by each p."""
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
    """The picture smoothed on each graph by each p, kept for the next figure."""
    return smoothed(inputs.grey(SIDES[inputs.quick]).pixels, inputs.backend)


def numbers(inputs: Inputs, shown: list[Run]) -> dict[str, Any]:
    """What the JSON of a figure says: the runs it shows."""
    picture = inputs.grey(SIDES[inputs.quick])
    return {
        "picture": picture.name,
        "of the picture": asdict(count(picture.pixels)),
        "lam": 0,
        "backend": shown[0].result.backend,
        "runs": [run.numbers() for run in shown],
    }
