"""
A scan without faces
====================

A scanner gives points and no surface. :func:`gpureg.denoise_points` averages the normals of small neighbourhoods on the
graph of nearest points, and moves the points along them to the quadrics that fit their neighbours. No parameter and no
mesh is needed, and the sign of the normals does not matter.
"""

import numpy as np
import trimesh

import gpureg as gr

rng = np.random.default_rng(0)


def scan_and_clean(shape):
    """Denoise points on a shape in both ways; the colours are their distances from the true surface."""
    surface, _ = trimesh.sample.sample_surface(shape, 5000, seed=1)
    scan = surface + rng.normal(0, 0.02, surface.shape)
    print(f"noise of 0.02, estimated {gr.estimate_point_noise(scan):.3f}")
    clouds = {
        "scan": scan,
        "surface": gr.denoise_points(scan),
        "positions": gr.denoise_points(scan, filter="positions"),
    }
    far = {name: gr.metrics.distance_to_surface(cloud, shape) for name, cloud in clouds.items()}
    for name, distance in far.items():
        print(f"{name:<9} {np.sqrt(np.mean(distance**2)):.4f} from the surface, root mean square")
    shown = [np.minimum(distance, 0.04) for distance in far.values()]
    return gr.plot.points(clouds, values=shown, view=(30, 35), up="z")


# %%
# A torus. Colours end at a distance of 0.04. ``filter="positions"`` moves each point towards the points around it,
# therefore inwards and closer together: holes open between the points.

figure = scan_and_clean(trimesh.creation.torus(1.0, 0.4, major_sections=128, minor_sections=64))
figure

# %%
# A box. ``filter="positions"`` rounds the edges of the box; ``filter="surface"``, the default, keeps them.

figure = scan_and_clean(trimesh.creation.box((2, 1.4, 1)))
figure
