"""Regularization of a function on any graph, whole or in tiles."""
