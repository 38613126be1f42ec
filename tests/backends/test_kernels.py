"""The kernel sources as texts: complete in every language, explained, and each one compiles alone."""

from __future__ import annotations

import ast

import pytest

from gpureg import backends, kernels

# Not primitives: number types, how to reach a vertex's neighbours, blocks of cells.
PARTS = {"reals", "csr", "grid", "gamma", "conductance", "squared_gradient", "strip", "prox", "triangles", "padded"}
PARTS |= {"curvature"}
PARTS |= {"total", "scalars"}  # the second stage of a long sum, computations with its results
# Parts of one language alone; kernels/README.md says why.
OPENCL_PARTS, WARP_PARTS = {"csr_gpu", "lattice", "group_tile", "sums", "reflected"}, {"pack", "lanes"}
OPENCL_PARTS |= {"patch_tile", "strip_packs", "strip_unrolled", "quotient"}
# The same primitives for a GPU, in the language whose GPUs share a work group's memory; kernels/README.md says why.
GPU = {"patch_groups_gpu", "group_step_gpu", "group_gather"}
# The same primitive for a GPU, in both languages.
BOTH_GPU = {"influence_zones_gpu", "similarity_step_gpu", "sweep_gpu"}
# Several primitives at once, in the one language that needs it, and a part of it; kernels/README.md says why.
FUSED, FUSED_PARTS = {"sweep", "descend", "ascend"}, {"sweep_wide"}
# What a primitive includes, where it is not both kinds of graph.
INCLUDES = {
    "cosine_solve": ("reals.cl",),
    "blur": ("grid.cl", "reflected.cl", "reals.cl"),
    "cells": ("reals.cl",),
    "aggregate": ("grid.cl", "reals.cl"),
    "similarity_step": ("strip.cl", "reals.cl"),
    "patch_distance": ("strip.cl", "csr.cl", "reals.cl"),
    "patch_groups": ("lattice.cl", "reals.cl"),
    "group_step": ("triangles.cl", "lattice.cl", "reals.cl"),
    "dual_step": ("prox.cl", "grid.cl", "csr.cl", "reals.cl"),
    "duality_gap": ("prox.cl", "grid.cl", "csr.cl", "reals.cl"),
    "influence_zones": (),
    "gradient": ("conductance.cl", "grid.cl", "csr.cl", "reals.cl"),
    "restrict": ("reals.cl",),
    "prolong": ("reals.cl",),
    **{name: ("curvature.cl", "grid.cl", "csr.cl", "reals.cl") for name in ("hessian", "shorten", "dual_newton")},
}
# Kernels whose primitive's name is a built-in function of the language.
KERNELS = {"dot": "dot_product", "mix": "mix_channels", "restrict": "restricted"}
PRIMITIVES = sorted(
    path.stem
    for path in (kernels.folder / "opencl").glob("*.cl")
    if path.stem not in PARTS | OPENCL_PARTS | GPU | BOTH_GPU | FUSED | FUSED_PARTS
)


def test_the_primitives_of_the_protocol_have_a_kernel_each():
    assert PRIMITIVES == [
        "adjoint",
        "aggregate",
        "blur",
        "cells",
        "combine",
        "cosine_solve",
        "degree",
        "difference",
        "dot",
        "dual_newton",
        "dual_step",
        "duality_gap",
        "energy",
        "euler_step",
        "gradient",
        "gradient_norm",
        "gradient_product",
        "group_step",
        "hessian",
        "influence_zones",
        "jacobi_step",
        "max_change",
        "mix",
        "p_laplacian",
        "patch_distance",
        "patch_groups",
        "primal",
        "prolong",
        "proximal",
        "relax",
        "restrict",
        "shorten",
        "similarity_step",
    ]
    # `cells` are two methods: in and out
    methods = {*PRIMITIVES, *FUSED, "put_cells", "get_cells"} - {"cells"}
    assert not [name for name in sorted(methods) if not callable(getattr(backends.Backend, name, None))]


