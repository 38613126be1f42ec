"""
Parts of a mesh
===============

The normals of a mesh are regularized on the graph of its faces with p near zero. They become piecewise constant, and
neighbouring faces with the same normal are one part. :func:`gpureg.segment_mesh` does this for one fidelity after
another; the smaller it is, the fewer parts there are, and each part is a union of parts of the level before.
"""

import numpy as np
import trimesh

import gpureg as gr


def draw(mesh, found, counts, **view):
    """Draw the finest levels with at most `counts` parts, in random colours."""
    colours = np.random.default_rng(3).uniform(0.25, 1, (100, 3))
    levels = {f"{level.max() + 1} parts": level for level in (found.at_most(count) for count in counts)}
    return gr.plot.meshes(dict.fromkeys(levels, mesh), values=[colours[k % 100] for k in levels.values()], **view)


# %%
# A box with noise of a tenth of the mean edge. At first the noise makes further parts; then the six sides remain over
# many levels; at the end there is one part.

box = trimesh.creation.box((2, 1.4, 1)).subdivide().subdivide().subdivide()
rng = np.random.default_rng(0)
box.vertices = box.vertices + rng.normal(0, 0.1 * box.edges_unique_length.mean(), box.vertices.shape)
found = gr.segment_mesh(box)
for lam, count in zip(found.lam, found.n_segments, strict=True):
    print(f"lam = {lam:.4f}: {count}")

figure = draw(box, found, (1000, 6))
figure

# %%
# A cylinder of 64 strips. With ``norm="edge"``, the default, two parts join at a time, and the side has fewer and fewer
# strips. With ``norm="vertex"`` all strips of the side join at once, before they join the caps: this gives three parts.
# It happens in a narrow range of fidelities, so the levels are close, each 0.85 times the one before.

cylinder = trimesh.creation.cylinder(1, 2, sections=64).subdivide().subdivide()
lam = 3 * 0.85 ** np.arange(20)
edge = gr.segment_mesh(cylinder, lam=lam)
vertex = gr.segment_mesh(cylinder, lam=lam, norm="vertex")
for name, found in {"edge": edge, "vertex": vertex}.items():
    print(f'norm="{name}":', *found.n_segments)

figure = draw(cylinder, edge, (40, 20, 10), view=(30, 35), up="z")
figure

# %%
# The same cylinder with the other norm.

figure = draw(cylinder, vertex, (1000, 3), view=(30, 35), up="z")
figure
