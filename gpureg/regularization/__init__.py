"""Regularize a function on any graph, as a whole or in tiles."""
