"""
Denoising a mesh
================

:func:`gpureg.denoise_mesh` estimates the noise of a surface and removes it. By default it regularizes the normals of
the faces with p = 1, so that they can jump at a crease, and moves the vertices to fit. ``filter="positions"``
regularizes the positions instead: this is simpler and faster, but rounds creases and shrinks the surface.
"""

import numpy as np
import trimesh

import gpureg as gr

rng = np.random.default_rng(0)


def with_noise(mesh, share):
    """A copy whose vertices are moved at random; the noise is `share` of the mean edge."""
    noisy = mesh.copy()
    noisy.vertices = mesh.vertices + rng.normal(0, share * mesh.edges_unique_length.mean(), mesh.vertices.shape)
    return noisy


def report(meshes, truth):
    """Print the errors of the normals, the volume, and the largest distance from the true surface."""
    for name, mesh in meshes.items():
        angle, volume = gr.metrics.normal_angle_error(mesh, truth), gr.metrics.volume(mesh) / gr.metrics.volume(truth)
        far = gr.metrics.hausdorff(mesh, truth) / truth.edges_unique_length.mean()
        print(
            f"{name:<9} normals off by {angle:4.1f} degrees, volume {100 * volume:5.1f} %, {far:.2f} edges away at most"
        )


# %%
# A nut, with creases that point outwards and inwards.

nut = trimesh.creation.annulus(r_min=0.6, r_max=1.2, height=0.7, sections=6)
for _ in range(3):
    nut = nut.subdivide()
noisy = with_noise(nut, 0.15)
print(f"noise of 0.15 edges, estimated {gr.estimate_mesh_noise(noisy) / nut.edges_unique_length.mean():.2f}\n")
meshes = {"noisy": noisy, "normals": gr.denoise_mesh(noisy), "positions": gr.denoise_mesh(noisy, filter="positions")}
report(meshes, nut)

figure = gr.plot.meshes({"true": nut, **meshes})
figure

# %%
# A torus has no crease. ``filter="positions"`` makes it smoother, and thinner, as the mean of a vertex's neighbours
# lies inside the surface. ``taubin=True`` takes a step outwards after each step inwards, which preserves the volume.

torus = trimesh.creation.torus(1.0, 0.4, major_sections=64, minor_sections=26)
noisy = with_noise(torus, 0.2)
meshes = {
    "noisy": noisy,
    "normals": gr.denoise_mesh(noisy),
    "positions": gr.denoise_mesh(noisy, filter="positions"),
    "taubin": gr.denoise_mesh(noisy, filter="positions", taubin=True),
}
report(meshes, torus)

figure = gr.plot.meshes(meshes, view=(30, 40), up="z")
figure

# %%
# ``values`` denoises colours, or any function at the vertices, instead of the positions.

stripes = np.sin(3 * np.arctan2(torus.vertices[:, 1], torus.vertices[:, 0])) > 0
seen = stripes + rng.normal(0, 0.3, len(stripes))
clean = gr.denoise_mesh(torus, values=seen)
print("root mean square error:", *(f"{np.sqrt(np.mean((f - stripes) ** 2)):.3f}" for f in (seen, clean)))

figure = gr.plot.meshes({"seen": torus, "denoised": torus}, values=[seen, clean], view=(30, 40), up="z")
figure