def test_the_languages_have_the_same_files():
    opencl = {path.stem for path in (kernels.folder / "opencl").glob("*.cl")}
    warp = {path.stem for path in (kernels.folder / "warp").glob("*.py")} - {"__init__"}
    own = OPENCL_PARTS | GPU | FUSED | FUSED_PARTS
    assert opencl - own == warp - WARP_PARTS == PARTS | BOTH_GPU | set(PRIMITIVES)
    assert warp >= WARP_PARTS and opencl >= own


@pytest.mark.parametrize("stem", sorted(GPU | OPENCL_PARTS))
def test_files_of_one_language_open_with_a_comment(stem):
    opencl = (kernels.folder / "opencl" / f"{stem}.cl").read_text("utf-8")
    assert len(opencl[opencl.index("/*") : opencl.index("*/")]) > 80


@pytest.mark.parametrize("stem", sorted(PARTS | BOTH_GPU | set(PRIMITIVES)))
def test_files_open_with_a_comment(stem):
    opencl = (kernels.folder / "opencl" / f"{stem}.cl").read_text("utf-8")
    assert opencl.startswith("/*")
    assert len(opencl[: opencl.index("*/")]) > 80
    warp = ast.get_docstring(ast.parse((kernels.folder / "warp" / f"{stem}.py").read_text("utf-8")))
    assert warp
    assert len(warp) > 80


@pytest.mark.parametrize("primitive", PRIMITIVES)
def test_both_languages_state_the_same_equation(primitive):
    """The first line of either file says what the primitive computes, and by which equation."""

    def first_words(text):
        return text.lstrip('/*" ').splitlines()[0].split()

    opencl = (kernels.folder / "opencl" / f"{primitive}.cl").read_text("utf-8")
    warp = (kernels.folder / "warp" / f"{primitive}.py").read_text("utf-8")
    assert first_words(opencl) == first_words(warp)


@pytest.mark.parametrize("primitive", PRIMITIVES)
def test_the_contract_names_every_primitive(primitive):
    """A row of its own in the table of kernels/README.md."""
    rows = (kernels.folder / "README.md").read_text("utf-8").splitlines()
    assert [row for row in rows if row.startswith(f"| `{primitive}` |")]


@pytest.mark.parametrize("primitive", PRIMITIVES)
def test_includes_are_put_in_place(primitive):
    """Compilers get one text; what they report still names the file and line that a person wrote."""
    source = kernels.opencl_source(primitive)
    assert "#include" not in source
    parts = INCLUDES.get(primitive, ("grid.cl", "csr.cl", "reals.cl"))
    assert not [part for part in parts if f'#line 1 "{part}"' not in source]
    # the line after the last #line directive is that line of the primitive's own file
    lines = source.splitlines()
    own = (kernels.folder / "opencl" / f"{primitive}.cl").read_text("utf-8").splitlines()
    at, number = [
        (i, int(line.split()[1])) for i, line in enumerate(lines) if line.startswith("#line") and primitive in line
    ][-1]
    assert (number > 1) == (INCLUDES.get(primitive) != ())
    assert lines[at + 1 :] == own[number - 1 :]


@pytest.mark.parametrize(
    ("primitive", "options"),
    [
        *((name, options) for name in PRIMITIVES for options in ([], ["-DGRID"])),
        # of 2^31 vertices and more
        *((name, ["-DINDEX=long"]) for name in ("energy", "gradient", "influence_zones", "jacobi_step")),
    ],
)
def test_a_kernel_compiles_alone(primitive, options):
    """With no option but the kind of graph: what a person types into an offline compiler."""
    if "opencl" in backends.absent():
        pytest.skip(backends.absent()["opencl"])
    import pyopencl as cl

    device = backends.get("opencl").device.handle
    program = cl.Program(cl.Context([device]), kernels.opencl_source(primitive)).build(options)
    assert [kernel.function_name for kernel in program.all_kernels()] == [KERNELS.get(primitive, primitive)]


def test_a_missing_source_is_named():
    with pytest.raises(FileNotFoundError, match=r"no_such_primitive\.cl"):
        kernels.opencl_source("no_such_primitive")
