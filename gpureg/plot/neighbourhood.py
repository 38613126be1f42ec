"""Draw the weights of the neighbours of a pixel."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray, IntArray
from ..checks import number
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..graphs.csr import Graph
from ..graphs.edges import Metric
from ..graphs.grid import GridGraph
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from ..regularization.tiling import Tile, halo, part_problem
from ..weights import Weights
from .canvas import (
    Path_,
    as_picture,
    as_spacing,
    check_path,
    colours,
    finish,
    panels,
    sections,
    show,
    span,
    unknown_in,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

_FRAME = "#ff2d55"


@door
def neighbours(
    image: npt.ArrayLike,
    pixel: Sequence[int],
    *,
    weights: Weights | npt.ArrayLike | None = None,
    radius: float | None = None,
    metric: Metric = "chebyshev",
    spacing: Sequence[float] | None = None,
    mask: npt.ArrayLike | None = None,
    graph: GraphLike | None = None,
    channel_axis: int | None = None,
    path: Path_ | None = None,
    backend: str = "numpy",
) -> Figure:
    """Draw the weights w(u, v) of one pixel u to its neighbours v over the image.

    Parameters
    ----------
    image : array
        Two or three axes, and an axis of channels if any; three planes through the pixel of a volume are drawn. NaN is
        allowed outside the mask.
    pixel : sequence of int
        Index of the pixel along each axis.
    weights : Weights or array, optional
        As for :func:`gpureg.regularize`. The default is the weights of the graph, or 1.
    radius, metric, spacing, mask
        The window, as for :class:`gpureg.GridGraph`.
    graph : Graph or GridGraph, optional
        A graph instead of the window, such as one of the most similar pixels; its vertices are the image's pixels in
        row-major order.
    channel_axis : int, optional
        Axis of the channels; None for grey.
    path : path, optional
        File to write, in a format of matplotlib: .png, .pdf, .svg.
    backend : str, default "numpy"
        Backend that computes the weights in float32, only around the pixel if the weights allow it.

    Returns
    -------
    matplotlib.figure.Figure
        Three panels for each plane: the image with the pixel and a frame around its neighbours; the part in the frame;
        the weights over this part.

    Raises
    ------
    ImportError
        matplotlib is not installed.
    OSError
        The file cannot be written; no partial file is left.
    TypeError, ValueError
        The pixel is outside the image or the mask, or has no neighbours; both or neither of window and graph are given;
        the graph has another number of vertices; or as :func:`gpureg.regularize`.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> step = np.repeat([0.0, 1.0], 8) * np.ones((16, 1))
    >>> figure = gr.plot.neighbours(step, (8, 4), weights=gr.weights.bilateral(3, 0.2), radius=5)
    >>> figure.axes[2].get_title()
    '109 weights, sum 25.23'
    """
    check_path(path)
    picture = as_picture(image, "image", channel_axis)
    shape = picture.shape[:-1]
    at = _inside(pixel, shape)
    if graph is None:
        if radius is None:
            raise ValueError("give the radius of the window, or a graph")
        number("radius", radius, finite=False)
        graph = GridGraph(shape, radius, metric, spacing=spacing, mask=mask)
    elif radius is not None or spacing is not None or mask is not None:
        raise ValueError("radius, spacing and mask are for a window, a graph already has neighbours: give only one")
    graph = as_graph(graph)
    if graph.n_vertices != np.prod(shape) or (isinstance(graph, GridGraph) and graph.shape != shape):
        raise ValueError(f"the graph must have a vertex per pixel of {shape}, got {graph!r}")
    places, values = _weights_of(graph, picture, at, weights, backend)
    if not len(values):
        raise ValueError(f"pixel {at} has no neighbours in {graph!r}")
    grid = graph if isinstance(graph, GridGraph) else graph.grid
    steps = as_spacing(None if grid is None else grid.spacing, len(shape))
    # Half a pixel more on each side.
    all_places = np.vstack([places, at])
    low, high = all_places.min(axis=0) - 0.5, all_places.max(axis=0) + 0.5
    black, white = span(picture)
    cuts = sections(at)
    drawn = [colours(cut.of(picture), black, white) for cut in cuts]
    titles = [f"pixel u = {at}", "in the frame", f"{len(values)} weights, sum {values.sum():.4g}"]
    figure, axes, beside = panels(cuts, shape, steps, titles, unknown_in(drawn))
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    bar = ScalarMappable(Normalize(0, float(values.max()) or 1.0), "viridis")
    for row, cut, pixels in zip(axes, cuts, drawn, strict=True):
        y, x = at[cut.rows], at[cut.columns]
        (top, left), (bottom, right) = low[[cut.rows, cut.columns]], high[[cut.rows, cut.columns]]
        for panel in row:
            show(panel, pixels, cut, steps)
            _outline(panel, (left, top), (right, bottom), _FRAME)
        # a cross in the whole image, an outline in the enlarged part
        row[0].plot(x, y, "+", color=_FRAME, markersize=9, clip_on=False)
        for panel in row[1:]:
            panel.set(xlim=(left, right), ylim=(bottom, top))
            _outline(panel, (x - 0.5, y - 0.5), (x + 0.5, y + 0.5), _FRAME)
        here = np.full(len(values), True) if cut.fixed is None else places[:, cut.fixed] == cut.at
        # a single pixel would be invisible in a wide frame
        side = max(1.0, (right - left) / 60, (bottom - top) / 60)
        _squares(row[2], places[here][:, [cut.columns, cut.rows]], values[here], bar, side)
    figure.colorbar(bar, cax=beside, label="w(u, v)")
    return finish(figure, path)


def _inside(pixel: Sequence[int], shape: tuple[int, ...]) -> tuple[int, ...]:
    try:
        at = tuple(operator.index(i) for i in pixel)
    except TypeError:
        raise TypeError(f"pixel must hold {len(shape)} integers, got {pixel!r}") from None
    if len(at) != len(shape) or not all(0 <= i < size for i, size in zip(at, shape, strict=True)):
        raise ValueError(f"pixel must lie in the image of shape {shape}, counted from 0 along each axis, got {at}")
    return at


def _weights_of(
    graph: Graph | GridGraph,
    picture: npt.NDArray[Any],
    at: tuple[int, ...],
    weights: Weights | npt.ArrayLike | None,
    backend: str,
) -> tuple[IntArray, FloatArray]:
    """Return the indices (k, ndim) of the neighbours of a pixel, and their weights (k,)."""
    shape = picture.shape[:-1]
    kind = np.dtype(np.float32)
    problem = Problem.make(
        picture.reshape(*(shape if isinstance(graph, GridGraph) else (graph.n_vertices,)), -1),
        graph, p=2.0, lam=1.0, weights=weights, gamma="sqrt", norm="vertex", coupled=True, eps=None, dtype=kind,
    )  # fmt: skip
    device = backends.get(backend, kind)
    if isinstance(graph, Graph):
        stored = DeviceProblem.put(problem, device).weighted
        u = int(np.ravel_multi_index(at, shape))
        row = slice(graph.indptr[u], graph.indptr[u + 1])
        of_edges = device.get_weights(stored)
        places = np.stack(np.unravel_index(graph.indices[row], shape), axis=-1)
        return places, np.ones(len(places)) if of_edges is None else of_edges[row]
    if graph.mask is not None and not graph.mask[at]:
        raise ValueError(f"pixel {at} lies outside the mask: it has no neighbours")
    box = tuple(
        slice(max(0, i - reach), min(size, i + reach + 1))
        for i, reach, size in zip(at, halo(problem, 1), shape, strict=True)
    )
    part = part_problem(problem, Tile(box, box))
    if isinstance(problem.weights, Weights) and part.weights is None:
        # these weights cannot be computed for a part
        part, box = problem, tuple(slice(0, size) for size in shape)
    grid = part.graph
    assert isinstance(grid, GridGraph)
    half = device.get_weights(DeviceProblem.put(part, device).weighted)
    if half is None:
        half = grid.edges.unit_half()
    corner = np.array([s.start for s in box])
    u = np.array(at) - corner
    v = u + grid.offsets
    exists = ((v >= 0) & (v < np.array(grid.shape))).all(axis=1)
    if grid.mask is not None:
        exists[exists] = grid.mask[tuple(v[exists].T)]
    # A weight is stored at the pair's first pixel in row-major order.
    count = grid.half_window
    forward = np.arange(2 * count) >= count
    planes = np.where(forward, np.arange(2 * count) - count, count - 1 - np.arange(2 * count))
    first = np.where(forward[:, None], u, v)
    return (v + corner)[exists], half[planes[exists], *first[exists].T]


def _outline(axes: Axes, low: tuple[float, float], high: tuple[float, float], colour: str) -> None:
    from matplotlib.patches import Rectangle

    size = (high[0] - low[0], high[1] - low[1])
    axes.add_patch(Rectangle(low, *size, fill=False, edgecolor=colour, linewidth=1.4, clip_on=False, zorder=3))


def _squares(axes: Axes, centres: IntArray, values: FloatArray, bar: ScalarMappable, side: float) -> None:
    from matplotlib.collections import PolyCollection

    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * side
    squares = PolyCollection(list(centres[:, None, :] + corners), edgecolors="face", linewidths=0.3)
    squares.set(array=values, cmap=bar.cmap, norm=bar.norm)
    axes.add_collection(squares, autolim=False)
