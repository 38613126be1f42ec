"""
Fewer vertices
==============

With p < 1 neighbouring vertices move to the same position, and :func:`gpureg.simplify_mesh` makes one vertex of them.
The weights compare normals, so that flat parts lose vertices and creases stay. A closed surface stays closed.
"""

import trimesh

import gpureg as gr

# %%
# A nut with flat sides, and a torus without any. ``n_vertices`` is reached exactly; without it one round is done.

nut = trimesh.creation.annulus(r_min=0.6, r_max=1.2, height=0.7, sections=6)
for _ in range(3):
    nut = nut.subdivide()
torus = trimesh.creation.torus(1.0, 0.4, major_sections=48, minor_sections=24)


def simplified(mesh, counts):
    """Simplify a mesh and print what is lost; the keys of the result are the titles of the figure."""
    found = {f"{len(mesh.vertices)} vertices": mesh}
    for count in counts:
        small = gr.simplify_mesh(mesh, n_vertices=count)
        found[f"{len(small.vertices)} vertices"] = small
        volume, far = gr.metrics.volume(small) / gr.metrics.volume(mesh), gr.metrics.hausdorff(small, mesh)
        closed = "closed" if gr.metrics.is_watertight(small) else "not closed"
        asked = "default" if count is None else f"{count} asked for"
        print(
            f"{asked:<14} {len(small.vertices):5} left, {closed}, volume {100 * volume:5.1f} %, {far:.3f} away at most"
        )
    return found


# %%
# By default one round is done, and the shape is preserved. With ``n_vertices`` there are as many rounds as needed, and
# each merges the cheaper half of the vertices that have come together. The nut has 24 corners.

figure = gr.plot.meshes(simplified(nut, [None, 100, 30]), edges=True)
figure

# %%
# On a round surface the removal of any vertex changes the shape.

figure = gr.plot.meshes(simplified(torus, [250, None, 60]), edges=True, view=(30, 40), up="z")
figure
