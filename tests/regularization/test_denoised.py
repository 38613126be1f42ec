"""What the functions for meshes, clouds and curves have in common: their options, and what they say of themselves."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
import trimesh

import gpureg as gr
from gpureg.curves.denoise import CurveDenoising
from gpureg.curves.denoise import denoised as denoised_curves
from gpureg.doors import door, part_of
from gpureg.meshes.denoise import denoised as denoised_mesh
from gpureg.meshes.report import MeshDenoising
from gpureg.points.denoise import denoised as denoised_points
from gpureg.regularization.options import MODEL, RUN

SPHERE = trimesh.creation.icosphere(2)
NOISY = SPHERE.vertices + np.random.default_rng(0).normal(0, 0.02, SPHERE.vertices.shape)
MESH = NOISY, np.array(SPHERE.faces)
ANGLE = np.linspace(0, 2 * np.pi, 80, endpoint=False)
RING = np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1) + np.random.default_rng(1).normal(0, 0.01, (80, 2))

WORK = {
    "denoise_mesh": lambda **options: gr.denoise_mesh(MESH, **options),
    "simplify_mesh": lambda **options: gr.simplify_mesh(MESH, **options),
    "segment_mesh": lambda **options: gr.segment_mesh(MESH, lam=[1.0], **options),
    "denoise_points": lambda **options: gr.denoise_points(NOISY, **options),
    "cluster_points": lambda **options: gr.cluster_points(NOISY, **options),
    "denoise_curve": lambda **options: gr.denoise_curve(RING, **options),
    "simplify_curve": lambda **options: gr.simplify_curve(RING, method="process", **options),
    "simplify_skeleton": lambda **options: gr.simplify_skeleton(RING, **options),
}


@pytest.mark.parametrize("name", WORK)
def test_every_function_takes_the_options_of_a_run(name):
    parameters = inspect.signature(getattr(gr, name)).parameters
    assert all(parameters[option].kind is inspect.Parameter.KEYWORD_ONLY for option in RUN)
    assert all(option in inspect.getdoc(getattr(gr, name)) for option in MODEL if option in parameters)
    checks = []
    WORK[name](backend="numpy", dtype="float64", callback=lambda check: checks.append(check), max_iter=3, tol=0.0)
    assert checks
    with pytest.raises(MemoryError, match="are allowed"):
        WORK[name](backend="numpy", memory=1000)
    with pytest.raises(TypeError, match=f"{name}.. got an unexpected keyword argument 'colour'"):
        WORK[name](colour="red")
    with pytest.raises(ValueError, match=f"{name}: .*abacus"):
        WORK[name](backend="abacus")


@pytest.mark.parametrize("name", sorted(set(WORK) - {"segment_mesh", "cluster_points"}))
@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"p": True}, TypeError, "p must be a number, got True"),
        ({"p": 0}, ValueError, "p must be finite and > 0, got 0"),
        ({"lam": "much"}, TypeError, "lam must be a number, got 'much'"),
        ({"max_iter": 1.5}, TypeError, "max_iter must be an integer, got 1.5"),
        ({"max_iter": -1}, ValueError, "max_iter must be >= 0, got -1"),
        ({"tol": np.nan}, ValueError, "tol must be finite and >= 0, got nan"),
        ({"eps": -1.0}, ValueError, "eps must be finite and >= 0, got -1.0"),
    ],
)
def test_numbers_are_checked_in_one_way(name, options, error, words):
    with pytest.raises(error, match=f"^{name}: {words}"):
        WORK[name](backend="numpy", **options)


@pytest.mark.parametrize(
    "found",
    [
        denoised_mesh(MESH, backend="numpy"),
        denoised_points(NOISY, backend="numpy"),
        denoised_curves(RING, backend="numpy"),
    ],
    ids=["mesh", "points", "curve"],
)
def test_what_was_done_is_one_kind_of_value(found):
    assert found.moves and found.estimated and found.iterations == sum(r.iterations for r in found.results)
    # curves at p = 2 start from the minimiser
    assert (found.iterations > 0) == (not isinstance(found, CurveDenoising))
    assert found.displacement.shape == found.value.shape[:1] and found.displacement.max() > 0
    assert found.describe().endswith("iterations" if found.iterations else "solved directly")
    # rounds of normals end by themselves, without a fidelity
    lam = "" if isinstance(found, MeshDenoising) else ", lam = "
    assert f"p = {found.p:g}{lam}" in found.describe()
    assert found.seconds > 0
    with pytest.raises(AttributeError, match="cannot assign to field"):
        found.p = 3.0


def test_a_function_of_a_part_of_another_one():
    def work(x: int, *, twice: bool = False) -> tuple[int, str]:
        return (2 * x if twice else x), "told"

    @door
    @part_of(work)
    def number(found: tuple[int, str]) -> int:
        """Double a number."""
        return found[0]

    assert number(3) == 3 and number(3, twice=True) == 6
    assert (number.__name__, number.__doc__) == ("number", "Double a number.")
    assert str(inspect.signature(number)) == "(x: 'int', *, twice: 'bool' = False) -> 'int'"
    with pytest.raises(TypeError, match="unexpected keyword argument 'thrice'"):
        number(3, thrice=True)
