"""Derivatives of functions of a result: of the minimiser, or through a number of sweeps."""
