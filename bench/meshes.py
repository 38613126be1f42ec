"""Vertex positions of a mesh, beside trimesh's Laplacian filter."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import gpureg as gr

from .iterations import Sweeps
from .model import (
    DEVICE,
    EXTRA,
    HOST,
    NEEDS_DATA,
    TOLERANCE,
    Bar,
    Case,
    Entry,
    Image,
    Setup,
    apart,
    data,
    peer,
    skipped,
)

TRIMESH = "trimesh filter_laplacian"
# Relative, both in float64; measured 3e-16. A sum in another order over 8 iterations stays far below.
MESH_TOLERANCE = 1e-14


def _mesh(setup: Setup, trimesh: Any) -> tuple[Any, str] | str:
    """The mesh and its name, or why there is none."""
    if trimesh is None:
        return f"trimesh, which reads the mesh, is not installed: {EXTRA}"
    if setup.size == "tiny":
        return trimesh.creation.icosphere(subdivisions=2), "a sphere"
    path = data("meshes", "bunny34834_noisy02.ply")
    return NEEDS_DATA if path is None else (trimesh.load(path, process=False), "bunny")


def vertex_positions(setup: Setup) -> Iterator[Case]:
    """Eight iterations of vertex positions at p = 2, lam = 0: trimesh's Laplacian filter."""
    steps = 8
    trimesh = peer("trimesh")
    found = _mesh(setup, trimesh)
    kinds = ("unit", "inverse-distance")
    if isinstance(found, str):
        for kind in kinds:
            yield Case(f"mesh-{kind}", f"vertex positions of a mesh, {steps} iterations", [skipped("all", found)])
        return
    mesh, name = found
    positions = np.array(mesh.vertices, np.float64)
    edges = np.array(mesh.edges_unique)
    for kind in kinds:
        graph = gr.Graph.from_edges(edges, n_vertices=len(positions), positions=positions)
        weights = gr.weights.inverse_distance(1) if kind == "inverse-distance" else None
        stored = np.ones(graph.n_edges)
        if weights is not None:
            stored = weights.between(graph, positions, graph.edge_rows(), graph.indices)
        yield _smoothing(setup, trimesh, mesh, name, graph, weights, stored, kind, steps)


def _smoothing(
    setup: Setup,
    trimesh: Any,
    mesh: Any,
    name: str,
    graph: gr.Graph,
    weights: Any,
    stored: Image,
    kind: str,
    steps: int,
) -> Case:
    from scipy import sparse

    positions = np.array(mesh.vertices, np.float64)
    n = graph.n_vertices
    matrix = sparse.csr_array((stored, graph.indices, graph.indptr), shape=(n, n))
    rows = sparse.dia_array((1 / matrix.sum(axis=1)[None, :], [0]), shape=(n, n)) @ matrix
    operators = {"": sparse.coo_matrix(rows), ", CSR": sparse.csr_matrix(rows)}

    def theirs(operator: Any) -> Image:
        mesh.vertices = positions
        trimesh.smoothing.filter_laplacian(
            mesh, lamb=1, iterations=steps, volume_constraint=False, laplacian_operator=operator
        )
        return np.array(mesh.vertices)

    truth = theirs(operators[""])

    def ours(device: str, dtype: Any = np.float32) -> Image:
        return gr.regularize(
            positions, graph, p=2, lam=0, weights=weights, solver=gr.Jacobi(damping=1), max_iter=steps,
            backend=device, dtype=dtype,
        ).value  # fmt: skip

    entries = [
        Entry(
            TRIMESH + kind_of,
            lambda operator=operator: theirs(operator),
            is_peer=True,
            note=f"one thread, float64, operator ready{' and stored as CSR instead of COO' if kind_of else ' (COO)'}",
        )
        for kind_of, operator in operators.items()
    ]
    per_edge = 4 + (4 if weights is not None else 0)
    # indices, weights and pointers, f in and out, three channels
    moved = steps * 4.0 * (per_edge / 4 * graph.n_edges + n * (1 + 2 * 3))
    count = steps * (7.0 * graph.n_edges + 4 * n)
    on_device = None if weights is None else stored
    for device in setup.devices:
        sweeps = Sweeps(device, graph, on_device, positions, p=2.0, lam=0.0, eps=0.0, steps=steps)

        def check(device: str = device) -> tuple[bool, str]:
            try:
                good, said = apart(ours(device, np.float64), truth, MESH_TOLERANCE, "trimesh, both in float64")
            except gr.BackendUnavailable:
                good, said = True, "not compared in float64, which the device has not"
            same, told = apart(ours(device), truth, TOLERANCE["float32"], "trimesh as timed, in float32")
            return good and same, f"{said}; {told}"

        def check_device(sweeps: Sweeps = sweeps) -> tuple[bool, str]:
            sweeps()
            return apart(sweeps.value(), truth, TOLERANCE["float32"], "trimesh")

        entries += [
            Entry(device, lambda d=device: ours(d), check=check, transfers=HOST, bytes=moved, operations=count),
            Entry(device, sweeps, sweeps.backend.finish, check_device, DEVICE, moved, count, note="weights ready"),
        ]
    return Case(
        f"mesh-{kind}",
        f"vertex positions of {name}, {n} vertices, {steps} iterations, p = 2, lam = 0, {kind} weights",
        entries,
        [
            "the graph is ready, as trimesh's operator is; weights that do not read the data are kept",
            "trimesh gets the operator of our graph: its own with equal weights counts a border edge one way only",
            "ours in float32, trimesh in float64, its only type; compared in float64 as well",
        ],
        [Bar(TRIMESH, 1.0)],
        name,
        n,
    )
