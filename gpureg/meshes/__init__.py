"""Triangle meshes: denoising, simplification, segmentation, files."""
