"""Compute energies of a function on the vertices (eq. 19, 20 and 30)."""

from __future__ import annotations

from dataclasses import replace
from typing import Unpack

import numpy.typing as npt

from ..checks import number
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..model.problem import uses_degrees
from .on_device import SMOOTHED, Smoothed, put_function


@door(options=SMOOTHED)
def dirichlet_energy(f: npt.ArrayLike, graph: GraphLike, p: float, **settings: Unpack[Smoothed]) -> float:
    """Compute the p-Dirichlet energy of a function (eq. 20, with eps eq. 15).

    The settings are those of :func:`p_laplacian`. The second formula is that of ``norm="edge"`` (eq. 30), a sum over
    the edges with gamma > 0::

        1/p sum_u |grad_w f(u)|^p
        1/(2 p) sum_u sum_v |d_w(f)(u, v)|^p

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.operators.dirichlet_energy([0.0, 3.0, 3.0], gr.Graph.from_edges([[0, 1], [1, 2]]), 2, backend="numpy")
    9.0
    """
    return energy(f, f, graph, p, 0.0, **settings)


@door(options=SMOOTHED)
def energy(
    f: npt.ArrayLike,
    f0: npt.ArrayLike,
    graph: GraphLike,
    p: float,
    lam: float | npt.ArrayLike,
    **settings: Unpack[Smoothed],
) -> float:
    """Compute the energy of f (eq. 19) that :func:`gpureg.regularize` minimises: Dirichlet energy plus fidelity to f0.

    Weight functions are computed from `f0`. The fidelity is 0 where lam is infinite. The settings are those of
    :func:`p_laplacian`.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.regularize`.

    Examples
    --------
    >>> import gpureg as gr
    >>> graph = gr.Graph.from_edges([[0, 1], [1, 2]])
    >>> gr.operators.energy([0.0, 3.0, 3.0], [1.0, 3.0, 3.0], graph, 2, 4.0, backend="numpy")
    11.0
    """
    graph = as_graph(graph, degrees=uses_degrees(settings.get("gamma")))
    eps = number("eps", settings.get("eps", 0.0), low=0)
    # the energy, unlike its derivative, allows eps = 0: check the arguments with another eps
    on, function = put_function(f, graph, p, {**settings, "eps": eps or 1.0}, lam=lam, f0=f0)
    put = on.put_function(function)
    return on.backend.energy(on.weighted, put, on.f0, on.lam, replace(on.model, eps=eps))
