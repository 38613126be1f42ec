"""``python docs/readme_pictures.py`` draws the README's pictures; the first is that of ``gpureg demo``."""

from pathlib import Path

import numpy as np
from PIL import Image
from skimage import data

import gpureg as gr
from gpureg.figures import made

HERE = Path(__file__).parent / "images"


def write(figure, name, width=1100):
    """Write a figure `width` pixels wide, in 128 colours, which halves its size."""
    path = HERE / name
    figure.savefig(path, dpi=110)
    with Image.open(path) as opened:
        height = round(opened.height * width / opened.width)
        opened.convert("RGB").resize((width, height), Image.Resampling.LANCZOS).quantize(128).save(path, optimize=True)


def mesh():
    """Draw a noisy mesh, denoised, and simplified."""
    vertices, faces = made.animal(26)
    edge = np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1).mean()
    rng = np.random.default_rng(0)
    noisy = vertices + rng.normal(0, 0.2 * edge, vertices.shape)
    smooth = gr.denoise_mesh((noisy, faces))
    few = gr.simplify_mesh(smooth, n_vertices=1200)
    error = [gr.metrics.normal_angle_error((x, faces), (vertices, faces)) for x in (noisy, smooth[0])]
    panels = {
        f"normals off by {error[0]:.1f} degrees": (noisy, faces),
        f"denoise_mesh: {error[1]:.1f} degrees": smooth,
        f"simplify_mesh: {len(few[0])} vertices": few,
    }
    figure = gr.plot.meshes(panels, view=(35, 15))
    write(figure, "animal.png")


def regions():
    """Draw a picture, its regions, and the merged regions."""
    picture = data.astronaut()[:300, 90:430]
    found = gr.simplify_image(picture, p=0.5, lam=0.5, weights="border", norm="edge", by_size=True, channel_axis=-1)
    merged = found.merged(merge_tol=8)
    write(merged.plot(), "regions.png", 1300)


if __name__ == "__main__":
    mesh()
    regions()
