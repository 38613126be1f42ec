"""Polygonal curves: denoising, simplification, skeletons, files."""
