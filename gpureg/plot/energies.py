"""Draw the energy of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..checks import number
from ..doors import door
from ..model.result import Result
from .canvas import Path_, check_path, finish, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@door
def energy(result: Result | Mapping[str, Result], *, minimum: float | None = None, path: Path_ | None = None) -> Figure:
    """Draw the energy at each check of a run, and on a log scale its difference from the minimum.

    Parameters
    ----------
    result : Result, or mapping of str to Result
        One run, or several runs of the same problem by their labels, such as different solvers or initial values.
        Energies of different problems have no common minimum.
    minimum : float, optional
        The energy of the minimiser, if it is known. The default is the smallest energy of all runs, which the log scale
        does not show.
    path : path, optional
        File to write, in a format of matplotlib: .png, .pdf, .svg.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ImportError
        matplotlib is not installed.
    OSError
        The file cannot be written; no partial file is left.
    TypeError, ValueError
        There is no result, a result has no energies (as of a run in tiles), or matplotlib does not write the format.

    Notes
    -----
    The energy is ``Result.energy``, that of eq. 19 with the gradient norm smoothed by eps (eq. 15). The second panel is
    left out if no point is above the minimum.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> step = np.repeat([0.0, 0.2, 1.0], 20)
    >>> runs = {f"p = {p}": gr.regularize(step, gr.GridGraph(60), p=p, backend="numpy") for p in (1, 2)}
    >>> figure = gr.plot.energy(runs["p = 2"])
    >>> [axes.get_yscale() for axes in figure.axes]
    ['linear', 'log']
    """
    check_path(path)
    runs = dict(result) if isinstance(result, Mapping) else {"": result}
    if not runs:
        raise ValueError("there is no result to draw: the mapping is empty")
    for label, run in runs.items():
        name = f"the result {label!r}" if isinstance(result, Mapping) else "the result"
        if not isinstance(run, Result):
            raise TypeError(f"{name} must be a gpureg.Result, got {type(run).__name__}")
        if not len(run.energy):
            raise ValueError(
                f"{name} has no energies: runs in tiles report none, nor do single steps whose weights are not "
                "stored; gpureg.regularize on a problem that fits into memory reports them"
            )
    lowest = min(float(run.energy.min()) for run in runs.values())
    least = lowest if minimum is None else number("minimum", minimum)
    above = any((run.energy > least).any() for run in runs.values())
    figure = new_figure(10 if above else 5.5, 4, "constrained")
    left, *right = figure.subplots(1, 2 if above else 1, squeeze=False)[0]
    for k, (label, run) in enumerate(runs.items()):
        style = {"marker": ".", "markersize": 5, "linewidth": 1.4, "color": f"C{k % 10}", "label": label}
        left.plot(run.checks, run.energy, **style)
        for panel in right:
            panel.plot(run.checks, np.where(run.energy > least, run.energy - least, np.nan), **style)
    left.set(ylabel="energy", title="energy (eq. 19)")
    for panel in right:
        panel.set(yscale="log", ylabel=f"energy - {least:.6g}", title="above the minimum")
    for panel in (left, *right):
        panel.set_xlabel("iterations")
        panel.grid(True, color="#dddddd", linewidth=0.6)
        panel.spines[["top", "right"]].set_visible(False)
    if isinstance(result, Mapping):
        (right or [left])[0].legend(frameon=False)
    return finish(figure, path)
