"""The figures of the paper, drawn from the user's own picture, mesh or curve, or from default inputs.

Each ``figN.py`` has a function ``draw(inputs)`` that returns a :class:`Drawn`; ``gpureg figures DIR`` writes them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from ..files.pictures import check_place
from . import fig1, fig2, fig3, fig4, fig5, fig6, fig7, fig8, fig9, levelling
from .inputs import Inputs
from .sheet import Drawn

__all__ = ["FIGURES", "Drawn", "Inputs", "draw_figures"]

FIGURES: dict[int, Callable[[Inputs], Drawn]] = {
    k: figure.draw for k, figure in enumerate((fig1, fig2, fig3, fig4, fig5, fig6, fig7, fig8, fig9), start=1)
}


def draw_figures(folder: Path, inputs: Inputs, only: Iterable[int] = ()) -> Iterator[tuple[Drawn, Path, float]]:
    """Draw figures into a folder, and yield each with its file and the seconds it took.

    ``figN.png`` and its numbers, ``figN.json``, are both written, or neither.

    Raises
    ------
    ValueError
        A figure with this number does not exist.
    OSError
        A file cannot be read or written.
    ImportError
        matplotlib or scikit-image is not installed.
    """
    import time

    levelling.runs.cache_clear()  # a file may have changed
    wanted = sorted(set(only)) or list(FIGURES)
    for k in wanted:
        if k not in FIGURES:
            raise ValueError(f"there is no figure {k}: the paper has 1 to {len(FIGURES)}")
        check_place(folder / f"fig{k}.png")
    for k in wanted:
        begin = time.perf_counter()
        drawn = FIGURES[k](inputs)
        path = folder / f"fig{k}.png"
        drawn.write(path)
        yield drawn, path, time.perf_counter() - begin
