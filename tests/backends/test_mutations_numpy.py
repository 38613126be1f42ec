"""The literal loops can fail: a changed numpy backend breaks the comparison that holds the oracle to the paper."""

from __future__ import annotations

import mutations
import pytest
import test_aggregate
import test_duality
import test_paper
import test_paper_patches
from literal import Form
from mutations import Mutation


def paper(check, *args, name="small grid"):
    return lambda oracle: getattr(test_paper, check)(oracle, name, *args)


def form(check, *args, name="small grid", directed=True):
    return lambda oracle: getattr(test_paper, check)(oracle, Form(oracle, name, directed), *args)


def dual(check, *args, name="small row"):
    def run(oracle):
        setting = test_duality.Setting(oracle, name, 1, True, False)
        getattr(test_duality, check)(oracle, setting, *args)

    return run


def patches(check, *args):
    return lambda oracle: getattr(test_paper_patches, check)(oracle, *args)


P_LAPLACIAN = paper("test_p_laplacian_and_energy", 1, True, 1.5)
SWEEP = paper("test_sweep", 1, True, 1.5, 0.625)
BOTH = form("test_both_norms_and_processes", 1, True, 1.5, False)
EDGES = form("test_difference_and_adjoint", 1)

MUTATIONS = [
    (Mutation("degree", "_degree", "edges.hold * v[0]", "edges.gamma * v[0]"), paper("test_degree")),
    (Mutation("difference", "_difference", "out[H - 1 - h][end] =", "out[H - 1 - h][start] ="), EDGES),
    (Mutation("adjoint", "_adjoint", "on_grid[end] -=", "on_grid[end] +="), EDGES),
    (
        Mutation("gradient_norm", "_gradient_norm", "self.real(eps) ** 2", "0 * eps"),
        paper("test_local_variation", 1, True),
    ),
    (Mutation("p_laplacian", "_p_laplacian", "0 - self._flow", "0 + self._flow"), P_LAPLACIAN),
    (Mutation("jacobi_step", "_jacobi_step", "(moved - f)", "(f - moved)"), SWEEP),
    (Mutation("jacobi_step", "primitives:conductance_of", "u[1] + v[1]", "u[1] + u[1]"), SWEEP),
    (Mutation("euler_step", "_euler_step", "(f0 - f) +", "(f - f0) +"), BOTH),
    (Mutation("energy", "energy_into", "p / 2).sum() / p", "p / 2).sum()"), P_LAPLACIAN),
    (Mutation("sweep", "sweep", "theta=theta", "theta=1.0"), SWEEP),
    (Mutation("dot", "dot_into", "products / np.asarray(over, np.float64)", "products"), dual("test_dot", "number")),
    (Mutation("combine", "_combine", "+ self._term(b", "- self._term(b"), dual("test_combine", "number", None)),
    (Mutation("gradient", "_gradient", "pull - self", "pull + self"), dual("test_gradient", False, 1.5, 0.125)),
    (
        Mutation("prox", "duality:step_length", "r - sigma * t", "r - t"),
        dual("test_dual_step", False, 1.5),
    ),
    (
        Mutation("prox", "duality:length", "square = t**2 + r.dtype.type(eps) ** 2", "square = t**2"),
        dual("test_dual_step", False, 1.5),
    ),
    (
        Mutation("dual_step", "dual_step", "of_edges * self", "self"),
        dual("test_dual_step", False, 1.5),
    ),
    (
        Mutation("dual_step", "dual_step", "0.5 if edge_norm else 1.0", "1.0"),
        dual("test_dual_step", True, 1.5),
    ),
    (Mutation("primal", "_primal", "f0 - self.adjoint", "f0 + self.adjoint"), dual("test_primal", "column")),
    (
        Mutation("duality_gap", "duality_gap_into", "norms(d) + self.real(eps) ** 2", "norms(d)"),
        dual("test_duality_gap", False, 1.5),
    ),
    (
        Mutation("duality_gap", "duality_gap_into", "/ (2 * np.where", "/ (np.where"),
        dual("test_duality_gap", False, 1.5),
    ),
    (
        Mutation("patch_distance", "_similarity", "kept *= self.real(-form.scale)", "kept *= self.real(-1)"),
        patches("test_patch_distance_and_w2", "small grid", 1, 1, None, True),
    ),
    (
        Mutation("patch_distance", "patches:_along", "zip(profile[1:], slabs", "zip(profile[1:] ** 2, slabs"),
        patches("test_patch_distance_and_w2", "small grid", 1, 2, 0.75, False),
    ),
    (
        Mutation("similarity_step", "similarity_step", "f if guide is None else guide", "f"),
        patches("test_similarity_step", "small grid", True),
    ),
    (
        Mutation("aggregate", "patches:over_patches", "range(2 * radius + 1)", "range(2 * radius)"),
        lambda oracle: test_aggregate.check_the_equation(oracle, "small grid"),
    ),
    (
        Mutation("influence_zones", "influence_zones", "mu[u] + length == mu[v]", "mu[u] < mu[v]"),
        patches("test_influence_zones", "small grid"),
    ),
]


@pytest.mark.parametrize(("mutation", "check"), MUTATIONS, ids=[mutation.id for mutation, _ in MUTATIONS])
def test_a_broken_oracle_is_noticed(monkeypatch, oracle, mutation, check):
    """Right and wrong in turn: the comparison passes, and does not."""
    check(oracle)
    broken = mutations.numpy(mutation, monkeypatch)
    with pytest.raises(AssertionError):
        check(broken)
