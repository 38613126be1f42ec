"""
Fewer vertices
==============

With p < 1 the positions of neighbouring vertices come together, and :func:`gpureg.simplify_mesh` makes one of those
that met. The weights compare normals, so that flat parts thin out and creases stay. A closed surface stays closed.
"""

import trimesh

import gpureg as gr

# %%
# A nut with flat sides, and a torus without any. ``n_vertices`` is reached exactly; without it one round decides.

nut = trimesh.creation.annulus(r_min=0.6, r_max=1.2, height=0.7, sections=6)
for _ in range(3):
    nut = nut.subdivide()
torus = trimesh.creation.torus(1.0, 0.4, major_sections=48, minor_sections=24)


def simplified(mesh, counts):
    """The mesh with fewer vertices; the keys, which become titles, say how many. What is lost is printed."""
    found = {f"{len(mesh.vertices)} vertices": mesh}
    for count in counts:
        small = gr.simplify_mesh(mesh, n_vertices=count)
        found[f"{len(small.vertices)} vertices"] = small
        volume, far = gr.metrics.volume(small) / gr.metrics.volume(mesh), gr.metrics.hausdorff(small, mesh)
        closed = "closed" if gr.metrics.is_watertight(small) else "not closed"
        asked = "nothing said" if count is None else f"{count} asked for"
        print(
            f"{asked:<14} {len(small.vertices):5} left, {closed}, volume {100 * volume:5.1f} %, {far:.3f} away at most"
        )
    return found


# %%
# With nothing said one round is done, and the shape stays. A number takes as many rounds as it needs, in each of which
# the cheaper half of what met is merged. The nut has 24 corners.

figure = gr.plot.meshes(simplified(nut, [None, 100, 30]), edges=True)
figure

# %%
# On a round surface every vertex that goes costs something.

figure = gr.plot.meshes(simplified(torus, [250, None, 60]), edges=True, view=(30, 40), up="z")
figure
