"""What `regularize`, `memory_needed` and the solvers refuse, and what they say then."""

from __future__ import annotations

import math

import numpy as np
import pytest

import gpureg as gr
from gpureg.solvers import Jacobi

GRID = gr.GridGraph((3, 4))
F0 = np.zeros((3, 4))
BAD = [
    ({"f0": np.full((3, 4), np.nan)}, ValueError, "f0 must be finite, got nan"),
    ({"f0": np.full((3, 4), np.inf)}, ValueError, "f0 must be finite, got inf"),
    ({"f0": np.zeros((4, 3))}, ValueError, r"f0 must have shape .*got \(4, 3\)"),
    ({"f0": np.zeros((12, 0))}, ValueError, "channels"),
    ({"f0": np.zeros((3, 4), complex)}, TypeError, "real numbers, got complex"),
    ({"f0": [["a"] * 4] * 3}, TypeError, "real numbers"),
    ({"graph": "grid"}, TypeError, "graph must be a Graph, a GridGraph, .* or a graph of networkx, got str"),
    ({"p": 0}, ValueError, "p must be finite and > 0, got 0"),
    ({"p": -1.5}, ValueError, "got -1.5"),
    ({"p": math.nan}, ValueError, "got nan"),
    ({"p": "1"}, TypeError, "p must be a number"),
    ({"lam": -1}, ValueError, "lam must be >= 0 .*got -1"),
    ({"lam": math.nan}, ValueError, "got nan"),
    ({"lam": np.ones(5)}, ValueError, r"one value per vertex, shape \(3, 4\), got shape \(5,\)"),
    ({"lam": "1"}, TypeError, "lam must be a number, got '1'"),
    ({"lam": True}, TypeError, "lam must be a number, got True"),
    ({"lam": ["1"] * 12}, TypeError, "lam must be a real number"),
    ({"weights": -np.ones(GRID.n_edges)}, ValueError, "weights must be >= 0, got -1"),
    ({"weights": np.full(GRID.n_edges, np.nan)}, ValueError, "weights must be finite"),
    ({"weights": np.ones(3)}, ValueError, r"weights must have shape .*got \(3,\)"),
    ({"weights": np.arange(GRID.n_edges)}, ValueError, "same in both directions"),
    ({"gamma": "cubic"}, ValueError, 'gamma must be "sqrt".*got .cubic.'),
    ({"gamma": np.ones(4)}, ValueError, r"gamma must have shape \(58,\).*or \(3, 4, 8\).*got \(4,\)"),
    ({"gamma": -np.ones(GRID.n_edges)}, ValueError, "gamma must be finite and >= 0, got -1"),
    ({"gamma": np.full(GRID.n_edges, np.nan)}, ValueError, "gamma must be finite and >= 0, got nan"),
    ({"gamma": None}, TypeError, "gamma must be a name.*or one number per directed edge"),
    ({"gamma": np.ones(GRID.n_edges), "weights": np.ones(GRID.n_edges)}, ValueError, "instead of the weights"),
    ({"norm": "face"}, ValueError, 'norm must be "vertex" or "edge", got .face.'),
    ({"update_weights": 2}, ValueError, "update_weights needs a weight function.*got weights=None"),
    ({"update_weights": 0, "weights": gr.weights.patch(0, 1)}, ValueError, "update_weights must be >= 1, got 0"),
    ({"update_weights": 1.5}, TypeError, "update_weights must be an integer, got 1.5"),
    ({"f0": np.ma.masked_array(np.zeros((3, 4)))}, TypeError, "masked array"),
    ({"eps": -1}, ValueError, "eps must be finite and >= 0, got -1"),
    ({"eps": 0, "p": 1}, ValueError, "eps = 0 is too small for p = 1"),
    ({"eps": 1e-25, "p": 1}, ValueError, "too small for p = 1 in float32"),
    ({"eps": 1e-18, "p": 0.01}, ValueError, "too small for p = 0.01"),
    ({"max_iter": -1}, ValueError, "max_iter must be >= 0, got -1"),
    ({"max_iter": 1.5}, TypeError, "max_iter must be an integer"),
    ({"tol": -1}, ValueError, "tol must be finite and >= 0, got -1"),
    ({"tol": math.nan}, ValueError, "got nan"),
    ({"tol": "1"}, TypeError, "tol must be a number, got '1'"),
    ({"callback": 5}, TypeError, "callback must be callable, got 5"),
    ({"coupled": "no"}, TypeError, "coupled must be True or False, got 'no'"),
    ({"weights": "patch"}, TypeError, "weights must be an object of gpureg.weights or an array"),
    ({"f0": 5.0}, ValueError, r"\(3, 4\) or \(3, 4, m\), got \(\)"),
    ({"solver": "newton"}, ValueError, 'solver must be "jacobi", "euler" or "certified", got .newton.'),
    ({"solver": 3}, TypeError, "solver must be a name or a solver object"),
    ({"dtype": "float16"}, ValueError, "dtype must be float32 or float64, got float16"),
    ({"initial": np.zeros(5)}, ValueError, "initial must have shape"),
    ({"initial": np.zeros((12, 2))}, ValueError, "initial must have the shape of f0"),
    ({"initial": np.full((3, 4), np.nan)}, ValueError, "initial must be finite"),
    ({"backend": "cuda"}, ValueError, "unknown backend 'cuda': use auto, warp, opencl, numpy"),
    ({"backend": 1}, TypeError, "backend must be a name"),
    ({"backend": "opencl:99"}, gr.BackendUnavailable, "opencl"),
]


@pytest.mark.parametrize(
    ("wrong", "error", "says"),
    BAD,
    ids=[f"{k}={str(v)[:20]}" for w, _, _ in BAD for k, v in w.items() if k == next(iter(w))],
)
def test_wrong_arguments_get_a_sentence(wrong: dict, error: type, says: str) -> None:
    call = {"f0": F0, "graph": GRID, "backend": "numpy", **wrong}
    with pytest.raises(error, match=says):
        gr.regularize(call.pop("f0"), call.pop("graph"), **call)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: gr.regularize(F0, GRID, progress="yes"), "regularize: progress must be True or False, got 'yes'"),
        (lambda: gr.memory_needed(GRID, lam="1"), "memory_needed: lam must be a number, got '1'"),
        (lambda: gr.memory_needed(GRID, p="a"), "memory_needed: p must be a number, got 'a'"),
        (lambda: gr.memory_needed(GRID, weights="patch"), "memory_needed: weights must be an object of gpureg.weights"),
        (lambda: gr.memory_needed("grid"), r"memory_needed: graph must be a Graph, a GridGraph, .*, got str"),
        (lambda: gr.Jacobi(accelerate=1), "Jacobi: accelerate must be True or False, got 1"),
        (lambda: gr.Euler(step="a"), "Euler: step must be a number, got 'a'"),
        (lambda: gr.Euler(steps=1), r"Euler.__init__\(\) got an unexpected keyword argument 'steps'"),
    ],
)
def test_an_error_names_what_was_called(call, says: str) -> None:
    with pytest.raises(TypeError, match=f"^{says}"):
        call()


def test_wrong_solver_settings() -> None:
    with pytest.raises(ValueError, match=r"damping must lie in \(0, 1\], got 0"):
        Jacobi(damping=0)
    with pytest.raises(ValueError, match="check_every must be >= 1, got 0"):
        Jacobi(check_every=0)
    with pytest.raises(TypeError, match=r"check_every must be an integer, got 2\.5"):
        Jacobi(check_every=2.5)
    with pytest.raises(TypeError, match="damping must be a number, got 'a'"):
        Jacobi(damping="a")
