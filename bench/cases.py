"""The case list: what is timed, beside whom, and what must agree before a time is printed.

A case is a function that takes a :class:`Setup` and gives :class:`Case` objects: rows, ours and the peers', and the
bars. To add one: a function in the module of its topic, and a line in ``CASES``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from . import filters, growth, iterations, meshes, regions, solvers
from .model import Case, Setup

# A function may yield cases of several names: all of them are in its key.
CASES: dict[tuple[str, ...], Callable[[Setup], Iterator[Case]]] = {
    ("nonlocal-means",): filters.nonlocal_means,
    ("bilateral",): filters.bilateral,
    ("digital-tv",): filters.digital_tv,
    ("iteration-grid", "iteration-csr"): iterations.iteration,
    ("window-w1", "window-w2"): iterations.window,
    ("irregular-minnesota", "irregular-luxembourg", "irregular-scale-free", "irregular-shuffled"): iterations.irregular,
    ("mesh-unit", "mesh-inverse-distance"): meshes.vertex_positions,
    ("certified-tv",): solvers.total_variation,
    ("certified-linear",): solvers.linear,
    ("accelerated-sweeps",): solvers.acceleration,
    ("simplify",): regions.chain,
    ("region-graph",): regions.graph_of_labels,
    ("simplify-speed-up",): regions.speed_up,
    ("growth-simplify",): regions.growth,
    ("growth-iteration",): growth.sweep_growth,
    ("growth-nlm",): growth.nlm_growth,
}

NAMES = tuple(name for names in CASES for name in names)


def check(devices: list[str], names: tuple[str, ...] = NAMES) -> Iterator[tuple[str, str, bool, str]]:
    """Every check at tiny size, without timing: for the tests.

    Parameters
    ----------
    devices : list of str
        Devices of ours, "opencl:0" and the like.
    names : tuple of str
        Cases wanted.

    Yields
    ------
    tuple
        The case with its size, the row, whether its result is right, and a sentence. A row that cannot run (a peer that
        is not installed, data that are not there) is right, and the sentence says why.
    """
    for keys, function in CASES.items():
        if not set(keys) & set(names):
            continue
        for case in function(Setup("tiny", devices)):
            if case.name not in names:
                continue
            for entry in case.entries:
                good, said = True, entry.note
                if entry.check is not None:
                    good, said = entry.check()
                elif entry.call is not None:
                    entry.call()
                    entry.finish()
                yield f"{case.name} {case.label}".strip(), f"{entry.who} {entry.transfers}", good, said
