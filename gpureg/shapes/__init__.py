"""Meshes and point clouds of any library as arrays, and back; curves, open or closed."""
