"""Partitions of images into regions, and their graphs (section 5.2)."""
