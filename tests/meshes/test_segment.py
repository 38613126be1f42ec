"""Meshes cut into parts, coarser and coarser, by the process with p < 1 on the graph of faces."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh

import gpureg as gr
from gpureg.graphs.of_shapes import face_graph
from gpureg.meshes.segment import _borders


def box(times: int = 3):
    mesh = trimesh.creation.box((2, 1.4, 1))
    for _ in range(times):
        mesh = mesh.subdivide()
    return mesh


def same(a, b) -> bool:
    """Whether two labellings are one partition."""
    pairs = len({pair for pair in zip(np.asarray(a).tolist(), np.asarray(b).tolist(), strict=True)})
    return pairs == len(np.unique(a)) == len(np.unique(b))


def test_a_box_has_six_sides(device):
    mesh = box()
    found = gr.segment_mesh(mesh, backend=device)
    assert found.n_segments[0] == 6
    sides = np.argmax(np.abs(mesh.face_normals), axis=1) * 2 + (mesh.face_normals.max(axis=1) > 0.5)
    assert same(found.levels[0], sides)
    assert found.n_segments[-1] == 1
    assert all(labels.dtype == np.int32 and labels.shape == (len(mesh.faces),) for labels in found.levels)
    assert len(found.levels) == len(found.lam) == len(found.results) == 12


def test_a_cylinder_has_three_parts():
    """With one norm around each face, all strips of the side meet at once, before they meet the caps."""
    mesh = trimesh.creation.cylinder(1, 2, sections=64).subdivide().subdivide()
    part = np.where(mesh.face_normals[:, 2] > 0.5, 1, np.where(mesh.face_normals[:, 2] < -0.5, 2, 0))
    found = gr.segment_mesh(mesh, lam=3 * 0.85 ** np.arange(20), norm="vertex")
    assert same(found.at_most(3), part)
    # edge by edge, the side goes through fewer and fewer strips; no part mixes a cap with the side until late
    strips = gr.segment_mesh(mesh)
    assert len(set(strips.n_segments)) > 5
    assert all(len(np.unique(part[strips.levels[3] == k])) == 1 for k in range(strips.n_segments[3]))


def nested(levels) -> bool:
    """Whether each part of a level is a union of parts of the one before."""
    return all(len(np.unique(np.stack([a, b]), axis=1).T) == a.max() + 1 for a, b in itertools.pairwise(levels))


def test_levels_are_nested():
    rng = np.random.default_rng(0)
    mesh = box(4)
    noisy = (mesh.vertices + rng.normal(0, 0.15 * mesh.edges_unique_length.mean(), mesh.vertices.shape), mesh.faces)
    found = gr.segment_mesh(noisy)
    counts = found.n_segments
    assert sorted(counts, reverse=True) == list(counts)
    assert counts[0] > counts[5] > counts[-1] == 1
    assert nested(found.levels)
    # noise makes many parts, among them the six sides at some level
    assert any(c in (6, 7, 8) for c in counts)


def test_any_function_on_the_faces():
    """Two colours on a sphere, with noise: two parts."""
    sphere = trimesh.creation.icosphere(3)
    side = sphere.triangles_center @ [1, 2, 3] > 0
    values = 100.0 * side + np.random.default_rng(1).normal(0, 10, len(side))
    labels = gr.segment_mesh(sphere, values=values).at_most(2)
    assert same(labels, side)
    # in other units the same
    assert np.array_equal(gr.segment_mesh(sphere, values=1e-3 * values, dtype=np.float64).at_most(2), labels)
    assert gr.segment_mesh(sphere, values=np.ones(len(side))).n_segments[0] == 1


def test_size_and_place_do_not_matter():
    mesh = box()
    moved = (5 * mesh.vertices @ np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0] + 7, mesh.faces)
    here, there = gr.segment_mesh(mesh).levels, gr.segment_mesh(moved).levels
    assert [level.tolist() for level in there] == [level.tolist() for level in here]


def test_borders_are_lengths_of_shared_edges():
    v = np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0], [3, 4, 0.0]])
    faces = np.array([[0, 1, 2], [3, 2, 1]])
    graph = face_graph(v, faces)
    assert np.allclose(_borders(v, faces, graph), [1, 1])
    mesh = trimesh.creation.icosphere(1)
    v, faces = np.array(mesh.vertices), np.array(mesh.faces)
    graph = face_graph(v, faces)
    lengths = dict(
        zip(
            map(tuple, np.sort(mesh.face_adjacency)),
            np.linalg.norm(np.diff(v[mesh.face_adjacency_edges], axis=1)[:, 0], axis=1),
            strict=True,
        )
    )
    expected = [lengths[min(a, b), max(a, b)] for a, b in zip(graph.edge_rows(), graph.indices, strict=True)]
    assert np.allclose(_borders(v, faces, graph), expected / np.mean(expected))


def test_faces_without_area():
    mesh = box(1)
    faces = np.concatenate([mesh.faces, [[0, 0, 1], [2, 3, 3]]])
    found = gr.segment_mesh(np.array(mesh.vertices), faces)
    assert found.levels[0].shape == (len(faces),)
    assert found.levels[0][:-2].max() == 5


@pytest.mark.parametrize(
    ("settings", "error", "words"),
    [
        ({"lam": []}, ValueError, "lam must be finite, > 0 and fall"),
        ({"lam": [1, 1]}, ValueError, "lam must be finite, > 0 and fall"),
        ({"lam": [1, 0]}, ValueError, "lam must be finite, > 0 and fall"),
        ({"lam": [np.inf, 1]}, ValueError, "lam must be finite"),
        ({"merge_tol": 0}, ValueError, "merge_tol must be finite and > 0"),
        ({"values": np.ones(3)}, ValueError, "values must have shape"),
        ({"weights": np.ones(3)}, ValueError, "weights"),
        ({"p": 0}, ValueError, "p must"),
    ],
)
def test_wrong_input(settings, error, words):
    with pytest.raises(error, match=words):
        gr.segment_mesh(box(0), **settings)


def test_too_few_segments():
    with pytest.raises(ValueError, match=r"no level has as few as 3 segments; they have \(6,\)"):
        gr.segment_mesh(box(), lam=[1.0]).at_most(3)


@pytest.mark.parametrize(("name", "least", "most"), [("twelve_original", 12, 12), ("fandisk_original", 15, 60)])
def test_parts_of_machines(data_folder, name, least, most):
    """The dodecahedron's twelve faces; fandisk's some thirty, of which curved ones are several at first."""
    mesh = gr.read_mesh(data_folder / "meshes" / f"{name}.ply").mesh
    found = gr.segment_mesh(mesh)
    assert any(least <= count <= most for count in found.n_segments)
    assert nested(found.levels)
