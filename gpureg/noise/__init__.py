"""Estimate noise in pictures and on graphs, and the fidelity for it."""
